"""Constants shared by the CPU kernels and their callers."""

from steradian.imaging.transforms.windows import MAX_TAPS

BATCH = 32
"""Samples or depths of a cell."""
CACHE_LINE_BYTES = 64
"""Bytes of a line of the processor's caches."""
CELL_PADDING = MAX_TAPS // 2
"""Cells repeated at either end of a spectrum, so that no stencil has to wrap: half of the widest window."""
DEPTH_CHUNK = 64
"""Values of l interpolated for all groups of a block in turn: what they read then stays in the first cache."""
