"""Detection of a usable CUDA device in a subprocess."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec

_ASK = "from steradian.imaging.engines.cuda.array_backend import device; print(device().name)"
_PATIENCE = 60.0  # seconds; a driver may have to load first


def detect_gpu() -> str | None:
    """Return the name of the usable GPU; None without a GPU or the extra ``gpu``.

    A process of its own looks: CuPy is large, and who has looked keeps a part of the GPU's memory.
    """
    if find_spec("cupy") is None and "STERADIAN_GPU" not in os.environ:
        return None
    command = [sys.executable, "-P", "-c", _ASK]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
