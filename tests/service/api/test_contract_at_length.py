"""The document tried by schemathesis with every check: its examples, edges, random values, and walks by its links."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
DOCUMENT = HERE.parents[2] / "docs" / "openapi.json"


@pytest.mark.parametrize(
    ("phases", "examples", "seed"),
    [
        pytest.param("examples,fuzzing,stateful", 4, ["--seed", "282077887"], id="a little", marks=pytest.mark.long),
        pytest.param("examples,coverage,fuzzing,stateful", 200, [], id="everything", marks=pytest.mark.nightly),
    ],
)
@pytest.mark.timeout(7200)
def test_schemathesis_run_of_openapi_document_finds_no_failure(server, fault_clerk, tmp_path, phases, examples, seed):
    """``schemathesis.toml`` says which answers are none; what CI tries is always the same, what a night tries never."""
    command = [sys.executable, "-m", "schemathesis.cli", "--config-file", HERE / "schemathesis.toml", "run", DOCUMENT]
    how = ["--url", server.url, "--phases", phases, "--max-examples", str(examples), "--continue-on-failure"]
    ran = subprocess.run([*command, *how, *seed, "--no-color"], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout[-20_000:] + ran.stderr
    assert int(re.search(r"(\d+) covered", ran.stdout)[1]) > 0, "links were followed"
