"""The data folder: layout, job folders, and blocks shared between processes."""
