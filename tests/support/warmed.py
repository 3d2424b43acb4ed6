"""Processes of a service as forks of one that has imported its libraries: imports are most of what a start costs."""

import subprocess
import sys
from functools import cache

from support import copies

PROGRAM = "steradian.__main__"
LIBRARIES = """
    support.first_starts steradian.cli.serve steradian.cli.worker steradian.runtime.supervisor
    steradian.runtime.preparation steradian.storage.deployment_binding steradian.storage.maintenance.startup_check
    steradian.security.bootstrap steradian.storage.db.database alembic.command alembic.ddl.sqlite
    alembic.ddl.postgresql logging.config sqlalchemy.dialects.sqlite sqlalchemy.dialects.postgresql.psycopg
    steradian.api.__main__ steradian.runtime.acquisition steradian.runtime.worker_entry steradian.jobs.worker.main
""".split()
READ_BY_IMPORTS = ("PYTHON", "NUMBA_", "OPENBLAS_", "OMP_", "COVERAGE_")
"""Beginnings of the names of variables that libraries read once, when they are imported."""
INHERITED = {}
"""Variables of the environment when the run began, before a test changes any."""


def start(command, *, env, **how):
    """Start a program of the service as such a fork.

    One that another program starts, or whose imports would read other variables, is a process of its own.
    """
    is_same = command[0] == sys.executable and _read_by_imports(env) == _read_by_imports(INHERITED)
    return (Popen if is_same else subprocess.Popen)(command, env=env, **how)


def run(command, *, env, timeout=250):
    """Run such a program to its end and capture what it prints, as :func:`subprocess.run` does."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with start(command, env=env, **pipes) as process:
        try:
            said, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, said, errors)


def _read_by_imports(environment):
    return {name: value for name, value in environment.items() if name.startswith(READ_BY_IMPORTS)}


class Popen(copies.Popen):
    """A :class:`subprocess.Popen` of ``python -m steradian …`` or ``python FILE …`` as a fork."""

    @staticmethod
    @cache
    def original():
        """Return the process that all tests of this process share."""
        return copies.Original([PROGRAM], LIBRARIES, INHERITED)
