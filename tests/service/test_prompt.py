"""A person at Python's prompt: what objects show of themselves, and what wrong calls are told."""

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing.scan_writer import ImportedAline

pexpect = pytest.importorskip("pexpect")

TRANSCRIPT = Path(__file__).with_name("prompt.txt")
"""What is typed after >>>, and what comes; … stands for anything within a line, as does the way to an error."""
PROMPT = "\r\n>>> "
ERROR = "steradian.core.exceptions."


def exchanges():
    """Each command of the transcript and the lines that answer it."""
    for part in TRANSCRIPT.read_text(encoding="utf-8").split(">>> ")[1:]:
        command, *answer = part.strip("\n").split("\n")
        yield command, [line for line in answer if line]


@pytest.fixture
def folder(tmp_path):
    """With a scan in it of which 40 A-lines are stored."""
    plan = ScanPlan.create(mask=equi_steradian_mask(10e-3, 3e-3, 60), samples=128)
    create_scan_file(tmp_path / "scan.h5", plan, scan_id="s1", scanner="sim", simulated=True)
    traces = np.random.default_rng(1).integers(-900, 900, (40, 128)).astype(np.int16)
    told = {"scale": 1e-3, "energy": 1.0, "wavelength_m": 1.55e-6, "fire_time_s": 0.0, "quality": 0, "shot": 1}
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        rows = np.arange(plan.mask.count)
        store.append([ImportedAline(row, trace, **told) for row, trace in enumerate(traces)], rows)
    return tmp_path


@pytest.fixture
def prompt(folder):
    """A real Python on a real terminal, so wide that no line is folded."""
    environment = os.environ | {"TERM": "dumb", "PYTHON_BASIC_REPL": "1", "NO_COLOR": "1", "MPLBACKEND": "agg"}
    child = pexpect.spawn(
        sys.executable, ["-q", "-i"], cwd=str(folder), env=environment, encoding="utf-8", dimensions=(50, 1000),
        timeout=300,
    )  # fmt: skip
    child.expect(">>> ")
    yield child
    child.sendeof()
    child.expect(pexpect.EOF)
    child.close()


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_transcript_of_a_session_at_the_prompt(prompt):
    for command, wanted in exchanges():
        prompt.sendline(command)
        prompt.expect(re.escape(PROMPT.lstrip()) if not wanted else re.escape(PROMPT))
        found = [line for line in prompt.before.replace("\r", "").split("\n")[1:] if line]
        if wanted and wanted[0].startswith(ERROR):
            found = found[-1:]
        shown = [re.escape(line).replace("…", ".*") for line in wanted]
        assert len(found) == len(wanted), (command, found)
        assert all(re.fullmatch(a, b) for a, b in zip(shown, found, strict=True)), (command, found)


@pytest.mark.long
def test_package_import_loads_no_heavy_module_and_resolves_public_names():
    import subprocess

    code = """if True:
        import sys, steradian
        names = dir(steradian)
        heavy = {"numpy", "matplotlib", "numba", "h5py", "pydantic", "fastapi", "fabry_perot"} & set(sys.modules)
        assert not heavy, heavy
        assert all(getattr(steradian, name) is not None for name in names)
        assert not any(name.startswith("_") for name in names)
    """
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
