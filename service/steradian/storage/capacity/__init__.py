"""Disk reserve and disk usage of the data folder."""
