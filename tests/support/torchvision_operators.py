"""Definitions of torchvision's compiled operators, where its wheel is for another PyTorch."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path


def define_missing_operators() -> None:
    """Define torchvision's own operators, which deepinv does not use, where its compiled part is for another PyTorch.

    torchvision of the package index is compiled for PyTorch with CUDA, and refuses to be imported beside one without.
    """
    import torch

    found = importlib.util.find_spec("torchvision")
    if found is None or found.origin is None or torch.version.cuda is not None:
        return
    text = (Path(found.origin).parent / "_meta_registrations.py").read_text()
    names = {*re.findall(r"torchvision::(\w+)", text), *re.findall(r'register_meta\("(\w+)"', text)}
    library = torch.library.Library("torchvision", "FRAGMENT")
    for name in names:
        library.define(f"{name}(Tensor values) -> Tensor")
    _kept.append(library)  # they go with it


_kept: list[object] = []
