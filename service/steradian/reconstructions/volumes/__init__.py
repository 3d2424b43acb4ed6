"""Volume files: writer, reader, resolution pyramid, projections, images and Zarr view."""
