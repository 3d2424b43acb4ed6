"""Volume files: reader, pyramid, projections, images and the Zarr view."""
