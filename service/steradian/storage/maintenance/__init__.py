"""Maintenance of the data folder: start-up checks, permissions, snapshots."""
