"""The data folder: layout, job folders, and small files shared between processes."""
