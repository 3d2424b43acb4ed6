# %% [markdown]
# # Plug and play with deepinv
#
# An image of few A-lines by deepinv's FISTA, whose proximal step is a denoiser, beside the library's own methods.

# %%
import deepinv
import matplotlib.pyplot as plt
import numpy as np
import torch

import steradian
import steradian.deepinv
from steradian.phantoms import add_noise, pressure, rasterise, yarn

# %% [markdown]
# 300 A-lines of a yarn, with noise 25 dB below the largest sample. Lengths are metres, times seconds.

# %%
mask = steradian.equi_steradian_mask(aperture=4.5e-3, depth=1.5e-3, count=300)
balls = yarn(2, centre=(0.0, 0.0, 1.5e-3), radius=1.2e-3)
timing = {"samples": 128, "sampling_interval": 24e-9, "sound_speed": 1500.0}
traces = add_noise(pressure(balls, mask.positions, **timing), 25.0)
geometry = steradian.AcquisitionGeometry(mask, 128, dt=24e-9, sound_speed=1500.0)
grid = steradian.ImageGrid(modes=56, depth=(0.7e-3, 2.3e-3))

# %% [markdown]
# The physics is divided by its largest singular value, so that a step size of 1 converges; measurements are divided
# by the same number. `A_dagger` is the direct reconstruction.

# %%
physics = steradian.deepinv.PlanarPhotoacoustics(geometry, grid, normalise=True)
measured = torch.from_numpy(traces.astype(np.float32))[None, None] / physics.norm

# %% [markdown]
# The denoiser is deepinv's total variation of volumes, and needs no trained weights; negative pressure is cut off.
# Any other denoiser of tensors (B, C, X, Y, Z) fits in here.


# %%
class NonNegative(torch.nn.Module):
    """Non-negative result of total variation denoising; ``sigma`` is its threshold."""

    def __init__(self):
        super().__init__()
        self.denoiser = deepinv.models.TVDenoiser(n_it_max=10)

    def forward(self, image, sigma):
        """Return the denoised image."""
        return self.denoiser(image, ths=sigma).relu()


solver = deepinv.optim.FISTA(
    data_fidelity=deepinv.optim.L2(),
    prior=deepinv.optim.PnP(denoiser=NonNegative()),
    stepsize=1.0,
    sigma_denoiser=0.02,
    max_iter=80,
)
with torch.no_grad():
    found = solver(measured, physics)[0, 0].numpy()

# %%
acquisition = geometry.acquisition(traces)
direct = steradian.reconstruct(acquisition, grid)
iterative = steradian.reconstruct(acquisition, grid, steradian.Iterative())
truth = rasterise(balls, direct).values
images = {
    "truth": truth,
    "direct": direct.values,
    "iterative": iterative.values,
    "plug and play": found,
}

# %%
figure, axes = plt.subplots(1, 4, figsize=(15, 4), layout="constrained")
for plot, (name, image) in zip(axes, images.items(), strict=True):
    likeness = np.corrcoef(truth.ravel(), image.ravel())[0, 1]
    print(f"{name}: correlation with the truth {likeness:.3f}")
    plot.imshow(image.max(axis=2).T, origin="lower", cmap="inferno", vmin=0, extent=(-2.25, 2.25, -2.25, 2.25))
    plot.set(title=f"{name}, correlation {likeness:.3f}", xlabel="x (mm)", ylabel="y (mm)")
figure.savefig("plug-and-play.png", dpi=80)
