"""Maintenance of data folder and database: start-up checks, permissions, snapshots."""
