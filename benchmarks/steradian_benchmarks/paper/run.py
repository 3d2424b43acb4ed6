"""Runner of the paper's benchmark: executes the sections and stores their measurements in one JSON document."""

from __future__ import annotations

import json
import os
import platform
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

from steradian._version import __version__
from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian_benchmarks.paper.page import page, put_into_readme
from steradian_benchmarks.paper.sections import SectionContext, sections

Document: TypeAlias = dict[str, Any]


def paper(
    output: Path,
    *,
    quick: bool = False,
    only: tuple[str, ...] = (),
    readme: Path | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Document:
    """Reproduce the paper's experiments and write ``paper.md``, ``paper/paper.json`` and the pictures into ``output``.

    Parameters
    ----------
    output
        Folder for the page; pictures and JSON go into ``paper`` below it.
    quick
        Small versions: whether everything runs, no measurement.
    only
        Names of the sections to measure; the others keep what the JSON there holds of them. Empty: all.
    readme
        A file whose block between the markers is replaced by a summary.
    progress, cancelled
        Told and asked between pieces of work, the stage being the section's name.

    Returns
    -------
    dict
        The document: provenance, and ``sections`` with what each measured and its ``seconds``.

    Raises
    ------
    InvalidInput
        When a section is unknown.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = sections(only)
    folder = output / "paper"
    folder.mkdir(parents=True, exist_ok=True)
    store = folder / "paper.json"
    parts = json.loads(store.read_text("utf-8"))["sections"] if only and store.exists() else {}
    for section in chosen:

        def step(done: int, total: int, name: str = section.name) -> None:
            if cancelled is not None and cancelled():
                raise Cancelled
            if progress is not None:
                progress(name, done, total)

        begin = time.perf_counter()
        part = section.measure(SectionContext(quick=quick, folder=folder, step=step))
        parts[section.name] = {**part, "seconds": round(time.perf_counter() - begin, 1), "quick": quick}
    # through JSON and back, so that the page is made of what the file holds
    document: Document = json.loads(json.dumps({**_provenance(), "sections": parts}, allow_nan=False))
    _replace(store, json.dumps(document, indent=1) + "\n")
    _replace(output / "paper.md", page(document))
    if readme is not None:
        _replace(readme, put_into_readme(readme.read_text("utf-8"), document))
    return document


def _provenance() -> Document:
    return {
        "benchmark": "paper",
        "measured": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"steradian {__version__}",
        "machine": {"cpus": os.cpu_count(), "system": platform.system(), "python": platform.python_version()},
    }


def _replace(path: Path, text: str) -> None:
    draft = path.with_name(path.name + ".new")
    draft.write_text(text, "utf-8")
    draft.replace(path)
