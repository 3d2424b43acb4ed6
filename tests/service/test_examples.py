"""The examples run as they stand, and make the pictures that the documentation shows."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "notebooks.md").read_text()
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def grey(path):
    with Image.open(path) as picture:
        return np.asarray(picture.convert("L"), float)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_makes_its_picture(example, tmp_path):
    """As a script, which runs a notebook's cells one after the other; any warning is an error."""
    environment = os.environ | {"MPLBACKEND": "Agg"}
    ran = subprocess.run([sys.executable, "-W", "error", example], cwd=tmp_path, env=environment, capture_output=True)
    assert ran.returncode == 0, ran.stderr.decode()
    (made,) = tmp_path.iterdir()
    shown = grey(ROOT / "docs" / "pictures" / made.name)
    assert grey(made).shape == shown.shape
    assert np.corrcoef(grey(made).ravel(), shown.ravel())[0, 1] > 0.95


def test_the_page_shows_every_example_and_its_picture():
    assert {ROOT / "docs" / link for link in re.findall(r"\]\((\.\./examples/[^)]+)\)", PAGE)} == {
        ROOT / "docs" / ".." / "examples" / example.name for example in EXAMPLES
    }
    pictures = {ROOT / "docs" / link for link in re.findall(r"!\[[^]]+\]\(([^)]+)\)", PAGE)}
    assert pictures == set((ROOT / "docs" / "pictures").iterdir())


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_notebook_in_the_percent_format(example):
    """Cells begin with ``# %%``, the first one is a title, and what is no code is a comment."""
    text = example.read_text()
    first, *cells = re.split(r"^# %%.*\n", text, flags=re.M)
    assert first == ""
    assert len(cells) > 4
    assert text.startswith("# %% [markdown]\n# # ")
    for kind, cell in zip(re.findall(r"^# %%(.*)$", text, re.M), cells, strict=True):
        lines = cell.rstrip().splitlines()
        assert lines
        if kind == " [markdown]":
            assert all(line.startswith("#") for line in lines)
        else:
            compile(cell, example.name, "exec")
