"""Each deliberate fault in plans, imaging, jobs and the HTTP API is found by the tests that are there for it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from support import mutants

TESTS = Path(__file__).parents[1]
NAMES = [f"{group}:{name}" for group in mutants.GROUPS for name in mutants.of_group(group)]
LEAST = {"plans": 15, "imaging": 15, "jobs": 15, "api": 15}


@pytest.fixture(scope="module")
def run():
    """Run a mutant's tests in a copy of one process, which has imported the libraries."""
    command = [sys.executable, "-m", "support.mutants"]
    with subprocess.Popen(command, cwd=TESTS, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:

        def run(name):
            server.stdin.write(f"{name}\n")
            server.stdin.flush()
            return json.loads(server.stdout.readline())

        yield run
        server.stdin.close()


def test_every_package_has_its_number_of_mutants():
    assert {group: min(len(mutants.of_group(group)), count) for group, count in LEAST.items()} == LEAST


@pytest.mark.parametrize("name", NAMES)
def test_the_function_of_a_mutant_has_its_text(name):
    mutants.changed(mutants.find(name))


@pytest.mark.mutants
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", NAMES)
def test_a_mutant_is_killed_by_its_tests(run, name):
    found = run(name)
    failed = [test for test, outcome in found["outcomes"].items() if outcome == "failed"]
    for killer in mutants.find(name).killers:
        assert any(test == killer or test.startswith(f"{killer}[") for test in failed), found["output"]
