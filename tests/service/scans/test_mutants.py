"""Each way to break watermark and row checksum is found by the test that is there for it, and by that one alone."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FULL = "test_watermark.py::test_an_aline_that_found_no_space_is_not_freed_by_the_next_one"
NEIGHBOURS = "test_store.py::test_aline_with_failed_write_stays_missing_when_neighbours_are_stored"
COLUMN = "test_store.py::test_a_row_with_a_wrong_column_is_not_passed_off_as_data[energy]"
KILLERS = {
    "acknowledges_beyond": FULL,
    "acknowledges_unsynchronised": FULL,
    "remembers_what_was_not_written": NEIGHBOURS,
    "checksum_of_samples_only": COLUMN,
}


@pytest.mark.mutants
@pytest.mark.parametrize("mutant", KILLERS)
def test_a_mutant_is_killed_by_its_test_and_the_others_pass(mutant):
    tests = [FULL, NEIGHBOURS, COLUMN]
    command = [sys.executable, HERE / "scan_mutants.py", mutant, *(HERE / test for test in tests)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=110, cwd=HERE)
    outcomes = {Path(name).name: outcome for outcome, name in re.findall(r"^(PASSED|FAILED) (\S+)", said.stdout, re.M)}
    expected = {test: "FAILED" if test == KILLERS[mutant] else "PASSED" for test in tests}
    assert outcomes == expected, said.stdout[-3000:] + said.stderr[-1000:]
