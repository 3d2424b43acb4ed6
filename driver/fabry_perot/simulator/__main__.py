"""Command line ``python -m fabry_perot.simulator``, which runs a simulated scanner."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from fabry_perot.simulator.fault_commands import Commands
from fabry_perot.simulator.options import Options, parse
from fabry_perot.simulator.power_cycle import PoweredDevice
from fabry_perot.simulator.server import Server, open_endpoint


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulator until SIGTERM, Ctrl-C or, on request, the end of standard input."""
    options, exit_with_stdin = parse(arguments)
    signal.signal(signal.SIGTERM, _leave)
    if options.tcp or options.link or not exit_with_stdin:
        return _run(options, exit_with_stdin)
    with TemporaryDirectory(prefix="fabry-perot-") as folder:  # ours, so that it goes also where our starter is gone
        return _run(replace(options, link=str(Path(folder) / "port")), exit_with_stdin)


def _run(options: Options, exit_with_stdin: bool) -> int:
    machine = PoweredDevice(options)
    endpoint = open_endpoint(options)
    try:
        server = Server(machine, endpoint, options)
        ready = {"url": endpoint.url, "pid": os.getpid(), "boot": machine.device.boot, "link": options.link}
        sys.stdout.write(json.dumps(ready) + "\n")
        sys.stdout.flush()
        console = _Console(Commands(server, options.seed), exit_with_stdin)
        server.run(console.over, console.watched)
    except KeyboardInterrupt:
        return 130
    finally:
        endpoint.close()
    return 0


class _Console:
    """Control channel of the simulator on standard input and output."""

    def __init__(self, commands: Commands, exit_with_stdin: bool) -> None:
        self._commands = commands
        # Without the option standard input may be a terminal or long closed: it is left alone.
        self.watched = [sys.stdin.fileno()] if exit_with_stdin else []

    def over(self, readable: list[int]) -> bool:
        """Execute received commands; return whether standard input is closed."""
        if not self.watched or self.watched[0] not in readable:
            return False
        data = os.read(self.watched[0], 65536)
        for answer in self._commands.feed(data):
            sys.stdout.buffer.write(answer)
            sys.stdout.buffer.flush()
        return not data


def _leave(signum: int, frame: object) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    raise SystemExit(main())
