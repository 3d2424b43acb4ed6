"""What reading a damaged HDF5 file raises."""

from __future__ import annotations

from typing import Final

BROKEN: Final = (KeyError, IndexError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError)
"""Beside ``OSError``; a dataset may have turned into a type or a group, and a text that is none is a ``ValueError``.

``InvalidInput`` is a ``ValueError``, too: where a block refuses anything, ``SteradianError`` is let through before.
"""
