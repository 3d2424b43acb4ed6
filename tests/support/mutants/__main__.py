"""Server that runs each mutant's tests in a copy of this process, so that libraries are imported once.

Reads ``GROUP:NAME`` lines from standard input and writes a JSON object of outcomes by test for each. With arguments,
``python -m support.mutants GROUP:NAME TEST …``, runs these tests with the mutant.
"""

import json
import os
import sys
import tempfile
import traceback

import pytest

from support import mutants

OPTIONS = [
    "-q",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:xdist",
    "-m",
    "not nightly",
    "-W",
    "ignore::pytest.PytestAssertRewriteWarning",
    "--timeout",
    "100",
    "--tb",
    "short",
]


class Outcomes(dict):
    """Pytest plugin: the worst outcome of each test's phases."""

    def pytest_runtest_logreport(self, report):
        name = report.nodeid.partition("tests/service/")[2]
        if report.when == "call" or not report.passed:
            self[name] = "error" if report.when != "call" else report.outcome


def run(name, tests):
    """Apply a mutant to this process and return the outcomes of tests."""
    os.environ[mutants.VARIABLE] = name
    mutants.apply(mutants.find(name))
    outcomes = Outcomes()
    pytest.main([*OPTIONS, *(f"{mutants.SERVICE}/{test}" for test in tests)], plugins=[outcomes])
    return outcomes


def run_in_copy(name):
    """Run a mutant's killers in a fork; return the outcomes and the output."""
    if name.startswith("api:"):
        from support.apis import model

        model()  # one process with the API's libraries for all mutants
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as told:
        if (copy := os.fork()) == 0:
            try:
                for number in (1, 2):
                    os.dup2(said.fileno(), number)
                told.write(json.dumps(run(name, mutants.find(name).killers)).encode())
                told.flush()
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(0)
        os.waitpid(copy, 0)
        told.seek(0)
        said.seek(0)
        return {"outcomes": json.loads(told.read() or "{}"), "output": said.read().decode(errors="replace")[-4000:]}


if __name__ == "__main__":
    if sys.argv[1:]:
        print(json.dumps(run(sys.argv[1], sys.argv[2:]), indent=1))
        sys.stdout.flush()
        os._exit(0)
    for line in sys.stdin:
        print(json.dumps(run_in_copy(line.strip())), flush=True)
