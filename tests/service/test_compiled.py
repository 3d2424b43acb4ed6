"""Compiled loops: what is kept on disk is what the sources say, and checked kernels stay within their arrays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from steradian.imaging.iterative.proximal import proximal

CALLER = """
from steradian.core.jit import jit
from inner import factor

@jit
def scaled(x):
    return factor() * x
"""
CALLEE = """
from steradian.core.jit import jit

@jit
def factor():
    return {}
"""
KILLED = """
import os
from numba.core.caching import IndexDataCacheFile
save = IndexDataCacheFile._save_data
IndexDataCacheFile._save_data = lambda file, name, data: os._exit(9) if "scaled" in name else save(file, name, data)
"""
SLOW = """
import sys
from steradian.core.jit import jit
from inner import factor

@jit
def slow(x):
    total = 0.0
    for i in range(x):
        total += sum([{}]) * factor()
    return total

print("ready", flush=True)
sys.stdin.readline()
slow(3)
print(sum(slow.stats.cache_misses.values()) + sum(factor.stats.cache_misses.values()))
"""
BEYOND = """
import sys
import numpy as np
from steradian.core.jit import jit
from steradian.imaging.engines.numba.simd import transpose_gather, transpose_scatter, load16, store

@jit
def read(a, at):
    store(a, 0, load16(a, at))

@jit
def write(a, at):
    store(a, at, load16(a, 0))

@jit
def gather(a, at):
    rows = np.full(16, at)
    transpose_gather(a, rows, 0, np.empty(512, a.dtype), 0)

@jit
def scatter(a, at):
    rows = np.full(16, at)
    transpose_scatter(np.zeros(512, a.dtype), 0, a, rows, 0)

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


@pytest.mark.long
def test_a_change_to_a_callee_in_another_file_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(CALLER)
    inner, found = tmp_path / "inner.py", []
    for factor in (2, 3):
        inner.write_text(CALLEE.format(factor))
        os.utime(inner, (1e9, 1e9))  # as long, and in the same second: Python's own bytecode would be taken for it
        found += _run("from outer import scaled; print(scaled(10))", tmp_path, PYTHONDONTWRITEBYTECODE="1")
    assert found == ["20", "30"]
    again = "from outer import scaled; scaled(10); print(sum(scaled.stats.cache_hits.values()))"
    assert _run(again, tmp_path) == ["1"]


@pytest.mark.long
def test_jit_cache_write_killed_midway_leaves_no_stale_version(tmp_path: Path) -> None:
    outer = tmp_path / "outer.py"
    (tmp_path / "inner.py").write_text(CALLEE.format(2))
    use = "from outer import scaled; print(scaled(10))"
    outer.write_text(CALLER)
    assert _run(use, tmp_path) == ["20"]
    outer.write_text(CALLER.replace("factor() * x", "factor() * x + 1"))
    with pytest.raises(AssertionError):
        _run(KILLED + use, tmp_path)
    assert _run(use, tmp_path) == ["21"]


@pytest.mark.long
def test_is_uncached_is_true_only_for_cacheable_uncompiled_signatures(tmp_path: Path) -> None:
    (tmp_path / "inner.py").write_text(CALLEE.format(2))
    (tmp_path / "outer.py").write_text(CALLER + "nowhere = jit(lambda x: x, kept=False)")
    program = """
import numpy as np
from outer import nowhere, scaled
from steradian.core.jit import is_uncached
print(*(is_uncached(function, numbers) for function in (nowhere, scaled) for numbers in ("float32", "float64")))
scaled(np.zeros(2, np.float32))
"""
    assert _run(program, tmp_path) == ["False False True True"]
    assert _run(program, tmp_path) == ["False False False True"]
    assert _run(program, tmp_path, NUMBA_CPU_NAME="generic") == ["False False True True"]


@pytest.mark.long
def test_a_function_for_compiled_ones_only_refuses_a_call_from_python_instead_of_crashing(tmp_path: Path) -> None:
    callee = CALLEE.replace("@jit", "@jit_inline").replace("import jit", "import jit_inline")
    (tmp_path / "inner.py").write_text(callee.format(2))
    (tmp_path / "outer.py").write_text(CALLER)
    program = "from outer import factor, scaled\nprint(scaled(10))\ntry: factor()\nexcept TypeError as e: print(e)"
    for _ in ("compiled", "loaded"):
        assert _run(program, tmp_path) == ["20", "factor is called by compiled functions only"]


@pytest.mark.long
def test_jit_cache_beside_source_is_reused_only_on_same_cpu_type(
    tmp_path: Path,
) -> None:
    (tmp_path / "inner.py").write_text(CALLEE.format(2))
    (tmp_path / "outer.py").write_text(CALLER)
    program = "from outer import scaled; print(scaled(10), sum(scaled.stats.cache_hits.values()))"
    assert _run(program, tmp_path, NUMBA_CACHE_DIR="") == ["20 0"]
    assert list(tmp_path.glob("__pycache__/*.nbc"))
    assert _run(program, tmp_path) == ["20 1"]
    assert not list(tmp_path.glob("cache/**/*.nbc"))
    assert _run(program, tmp_path, NUMBA_CPU_NAME="generic") == ["20 0"]
    assert list(tmp_path.glob("cache/**/*.nbc"))


@pytest.mark.long
def test_of_processes_that_need_a_function_at_once_one_compiles_it(tmp_path: Path) -> None:
    (tmp_path / "inner.py").write_text(CALLEE.format(2))
    (tmp_path / "slow.py").write_text(SLOW.format(", ".join(f"i ** {power}.5" for power in range(12))))
    there = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command, pipes = [sys.executable, "-c", "import slow"], {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    found = [subprocess.Popen(command, env=there, text=True, **pipes) for _ in range(3)]
    for process in found:
        assert process.stdout.readline() == "ready\n"
    for process in found:
        process.stdin.write("go\n")
        process.stdin.flush()
    missed = sorted(int(process.communicate(timeout=250)[0].split()[0]) for process in found)
    assert missed == [0, 0, 2]


@pytest.mark.long
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
