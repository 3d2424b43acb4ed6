# %% [markdown]
# # Sensors moved by gradient
#
# Sensor positions, sound speed and time zero found from the A-lines of a known target, and an image of vessels with
# them.

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch

import steradian
import steradian.torch
from steradian.phantoms import Balls, add_noise, pressure, rasterise, vessels

# %% [markdown]
# 324 sensors. The scan mirror moves 4 % further than its calibration says, and 30 µm beside it; each position has an
# error of its own of 10 µm. The sound speed is assumed 15 m/s too high, and time zero 20 ns too late. Lengths are
# metres, times seconds.

# %%
mask = steradian.grid_mask(aperture=4.5e-3, count=18, interval=0.22e-3, centred=True)
random = np.random.default_rng(0)
true_places = 1.04 * mask.positions + (30e-6, -30e-6) + random.normal(0, 10e-6, mask.positions.shape)
true_speed, assumed_speed, assumed_time = 1500.0, 1515.0, 20e-9
recording = {"samples": 128, "sampling_interval": 24e-9, "sound_speed": true_speed}


def scan(balls):
    """Return the A-lines of an object with noise 30 dB below the largest sample."""
    return torch.from_numpy(add_noise(pressure(balls, true_places, **recording), 30.0).astype(np.float32))


geometry = steradian.AcquisitionGeometry(
    mask, 128, dt=24e-9, sound_speed=assumed_speed, t0=assumed_time, aperture=mask.aperture
)
grid = steradian.ImageGrid(modes=56, depth=(0.7e-3, 2.3e-3))
model = steradian.torch.ForwardOperator(geometry, grid, tolerance=1e-3)
inverse = steradian.torch.DirectReconstruction(geometry, grid, steradian.Nufft(tolerance=1e-3))

# %% [markdown]
# The target: twelve balls at known places. Without a known object its size and place would be exchangeable for
# magnification, sound speed and offset.

# %%
centres = np.column_stack([random.uniform(-1.4e-3, 1.4e-3, (12, 2)), random.uniform(1.1e-3, 1.9e-3, 12)])
target = Balls(centres, np.full(12, 80e-6), np.ones(12))
like = steradian.reconstruct(geometry.acquisition(np.zeros(model.trace_shape)), grid)
image = torch.from_numpy(rasterise(target, like).values.astype(np.float32))
measured = scan(target)

# %% [markdown]
# Parameters are scaled to the order of 1: displacements in 30 µm, speed in 10 m/s, time in 20 ns.

# %%
moved = torch.zeros(mask.positions.shape, dtype=torch.float64, requires_grad=True)
timing = torch.zeros(2, dtype=torch.float64, requires_grad=True)
nominal = torch.from_numpy(mask.positions.copy())


def calibration():
    """Return the sensor positions, sound speed and time zero of the parameters."""
    speed, time = assumed_speed + 10.0 * timing[0], assumed_time + 20e-9 * timing[1]
    return {"positions": nominal + 30e-6 * moved, "sound_speed": speed, "time_zero": time}


solver = torch.optim.Adam([moved, timing], lr=0.3)
falling = torch.optim.lr_scheduler.CosineAnnealingLR(solver, 80)
errors, speeds = [], []
for _ in range(80):
    solver.zero_grad()
    at = calibration()
    misfit = (model(image, **at) - measured).square().sum() / measured.square().sum()
    misfit.backward()
    solver.step()
    falling.step()
    found = at["positions"].detach().numpy()
    errors.append(1e6 * np.linalg.norm(found - true_places, axis=1).mean())
    speeds.append(float(at["sound_speed"].detach()))
print(f"mean error of positions {errors[0]:.1f} µm before, {errors[-1]:.1f} µm after")
print(f"sound speed {speeds[-1]:.2f} m/s, true {true_speed:g} m/s")
print(f"time zero {1e9 * float(at['time_zero'].detach()):.2f} ns, true 0 ns")

# %% [markdown]
# Vessels, recorded by the same scanner, with the positions of before and those found.

# %%
balls = vessels(3, centre=(0.0, 0.0, 1.5e-3), radius=1.0e-3)
traces, truth = scan(balls), rasterise(balls, like).values
with torch.no_grad():
    images = {"as calibrated": inverse(traces).numpy(), "with what was found": inverse(traces, **calibration()).numpy()}

# %%
figure, axes = plt.subplots(1, 4, figsize=(17, 4), layout="constrained")
axes[0].quiver(*(1e3 * mask.positions.T), *(1e3 * (found - mask.positions).T), angles="xy")
axes[0].set(title="displacements found (not to scale)", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
axes[1].semilogy(errors)
axes[1].set(title="mean error of positions", xlabel="step", ylabel="µm")
for plot, (name, found_image) in zip(axes[2:], images.items(), strict=True):
    likeness = np.corrcoef(truth.ravel(), found_image.ravel())[0, 1]
    print(f"vessels {name}: correlation with the truth {likeness:.3f}")
    plot.imshow(found_image.max(axis=2).T, origin="lower", cmap="inferno", vmin=0, extent=(-2.25, 2.25, -2.25, 2.25))
    plot.set(title=f"{name}, correlation {likeness:.3f}", xlabel="x (mm)", ylabel="y (mm)")
figure.savefig("sensors-moved-by-gradient.png", dpi=80)
