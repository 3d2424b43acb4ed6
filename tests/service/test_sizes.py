"""Modules that can be read in one go: what is longer is known, with its reason."""

from importlib.resources import files
from pathlib import Path

import pytest

import fabry_perot
import steradian
import steradian_benchmarks
import steradian_client

LIMIT = 300
LONGER = {
    "fabry_perot/conformance/peer",
    "fabry_perot/hardware/composed",
    "fabry_perot/host/scanner",
    "steradian/jobs/worker/runner",
    "steradian/runtime/acquisition",
    "steradian/scans/acquisition/run",
    "steradian/api/errors/catalog",
    "steradian/cli/mask",
    "steradian/imaging/engines/numba/depth",
    "steradian/jobs/queue/job_ledger",
    "steradian/reconstructions/live/follow",
    "steradian/scans/importing/untrusted",
    "steradian/scans/acquisition/session",
    "steradian_client/models",
}
REASONS = Path(__file__).parents[2] / "docs" / "adr" / "0009-rooms.md"


def modules():
    for package in (steradian, fabry_perot, steradian_client, steradian_benchmarks):
        root = Path(str(files(package)))
        for path in root.rglob("*.py"):
            yield path.relative_to(root.parent).with_suffix("").as_posix(), path


def test_modules_without_listed_reason_have_at_most_300_lines():
    longer = {name for name, path in modules() if len(path.read_text(encoding="utf-8").splitlines()) > LIMIT}
    assert longer - LONGER == set(), f"more than {LIMIT} lines: split it, or give the reason in {REASONS.name}"
    assert LONGER - longer == set(), "no longer that long: take it off the list"


@pytest.mark.parametrize("name", sorted(LONGER))
def test_a_longer_module_has_its_reason_written_down(name):
    assert f"`{name.removeprefix('steradian/')}`" in REASONS.read_text(encoding="utf-8")
