"""First starts of a supervisor's processes as its forks, in a program that :mod:`support.warmed` has started.

A process that is started again, because it ended or was killed, is one of its own. So is whatever another process than
the supervisor starts: forks of a process with many threads are not safe.
"""

import atexit
import importlib.util
import os
import re
import runpy
import signal
import subprocess
import sys
import threading
import traceback
from pathlib import Path
from types import ModuleType
from typing import ClassVar

MODULES = {
    "steradian.api",
    "steradian.runtime.acquisition",
    "steradian.runtime.worker_entry",
    "steradian.core.child_process",
}
THREADS = re.compile(r"MainThread|log|watch|Thread-\d+ \(stay\)")
"""Names of the supervisor's threads: during first starts all but the main one wait."""
ALL_SIGNALS = signal.valid_signals()


class Popen(subprocess.Popen):
    """A :class:`subprocess.Popen` that forks for the first start of each of the service's programs."""

    started: ClassVar[set[tuple[str, ...]]] = set()

    def _execute_child(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *more):
        pipes, umask, session = more[3:9], more[13], more[14]
        program, key = _program(args), tuple(map(os.fspath, args)) if isinstance(args, list) else None
        is_safe = all(THREADS.fullmatch(thread.name) for thread in threading.enumerate())
        if program is None or key in Popen.started or not is_safe or preexec_fn or cwd:
            super()._execute_child(args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *more)
            return
        Popen.started.add(key)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ALL_SIGNALS)
        try:
            pid = os.fork()
            if pid == 0:
                _become(program, pipes, pass_fds, env, umask, session)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.pid, self._child_created = pid, True
        self._close_pipe_fds(*pipes)


def _program(args):
    """Return module or file of a command and its arguments, if it is one of the service's; else None."""
    if not isinstance(args, list) or args[0] != sys.executable:
        return None
    words = [word for word in args[1:] if word != "-P"]
    if words[:1] == ["-m"] and words[1] in MODULES:
        return words[1:]
    return words if Path(words[0]).suffix == ".py" else None


def _become(program, pipes, descriptors, environment, umask, session):
    """Run a program in this fork, as if it had been started; never returns."""
    code = 1
    try:
        Popen.started.clear()
        for number in ALL_SIGNALS - {signal.SIGKILL, signal.SIGSTOP}:
            if callable(signal.getsignal(number)):
                signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ALL_SIGNALS)
        if session:
            os.setsid()
        if umask != -1:
            os.umask(umask)
        for number, pipe in enumerate((pipes[0], pipes[3], pipes[5])):
            if pipe != -1:
                os.dup2(pipe, number)
        kept = sorted({*range(3), *descriptors})
        for lower, upper in zip(kept, [*kept[1:], os.sysconf("SC_OPEN_MAX")], strict=True):
            os.closerange(lower + 1, upper)
        if environment is not None:
            os.environ.clear()
            os.environ.update(environment)
        _run(program)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        threading._shutdown()
        atexit._run_exitfuncs()
        sys.stdout.flush()
        os._exit(code)


def _run(program):
    name, *arguments = program
    sys.stdin = open(0, closefd=False)
    if name.endswith(".py"):
        sys.argv = [name, *arguments]
        sys.path.insert(0, str(Path(name).parent))
        runpy.run_path(name, run_name="__main__")
        return
    spec = importlib.util.find_spec(name)
    if spec.submodule_search_locations is not None:
        spec = importlib.util.find_spec(f"{name}.__main__")
    sys.argv = [spec.origin, *arguments]
    main = sys.modules["__main__"] = ModuleType("__main__")
    main.__spec__, main.__file__ = spec, spec.origin
    exec(spec.loader.get_code(spec.name), main.__dict__)  # noqa: S102 - our own module


subprocess.Popen = Popen
