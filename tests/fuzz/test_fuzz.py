"""A short run of each fuzzer, and of its corpus without one."""

from __future__ import annotations

import importlib.util
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from targets import TARGETS  # noqa: E402


@pytest.mark.parametrize("name", TARGETS)
def test_the_corpus_and_seeded_variations_of_it_crash_nothing(name):
    source = random.Random(1)
    corpus = [path.read_bytes() for path in sorted((HERE / "corpus" / name).iterdir())]
    assert corpus
    for data in corpus:
        TARGETS[name](data)
    for _ in range(300):
        data = bytearray(source.choice(corpus))
        for _ in range(source.randrange(1, 6)):
            at = source.randrange(len(data) + 1)
            data[at : at + source.randrange(4)] = source.randbytes(source.randrange(6))
        TARGETS[name](bytes(data))


@pytest.mark.long
@pytest.mark.fuzz
@pytest.mark.parametrize("name", TARGETS)
def test_a_short_run_of_the_fuzzer_finds_nothing(name, tmp_path):
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("atheris is not installed: pip install atheris")
    command = [sys.executable, str(HERE / "fuzz.py"), name, str(tmp_path), str(HERE / "corpus" / name)]
    run = subprocess.run(
        # libFuzzer's own limit would count what this process, from which it is forked, has had at most
        [*command, "-runs=1500", "-seed=1", "-max_len=2000", "-rss_limit_mb=0", "-malloc_limit_mb=512"],
        cwd=tmp_path,
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert run.returncode == 0, run.stderr[-2000:]
