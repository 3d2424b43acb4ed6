"""Masks and plans as files between the commands."""

from steradian.plans.files import read_value, write_value

__all__ = ["read_value", "write_value"]
