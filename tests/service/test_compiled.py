"""Compiled loops: what is kept on disk is what the sources say, and checked kernels stay within their arrays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from steradian.imaging.regularisers import proximal

CALLER = """
from steradian.compiled import compiled
from inner import factor

@compiled
def scaled(x):
    return factor() * x
"""
CALLEE = """
from steradian.compiled import compiled

@compiled
def factor():
    return {}
"""
BEYOND = """
import sys
import numpy as np
from steradian.compiled import compiled
from steradian.imaging.engines.numba.simd import collect, distribute, load16, store

@compiled
def read(a, at):
    store(a, 0, load16(a, at))

@compiled
def write(a, at):
    store(a, at, load16(a, 0))

@compiled
def gather(a, at):
    rows = np.full(16, at)
    collect(a, rows, 0, np.empty(512, a.dtype), 0)

@compiled
def scatter(a, at):
    rows = np.full(16, at)
    distribute(np.zeros(512, a.dtype), 0, a, rows, 0)

for kernel in (read, write, gather, scatter):
    line = np.zeros(2048, np.float32)[1000:1032]  # wrong indices reach nothing of anybody else's
    for at in (0, 16, 17, -1):
        try:
            kernel(line, at)
            print(kernel.__name__, at, "within")
        except IndexError:
            print(kernel.__name__, at, "refused")
"""


def _run(program: str, folder: Path, **environment: str) -> list[str]:
    there = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache"), **environment}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, env=there)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_a_change_to_a_callee_in_another_file_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(CALLER)
    found = []
    for factor in (2, 3):
        (tmp_path / "inner.py").write_text(CALLEE.format(factor))
        found += _run("from outer import scaled; print(scaled(10))", tmp_path)
    assert found == ["20", "30"]
    again = "from outer import scaled; scaled(10); print(sum(scaled.stats.cache_hits.values()))"
    assert _run(again, tmp_path) == ["1"]


def test_where_bounds_are_checked_no_vector_reaches_beyond_its_array(tmp_path: Path) -> None:
    (tmp_path / "beyond.py").write_text(BEYOND)
    told = [line.split() for line in _run("import beyond", tmp_path, NUMBA_BOUNDSCHECK="1")]
    assert len(told) == 16
    for _, at, answer in told:
        assert answer == ("within" if at in ("0", "16") else "refused")


@pytest.mark.parametrize("non_negative", [True, False])
def test_total_variation_is_bounded_below_only_where_asked(non_negative: bool) -> None:
    u = np.random.default_rng(0).standard_normal((6, 5, 7)).astype(np.float32)
    step = proximal("total-variation", non_negative=non_negative, shape=u.shape, spacing=(1.0, 1.0, 1.0), threads=1)
    found = np.empty_like(u)
    step(u.copy(), found, 1e-6)
    np.testing.assert_allclose(found, np.maximum(u, 0) if non_negative else u, atol=1e-5)
