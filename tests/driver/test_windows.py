"""A host on Windows, as far as another system can tell: nothing that only POSIX has is needed to connect and scan."""

from __future__ import annotations

import subprocess
import sys

from fabry_perot.simulator import launch

HOST = """
import builtins, os, select, signal, sys

POSIX = {"termios", "tty", "pty", "fcntl", "pwd", "grp", "resource"}
plain = builtins.__import__

def refuse(name, globals=None, *rest, **named):
    # pyserial picks its own module for the system it runs on
    if name in POSIX and str((globals or {}).get("__name__")).startswith("fabry_perot"):
        raise ImportError(f"Windows has no {name}")
    return plain(name, globals, *rest, **named)

builtins.__import__ = refuse
import time
for module, names in ((os, ("openpty", "pwrite", "pread", "major", "minor", "ttyname", "fork", "killpg", "setsid")),
                      (select, ("poll", "epoll")), (time, ("clock_gettime_ns", "CLOCK_BOOTTIME", "CLOCK_MONOTONIC")),
                      (signal, ("SIGHUP", "SIGUSR1", "pthread_sigmask"))):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)

import numpy as np
import fabry_perot, fabry_perot.__main__, fabry_perot.simulator
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.phantoms import yarn

def scan(scanner):
    scanner.upload(np.zeros((20, 2)), samples=64, sampling_interval=8e-9, pulse_rate=100.0)
    scanner.start(scanner.arm())
    for batch in scanner.alines():
        scanner.acknowledge(batch[-1])
    print(scanner.report().stored)

with fabry_perot.connect(sys.argv[1]) as scanner:
    scan(scanner)
with fabry_perot.connect(SimulatedInstrument(yarn(0))) as scanner:
    scan(scanner)
try:
    fabry_perot.connect("COM99")
except fabry_perot.PortUnavailable as error:
    print("refused")
print(sorted(POSIX & {name for name, module in vars(fabry_perot.host.transport).items()}))
"""


def test_a_host_scans_where_the_modules_and_functions_of_posix_are_missing():
    with launch(tcp="127.0.0.1:0", speed=20) as simulator:
        done = subprocess.run(
            [sys.executable, "-c", HOST, simulator.url], capture_output=True, text=True, timeout=300, check=False
        )
    assert done.stdout.split("\n")[:-1] == ["20", "20", "refused", "[]"], done.stderr
