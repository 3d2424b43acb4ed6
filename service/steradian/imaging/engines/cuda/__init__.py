"""The engine on a CUDA device; CuPy and numba-cuda (extra ``gpu``) are imported when one is made, not before."""
