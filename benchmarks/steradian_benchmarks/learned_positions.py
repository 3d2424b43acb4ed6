"""Benchmark: sensor positions learned by gradient through simulated scans and their reconstructions.

A-lines of simulated objects at variable positions, with noise, are reconstructed, and the loss is 1 minus the
correlation of the image with the object around the point of interest. The reconstruction is the direct method with
variable weights, or a few steps of a projected gradient method that stands for the iterative one. Objects of one kind
train, and all arrangements of ``mask compare`` and the learned ones are tried on other objects of that kind and of the
other. Requires PyTorch (extra ``torch``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import torch

import steradian.torch
from steradian.comparisons import Simulation, StagedScan, phantom
from steradian.core.progress import Progress
from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid, Nufft, Volume
from steradian.masks import Counted, Mask, custom_mask, mask_by_count
from steradian.phantoms import rasterise
from steradian.quality import disc

APERTURE, POINT = 4.8e-3, (0.6e-3, -0.4e-3, 1.5e-3)
RADIUS, REGION = 0.6e-3, 1.4e-3
"""Radius of the objects, and diameter of the region judged, in m."""
COUNT, MODES, SAMPLES = 300, 64, 128
INTERVAL, SPEED, NOISE = 28e-9, 1500.0, 30.0
DEPTHS = (1.05e-3, 1.95e-3)
ARRANGEMENTS: tuple[Counted, ...] = get_args(Counted)
KINDS = ("vessel-tree", "yarn")
TRAINING_SEED, TRAINED, OBJECTS, ITERATIONS = 1000, 24, 8, 30
"""First seed and number of the training objects, number of held-out objects of a kind, iterations of their images."""
BATCH = 2
STEPS = {"direct": 300, "iterative": 60}
UNROLLED = 6
RATE, WEIGHT_RATE = 12e-6, 0.03
"""First step sizes of Adam: of positions in m, and of the logarithm of weights."""
Method: TypeAlias = Literal["direct", "iterative"]
Row = dict[str, Any]


@dataclass(frozen=True)
class Training:
    """Method and kind of objects to train for, arrangement to begin with, and whether sensors move."""

    method: Method
    kind: str
    start: Counted
    moving: bool = True

    @property
    def named(self) -> Row:
        """Fields that name the training in a row."""
        mask = "learned" if self.moving else "weights learned"
        return {"mask": mask, "trained_for": self.method, "trained_on": self.kind, "start": self.start}


TRAININGS = (
    Training("direct", "vessel-tree", "equi-steradian", moving=False),
    Training("direct", "vessel-tree", "equi-steradian"),
    Training("direct", "vessel-tree", "grid"),
    Training("direct", "yarn", "equi-steradian"),
    Training("direct", "yarn", "grid"),
    Training("iterative", "yarn", "equi-steradian"),
)


class Trainer:
    """Simulation of scans of training objects as a differentiable function of the sensors' positions.

    Parameters
    ----------
    mask
        Sensors to begin with.
    kind
        Name of the phantom of the training objects.
    method
        Reconstruction to train for.
    """

    def __init__(self, mask: Mask, kind: str, method: Method) -> None:
        geometry = AcquisitionGeometry(mask, SAMPLES, dt=INTERVAL, sound_speed=SPEED)
        grid, compute = ImageGrid(MODES, depth=DEPTHS), Compute(threads=1)
        self.forward = steradian.torch.ForwardOperator(geometry, grid, tolerance=1e-3, compute=compute)
        self.direct = steradian.torch.DirectReconstruction(geometry, grid, Nufft(tolerance=1e-3), compute=compute)
        self.method = method
        like = steradian.reconstruct(geometry.acquisition(np.zeros(self.forward.trace_shape)), grid)
        self.objects = [_object(kind, TRAINING_SEED + number, like) for number in range(TRAINED)]
        near = disc(like.coordinates("x"), like.coordinates("y"), REGION, POINT[:2])
        self.near = torch.from_numpy(np.broadcast_to(near[..., None], like.values.shape).copy())
        self.positions = torch.tensor(mask.positions, requires_grad=True)
        self.logarithm = torch.tensor(np.log(mask.weights / mask.weights.mean()), requires_grad=True)
        self.random = torch.Generator().manual_seed(0)
        self.norm = self._norm() if method == "iterative" else 1.0

    def loss(self, truth: torch.Tensor) -> torch.Tensor:
        """Return 1 minus the correlation of an object's image with the object around the point of interest."""
        with torch.no_grad():
            peak = self.forward(truth, positions=self.positions).abs().max()
        noise = peak * 10 ** (-NOISE / 20) * torch.randn(self.forward.trace_shape, generator=self.random)
        traces = self.forward(truth, positions=self.positions) + noise
        image = self._fitted(traces) if self.method == "iterative" else self._direct(traces)
        found, wanted = (values[self.near] - values[self.near].mean() for values in (image, truth))
        return 1 - (found * wanted).sum() / (found.norm() * wanted.norm())

    def learn(self, steps: int, *, moving: bool = True, progress: Progress | None = None) -> list[float]:
        """Move positions and weights down the gradient of the loss; return the mean loss of each step.

        The iterative method has no weights; without ``moving`` only weights are learned.
        """
        groups = [{"params": [self.positions], "lr": RATE if moving else 0.0}]
        if self.method == "direct":
            groups.append({"params": [self.logarithm], "lr": WEIGHT_RATE})
        solver = torch.optim.Adam(groups)
        falling = torch.optim.lr_scheduler.CosineAnnealingLR(solver, steps)
        losses, order = [], np.random.default_rng(0)
        for step in range(steps):
            solver.zero_grad()
            chosen = order.choice(len(self.objects), BATCH, replace=False)
            loss = torch.stack([self.loss(self.objects[number]) for number in chosen]).mean()
            loss.backward()
            solver.step()
            falling.step()
            with torch.no_grad():
                self.positions.clamp_(-APERTURE / 2, APERTURE / 2)
            losses.append(float(loss.detach()))
            if progress:
                progress("steps", step + 1, steps)
        return losses

    def mask(self) -> Mask:
        """Return the learned sensors, with learned weights for the direct method."""
        places = self.positions.detach().numpy().copy()
        weights = self.logarithm.exp().detach().numpy() if self.method == "direct" else None
        return custom_mask(places, APERTURE, weights)

    def _direct(self, traces: torch.Tensor) -> torch.Tensor:
        return self.direct(traces, positions=self.positions, weights=1e-8 * self.logarithm.exp())

    def _fitted(self, traces: torch.Tensor) -> torch.Tensor:
        """Return the non-negative image of a few accelerated gradient steps of least squares."""
        image = ahead = torch.zeros(self.forward.volume_shape)
        for number in range(UNROLLED):
            residual = self.forward(ahead, positions=self.positions) - traces
            slope = self.forward.adjoint(residual, positions=self.positions)
            new = torch.relu(ahead - slope / self.norm)
            image, ahead = new, new + number / (number + 3) * (new - image)
        return image

    def _norm(self) -> float:
        """Return the largest eigenvalue of AᵀA with a margin, by power iteration."""
        x = torch.rand(self.forward.volume_shape, generator=self.random)
        size = 1.0
        with torch.no_grad():
            for _ in range(15):
                x = self.forward.adjoint(self.forward(x / x.norm()))
                size = float(x.norm())
        return 1.3 * size


def learned_positions(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Compare learned sensors with all candidates of ``mask compare`` on objects that were not learned from.

    Parameters
    ----------
    quick
        Two steps of one training, one object of a kind, no iterative images.
    progress
        Called after each step of a training.

    Returns
    -------
    list of dict
        One row a mask: mean correlation around the point of interest by kind of object and method. Learned ones have
        the mask they began with in ``start``.
    """
    rows = [judged({"mask": name}, begin(name), quick=quick) for name in ARRANGEMENTS]
    rows.append(judged({"mask": "staged"}, None, quick=quick))
    for training in TRAININGS[: 1 if quick else None]:
        trainer = Trainer(begin(training.start), training.kind, training.method)
        trainer.learn(2 if quick else STEPS[training.method], moving=training.moving, progress=progress)
        rows.append(judged(training.named, trainer.mask(), quick=quick))
    return rows


def begin(name: Counted) -> Mask:
    """Return an arrangement of about 300 points for the point of interest."""
    return mask_by_count(name, APERTURE, COUNT, depth=POINT[2], offset=POINT[:2])


def judged(named: Row, mask: Mask | None, *, quick: bool = False) -> Row:
    """Return the row of a mask, or of scans in stages: mean correlations with held-out objects."""
    row: Row = named | {"points": COUNT if mask is None else mask.count}
    for tried in KINDS:
        found = [_correlations(mask, tried, seed, quick=quick) for seed in range(1 if quick else OBJECTS)]
        for name in found[0]:
            row[f"{tried}_{name}"] = float(np.mean([each[name] for each in found]))
    return row


def _correlations(mask: Mask | None, kind: str, seed: int, *, quick: bool) -> dict[str, float]:
    simulation = Simulation(
        phantom(kind, POINT, RADIUS, seed=seed), POINT[:2], REGION, noise=NOISE, modes=MODES,
        sampling_interval=INTERVAL, iterations=0 if quick else ITERATIONS, seed=seed,
    )  # fmt: skip
    used = StagedScan(APERTURE, COUNT, seed=seed).build(simulation)[0] if mask is None else mask
    return {str(method): found.around for method, found in simulation.simulate(used).by.items()}


def _object(kind: str, seed: int, like: Volume) -> torch.Tensor:
    return torch.from_numpy(rasterise(phantom(kind, POINT, RADIUS, seed=seed), like).values.astype(np.float32))
