# %% [markdown]
# # Learned step sizes and thresholds
#
# A few proximal gradient steps, whose step sizes and thresholds are learned from yarns, on vessels.

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch

import steradian
import steradian.torch
from steradian.phantoms import add_noise, pressure, rasterise, vessels, yarn

# %% [markdown]
# 300 sensors, and the A-lines of any balls with noise 30 dB below the largest sample.

# %%
mask = steradian.equi_steradian_mask(aperture=4.5e-3, depth=1.5e-3, count=300)
geometry = steradian.AcquisitionGeometry(mask, 128, dt=24e-9, sound_speed=1500.0)
grid = steradian.ImageGrid(modes=56, depth=(0.7e-3, 2.3e-3))
model = steradian.torch.ForwardOperator(geometry, grid, tolerance=1e-3)
inverse = steradian.torch.DirectReconstruction(geometry, grid, steradian.Nufft(tolerance=1e-3))
like = steradian.reconstruct(geometry.acquisition(np.zeros(model.trace_shape)), grid)


def example(balls, seed):
    """Return A-lines and true image of an object."""
    clean = pressure(balls, mask.positions, samples=128, sampling_interval=24e-9, sound_speed=1500.0)
    pair = add_noise(clean, 30.0, seed=seed), rasterise(balls, like).values
    return [torch.from_numpy(values.astype(np.float32)) for values in pair]


place = {"centre": (0.0, 0.0, 1.5e-3), "radius": 1.2e-3}
training = [example(yarn(seed, **place), seed) for seed in range(4)]
held_out = [example(vessels(seed, **place), seed) for seed in range(3, 6)]

# %% [markdown]
# Each step goes down the gradient of the data misfit, and subtracts a threshold. It begins with the direct image. Step
# sizes count in those of the largest singular value, and thresholds in the largest voxel of the direct image.


# %%
STEPS = 6


class Unrolled(torch.nn.Module):
    """Proximal gradient method of a fixed number of steps with learned step sizes and thresholds."""

    def __init__(self):
        super().__init__()
        self.sizes = torch.nn.Parameter(torch.zeros(STEPS))
        self.thresholds = torch.nn.Parameter(torch.full((STEPS,), -6.0))
        image = torch.ones(model.volume_shape)
        with torch.no_grad():
            for _ in range(15):
                image = model.adjoint(model(image / image.norm()))
        self.largest = image.norm()

    def forward(self, traces):
        """Return the image of A-lines."""
        image = inverse(traces).relu()
        scale = image.max()
        for size, threshold in zip(self.sizes.exp(), self.thresholds.exp(), strict=True):
            slope = model.adjoint(traces - model(image)) / self.largest
            image = (image + size * slope - threshold * scale).relu()
        return image


def loss(network, pairs):
    """Return the mean of 1 minus the correlation of image and truth."""
    correlations = [torch.corrcoef(torch.stack([network(y).ravel(), x.ravel()]))[0, 1] for y, x in pairs]
    return 1 - torch.stack(correlations).mean()


# %%
network = Unrolled()
with torch.no_grad():
    first = network(held_out[0][0])
    print(f"held-out vessels before: correlation {1 - float(loss(network, held_out)):.3f}")
solver = torch.optim.Adam(network.parameters(), lr=0.15)
course = []
for step in range(32):
    solver.zero_grad()
    value = loss(network, [training[step % len(training)]])
    value.backward()
    solver.step()
    course.append(float(value.detach()))
with torch.no_grad():
    learned = network(held_out[0][0])
    print(f"held-out vessels after: correlation {1 - float(loss(network, held_out)):.3f}")
print("step sizes", np.round(network.sizes.detach().exp().numpy(), 2))
print("thresholds", np.round(network.thresholds.detach().exp().numpy(), 4))

# %%
traces, truth = held_out[0]
images = {"truth": truth, "direct": inverse(traces), "before learning": first, "after": learned}
figure, axes = plt.subplots(1, 5, figsize=(18, 4), layout="constrained")
axes[0].plot(course)
axes[0].set(title="1 − correlation in training", xlabel="step", yscale="log")
for plot, (name, image) in zip(axes[1:], images.items(), strict=True):
    likeness = float(torch.corrcoef(torch.stack([image.ravel(), truth.ravel()]))[0, 1])
    plot.imshow(image.numpy().max(axis=2).T, origin="lower", cmap="inferno", vmin=0, extent=(-2.25, 2.25, -2.25, 2.25))
    plot.set(title=f"{name}, correlation {likeness:.3f}", xlabel="x (mm)", ylabel="y (mm)")
figure.savefig("learned-threshold.png", dpi=80)
