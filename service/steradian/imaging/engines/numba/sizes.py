"""Numbers that kernels and their callers share."""

BATCH = 32
"""Samples or depths of a cell."""
PAD = 24
"""Cells repeated at either end of a spectrum, so that no stencil has to wrap: half of the widest window."""
PIECE = 64
"""Values of l interpolated for all groups of a block in turn: what they read then stays in the first cache."""
