"""CUDA engine; CuPy and numba-cuda (extra ``gpu``) are imported only when an engine is created."""
