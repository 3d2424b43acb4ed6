# %% [markdown]
# # Direct and iterative
#
# The same few A-lines reconstructed twice, and both images beside the truth, which a simulation knows.

# %%
import matplotlib.pyplot as plt
import xarray

import steradian
from steradian.phantoms import pressure, rasterise, yarn

# %%
mask = steradian.equi_steradian_mask(aperture=10e-3, depth=3e-3, count=800)
balls = yarn(1, centre=(0.0, 0.0, 3e-3), radius=2.5e-3)
traces = pressure(balls, mask.positions, samples=400, sampling_interval=16e-9, sound_speed=1500.0)
acquisition = steradian.Acquisition(traces, mask, dt=16e-9, sound_speed=1500.0)

# %% [markdown]
# Both ways with the same voxels. Of a dataset every operation is done to each image.

# %%
voxels = steradian.ImageGrid(modes=96, depth=(1.5e-3, 4.5e-3))
direct = steradian.reconstruct(acquisition, voxels)
iterative = steradian.reconstruct(acquisition, voxels, steradian.Iterative())
truth = rasterise(balls, direct)
images = xarray.Dataset({"truth": truth.to_xarray(), "direct": direct.to_xarray(), "iterative": iterative.to_xarray()})

# %%
seen = images.max("z") / images.max()
figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
for plot, (name, projection) in zip(axes, seen.items(), strict=True):
    likeness = xarray.corr(images[name], images["truth"])
    projection.plot(ax=plot, x="x", cmap="inferno", vmin=0, vmax=1, add_colorbar=False)
    plot.ticklabel_format(scilimits=(-3, -3))
    plot.set(title=f"{name}, correlation {float(likeness):.2f}", aspect="equal")
    print(f"{name}: correlation with the truth {float(likeness):.2f}")
figure.savefig("direct-and-iterative.png", dpi=90)
