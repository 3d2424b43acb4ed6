"""A reader of recordings that a file has taken over: it tries what it can reach and reports it.

``hostile_reader.py PLACES [free]``: PLACES is a JSON file of what to try; ``free`` leaves out the shutting in.
"""

import json
import os
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing import sandbox

PLACES = json.loads(Path(sys.argv[1]).read_text())
FREE = "free" in sys.argv[2:]


def connect():
    with socket.create_connection(("127.0.0.1", PLACES["port"]), timeout=5):
        return "connected"


def start_a_thread():
    thread = threading.Thread(target=int)
    thread.start()
    thread.join()


def take_over(source, destination, **_):
    stack = ExitStack()
    attempts = {
        "the recording": source.read_bytes,
        "own folder": lambda: (destination.parent / "own").write_bytes(b"x"),
        "environment": lambda: [name for name in PLACES["secrets"] if name in os.environ] or 1 / 0,
        "environment of the parent": Path(f"/proc/{os.getppid()}/environ").read_bytes,
        "database": Path(PLACES["database"]).read_bytes,
        "another scan": Path(PLACES["scan"]).read_bytes,
        "list of scans": lambda: os.listdir(PLACES["scans"]),
        "forged scan": lambda: Path(PLACES["scans"], "forged.h5").write_bytes(b"x"),
        "private file": Path(PLACES["private"]).read_bytes,
        "link in own folder": lambda: (destination.parent / "link").symlink_to(PLACES["database"]),
        "program": lambda: subprocess.run(["/bin/true"], check=True),
        "connection": connect,
        "signal to the parent": lambda: os.kill(os.getppid(), 0),
        "a hundred files": lambda: [stack.enter_context(source.open()) for _ in range(100)],
        "a file larger than the disk": lambda: os.truncate(destination.parent / "own", 1 << 50),
        "another thread": start_a_thread,
    }
    score, done = Path("/proc/self/oom_score_adj").read_text().strip() if FREE else "", []
    for name, attempt in attempts.items():
        try:
            with stack:
                attempt()
            done.append(name)
        except (OSError, subprocess.SubprocessError, ZeroDivisionError, RuntimeError):
            pass
    raise InvalidInput("done", json.dumps(done), score)


sandbox.import_scan = take_over
if FREE:
    sandbox.restrict_filesystem = lambda *_: False
sandbox.main()
