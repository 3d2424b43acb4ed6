"""Disk quota and disk usage of the data folder."""
