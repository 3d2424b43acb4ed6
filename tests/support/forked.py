"""Processes of the API that need not read its libraries, which takes longer than most tests: copies of one that has."""

import atexit
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path

MODEL = """
import json, os, socket, sys

import steradian.api.__main__ as api

line = socket.socket(fileno=int(sys.argv[1]))
while True:
    told, given, *_ = socket.recv_fds(line, 1 << 20, 4)
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        pass
    if not told:
        sys.exit()
    copy = os.fork()
    if copy == 0:
        break
    for one in given:
        os.close(one)
    line.send(str(copy).encode())
line.close()
listener, errors, *pipes = given  # the last one closes with the process
for number, pipe in ((0, pipes[0]), (2, errors)):
    os.dup2(pipe, number)
    os.close(pipe)
os.environ.clear()
os.environ.update(json.loads(told))
if mutant := os.environ.get("STERADIAN_TEST_MUTANT"):
    sys.path.append(sys.argv[2])
    from support import mutants

    mutants.apply(mutants.find(mutant))
api.main(listener)
"""


class Model:
    """A process that has read the API's libraries, and becomes as many others as are asked for."""

    def __init__(self):
        self._line, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-c", MODEL, str(far.fileno()), str(Path(__file__).parents[1])]
        self._process = subprocess.Popen(command, pass_fds=[far.fileno()])
        far.close()
        atexit.register(self._end)

    def copy(self, listener, environment, stderr):
        """Start the API on a listening socket with an environment of its own, and a file for standard error."""
        (stdin, far_stdin), (far_end, end) = os.pipe(), os.pipe()
        given = [listener.fileno(), stderr.fileno(), stdin, end]
        socket.send_fds(self._line, [json.dumps(environment).encode()], given)
        pid = int(self._line.recv(100))
        for one in given[2:]:
            os.close(one)
        return Copy(pid, os.fdopen(far_stdin, "wb"), far_end)

    def _end(self):
        self._line.close()
        self._process.wait()


class Copy:
    """Such a process, as far as a :class:`subprocess.Popen` is needed here."""

    def __init__(self, pid, stdin, end):
        self.pid, self.stdin, self._end = pid, stdin, end

    def wait(self, seconds=None):
        """Wait until it has ended."""
        if self._end is not None:
            if not select.select([self._end], [], [], seconds)[0]:
                raise subprocess.TimeoutExpired("the API", seconds)
            os.close(self._end)
            self._end = None

    def poll(self):
        """None while it runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return None if self._end is not None else 0

    def kill(self):
        """Kill it, if it has not ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
