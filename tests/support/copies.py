"""Programs as copies of one process that has imported the driver: a start of its own takes 0.2 s."""

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from functools import cache
from pathlib import Path

TESTS = str(Path(__file__).parents[1])
ORIGINAL = """
import gc, importlib, json, os, runpy, select, signal, socket, sys

_, number, programs, libraries, folder = sys.argv
sys.path.append(folder)
for name in f"{programs} {libraries}".split():
    importlib.import_module(name)
for name in programs.split():
    del sys.modules[name]  # each copy reads them anew, as the program

line, ends = socket.socket(fileno=int(number)), {}
wake, woken = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
signal.signal(signal.SIGCHLD, lambda *_: None)
signal.set_wakeup_fd(woken)
gc.freeze()
while True:
    ready, _, _ = select.select([line, wake], [], [])
    if wake in ready:
        os.read(wake, 4096)
        for pid in list(ends):
            if ended := os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT):
                code = ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
                os.write(end := ends.pop(pid), str(code).encode())
                os.close(end)
    if line not in ready:
        continue
    told, given, *_ = socket.recv_fds(line, 1 << 20, 4)
    if not told:
        sys.exit()
    if told.isdigit():  # its number is free for another process from now on, not before
        os.waitpid(int(told), 0)
        line.send(told)
        continue
    pid = os.fork()
    if pid == 0:
        break
    for one in given[:3]:
        os.close(one)
    ends[pid] = given[3]
    line.send(str(pid).encode())
signal.set_wakeup_fd(-1)
signal.signal(signal.SIGCHLD, signal.SIG_DFL)
line.close()
for one in (wake, woken, given[3], *ends.values()):
    os.close(one)
for number, one in enumerate(given[:3]):
    os.dup2(one, number)
    os.close(one)
told = json.loads(told)
if told["session"]:
    os.setsid()
os.chdir(told["cwd"])
os.environ.clear()
os.environ.update(told["environment"])
sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)
sys.stderr = open(2, "w", buffering=1, closefd=False)
kind, *arguments = told["command"]
if kind.endswith(".py"):
    sys.argv = [kind, *arguments]
    sys.path.insert(0, os.path.dirname(kind))
    runpy.run_path(kind, run_name="__main__")
    sys.exit()
program, *arguments = arguments
sys.argv = [program if kind == "-m" else kind, *arguments]
if kind == "-m":
    runpy.run_module(program, run_name="__main__", alter_sys=True)
else:
    sys.path.insert(0, "")
    exec(compile(program, "<string>", "exec"), {"__name__": "__main__"})
"""
"""Program of the process that is copied: it forks for each request and reports exit codes."""


_FIRST = threading.Lock()
"""Held while the shared process is started: several threads may need it at once, and a cache calls for each of them."""


class Original:
    """Process that has imported programs and their libraries, and forks a copy for each request.

    Parameters
    ----------
    programs
        Modules that copies run as their main program.
    libraries
        Further modules to import.
    environment
        Variables that imports read.
    """

    def __init__(self, programs, libraries=(), environment=None):
        self._line, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._turn = threading.Lock()  # tests start programs in several threads
        with far:
            self._process = subprocess.Popen(
                [sys.executable, "-c", ORIGINAL, str(far.fileno()), " ".join(programs), " ".join(libraries), TESTS],
                env=environment,
                pass_fds=[far.fileno()],
                stdin=subprocess.DEVNULL,
                cwd="/",
                start_new_session=True,
            )
        atexit.register(self._end)

    def copy(self, request, files):
        """Start a copy with standard input, output and error; returns its number and the pipe of its exit code."""
        status, far = os.pipe()
        try:
            with self._turn:
                socket.send_fds(self._line, [json.dumps(request).encode()], [*files, far])
                return int(self._line.recv(100)), status
        finally:
            os.close(far)

    def reap(self, pid):
        """Let the number of an ended copy be used again."""
        with self._turn:
            self._line.send(str(pid).encode())
            self._line.recv(100)

    def _end(self):
        self._line.close()
        self._process.wait()


class Popen(subprocess.Popen):
    """A :class:`subprocess.Popen` of ``python -m MODULE …`` or ``python -c CODE …`` as such a copy."""

    @staticmethod
    @cache
    def original():
        """Return the process that all tests of this process share."""
        return Original(["fabry_perot.__main__", "fabry_perot.simulator.__main__"])

    def _execute_child(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *more):
        pipes, (_, *identity, session) = more[3:9], more[9:15]  # after startupinfo, creationflags and shell
        interpreter, *command = [word for word in map(os.fspath, args) if word != "-P"]
        assert (interpreter, preexec_fn, pass_fds, *identity) == (sys.executable, None, (), None, None, None, -1)
        files = [number if far == -1 else far for number, far in enumerate((pipes[0], pipes[3], pipes[5]))]
        request = {"command": command, "cwd": os.fspath(cwd or Path.cwd()), "session": session}
        request["environment"] = dict(os.environ if env is None else env)
        try:
            with _FIRST:
                self._original = self.original()
            self.pid, self._status = self._original.copy(request, files)
            self._child_created = True
        finally:
            self._close_pipe_fds(*pipes)

    def poll(self):
        """Return the exit code, or None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout=None):
        """Wait until it has ended and return its exit code."""
        if self.returncode is None:
            if not select.select([self._status], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout)
            with self._waitpid_lock:
                if self.returncode is None:
                    code = int(os.read(self._status, 100) or -signal.SIGKILL)
                    os.close(self._status)
                    self._original.reap(self.pid)
                    self.returncode = code
        return self.returncode


def run(command, *, timeout=250, **how):
    """Run such a program to its end and capture what it prints, as :func:`subprocess.run` does."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with Popen(command, **pipes | how) as process:
        try:
            said, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, said, errors)
