"""Commands of the program inside of a test's process: all but its start, which takes longer than most commands."""

import io
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from subprocess import CompletedProcess

import pytest

from steradian.cli import main


def command(*words, cwd="."):
    """Run the program's own entry point in a folder, without the service's settings of the environment.

    Returns its exit code and what it said.
    """
    said, errors = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(errors):
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["steradian", *map(str, words)])
        for name in [name for name in os.environ if name.startswith("STERADIAN_")]:
            patch.delenv(name)
        with pytest.raises(SystemExit) as ended:
            main()
    return CompletedProcess(words, ended.value.code or 0, said.getvalue(), errors.getvalue())


def run_here(*words, cwd, code=0):
    """Run it and check its exit code; returns both outputs."""
    done = command(*words, cwd=cwd)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stderr + done.stdout
