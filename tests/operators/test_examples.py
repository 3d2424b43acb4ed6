"""Examples and snippets of the page of operators: they run as they stand, and make the pictures of the page."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "operators.md").read_text("utf-8")
EXAMPLES = sorted((ROOT / "examples" / "operators").glob("*.py"))
SCAN, *SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, re.S)
LIBRARIES = ("torch", "jax", "deepinv", "pylops")
PREPARED = """
import runpy, sys
from support.torchvision_operators import define_missing_operators
define_missing_operators()
runpy.run_path(sys.argv[1], run_name="__main__")
"""
FIGURES = {
    "learned_threshold": (r"after: correlation (\S+)", 0.92, 1.0),
    "plug_and_play": (r"plug and play: correlation with the truth (\S+)", 0.85, 1.0),
    "sensors_moved_by_gradient": (r"mean error of positions .* before, (\S+) µm after", 0.0, 10.0),
}
"""By example: pattern of the figure of merit that it prints, and its range."""


def run(script: Path, folder: Path) -> str:
    """Run a script in a folder, with warnings as errors; outside of Numba's simulator, which pylops does not know."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_ENABLE_CUDASIM"}
    paths = [str(ROOT / "tests"), *filter(None, [environment.get("PYTHONPATH")])]
    environment |= {"MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-W", "error", "-c", PREPARED, str(script)]
    ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def grey(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("L"), float)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_makes_its_picture_and_its_figure(example: Path, tmp_path: Path) -> None:
    said = run(example, tmp_path)
    pattern, least, most = FIGURES[example.stem]
    found = re.search(pattern, said)
    assert found is not None, said
    assert least <= float(found[1]) <= most
    (made,) = tmp_path.iterdir()
    shown = grey(ROOT / "docs" / "operators" / made.name)
    assert grey(made).shape == shown.shape
    assert np.corrcoef(grey(made).ravel(), shown.ravel())[0, 1] > 0.9


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("library", "snippet"), list(zip(LIBRARIES, SNIPPETS, strict=True)), ids=LIBRARIES)
def test_a_snippet_of_the_page_runs(library: str, snippet: str, tmp_path: Path) -> None:
    assert re.search(rf"^import {library}$", snippet, re.M)
    script = tmp_path / "snippet.py"
    script.write_text(SCAN + snippet, "utf-8")
    assert run(script, tmp_path).strip()


def test_the_page_shows_every_example_and_its_picture() -> None:
    linked = re.findall(r"\]\(\.\./examples/operators/([^)]+)\)", PAGE)
    assert sorted(linked) == [example.name for example in EXAMPLES]
    pictures = re.findall(r"!\[[^]]+\]\(operators/([^)]+)\)", PAGE)
    assert sorted(pictures) == sorted(path.name for path in (ROOT / "docs" / "operators").iterdir())
