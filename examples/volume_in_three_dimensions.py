# %% [markdown]
# # A volume in three dimensions
#
# PyVista shows a volume on the screen, in a notebook or, as here, in a picture; napari in a window.

# %%
import pyvista

import steradian
from steradian.phantoms import pressure, vessels

# %%
mask = steradian.equi_steradian_mask(aperture=10e-3, depth=3e-3, count=1600)
balls = vessels(3, centre=(0.0, 0.0, 3e-3), radius=2.5e-3)
traces = pressure(balls, mask.positions, samples=400, sampling_interval=16e-9, sound_speed=1500.0)
acquisition = steradian.Acquisition(traces, mask, dt=16e-9, sound_speed=1500.0)
volume = steradian.reconstruct(acquisition, steradian.ImageGrid(modes=128, depth=(1.5e-3, 4.5e-3)))

# %% [markdown]
# In PyVista a volume is a grid whose first axis runs fastest. In millimetres, with the depth downwards.

# %%
image = volume.to_xarray()
spacing = [1e3 * step for step in volume.spacing]
grid = pyvista.ImageData(dimensions=image.shape, spacing=spacing, origin=[1e3 * first for first in volume.origin])
grid["initial pressure"] = image.values.ravel(order="F")

plotter = pyvista.Plotter(off_screen=True, window_size=(900, 650))
walls = grid.contour([0.25 * float(image.max())])
bar = {"title": "depth (mm)", "vertical": True, "position_x": 0.86, "position_y": 0.25, "height": 0.5, "fmt": "%.1f"}
plotter.add_mesh(walls, scalars=walls.points[:, 2], cmap="viridis_r", scalar_bar_args=bar)
labels = {"xtitle": "x (mm)", "ytitle": "y (mm)", "ztitle": "z (mm)"}
plotter.show_bounds(
    grid="back", location="outer", n_xlabels=3, n_ylabels=3, n_zlabels=3, fmt="%.1f", font_size=9, **labels
)
plotter.view_vector((1.0, -1.6, -1.2), viewup=(0.0, 0.0, -1.0))
plotter.screenshot("volume-in-three-dimensions.png")
plotter.close()

# %% [markdown]
# napari needs a display, so this is to be copied:
#
# ```python
# import napari
#
# viewer = napari.Viewer(ndisplay=3)
# viewer.add_image(
#     image.values,
#     name="initial pressure",
#     axis_labels=image.dims,
#     scale=volume.spacing,
#     translate=volume.origin,
#     units="m",
#     colormap="inferno",
#     contrast_limits=(0, float(image.max())),
#     rendering="mip",
# )
# napari.run()
# ```
