"""Disk quota and usage."""
