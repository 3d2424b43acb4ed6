# %% [markdown]
# # Vessels from few points
#
# A mask, the A-lines that a scanner would record through it, the image, and slices of the image by place.

# %%
import matplotlib.pyplot as plt

import steradian
from steradian.phantoms import pressure, vessels

# %% [markdown]
# 1,600 points, each of which covers the same solid angle seen from 3 mm below the middle of the sensor, and a tree of
# vessels around that place. Lengths are metres, times seconds.

# %%
mask = steradian.equi_steradian_mask(aperture=10e-3, depth=3e-3, count=1600)
balls = vessels(3, centre=(0.0, 0.0, 3e-3), radius=2.5e-3)
traces = pressure(balls, mask.positions, samples=400, sampling_interval=16e-9, sound_speed=1500.0)
acquisition = steradian.Acquisition(traces, mask, dt=16e-9, sound_speed=1500.0)
mask

# %% [markdown]
# The image, z being the depth.

# %%
volume = steradian.reconstruct(acquisition, steradian.ImageGrid(modes=128, depth=(1.5e-3, 4.5e-3)))
volume

# %% [markdown]
# As an xarray the image knows its places: slices are asked for in metres, and plots have their axes.

# %%
image = volume.to_xarray()
below = image.sel(y=0.0, method="nearest").sel(x=slice(-3e-3, 3e-3))
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.2), layout="constrained")
mask.plot(axes=left)
volume.plot("z", axes=middle)
middle.set_title("From above: largest along z")
below.plot(ax=right, x="x", yincrease=False, cmap="inferno", vmin=0.0, vmax=0.7)
right.set(title="From the side: y = 0", aspect="equal")
right.ticklabel_format(scilimits=(-3, -3))
figure.savefig("vessels-from-few-points.png", dpi=90)

# %%
brightest = image.isel(image.argmax(...))
print(f"brightest at {1e3 * brightest.x:.2f}, {1e3 * brightest.y:.2f}, {1e3 * brightest.z:.2f} mm")
