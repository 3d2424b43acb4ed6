"""``python -m fabry_perot.simulator``: a simulated scanner as a process."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence

from fabry_perot.simulator.options import parse
from fabry_perot.simulator.server import Server, build_device, open_endpoint


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until SIGTERM, Ctrl-C or, if asked, the end of standard input."""
    options, exit_with_stdin = parse(arguments)
    signal.signal(signal.SIGTERM, _leave)
    device = build_device(options)
    endpoint = open_endpoint(options)
    try:
        server = Server(device, endpoint, options.speed, options.baud)
        ready = {"url": endpoint.url, "pid": os.getpid(), "boot": device.boot, "link": options.link}
        sys.stdout.write(json.dumps(ready) + "\n")
        sys.stdout.flush()
        watched = [sys.stdin.fileno()] if exit_with_stdin else []
        server.run(_stdin_closed if exit_with_stdin else _never, watched)
    except KeyboardInterrupt:
        return 130
    finally:
        endpoint.close()
    return 0


def _leave(signum: int, frame: object) -> None:
    raise SystemExit(0)


def _never(readable: list[int]) -> bool:
    return False


def _stdin_closed(readable: list[int]) -> bool:
    descriptor = sys.stdin.fileno()
    return descriptor in readable and not os.read(descriptor, 4096)


if __name__ == "__main__":
    raise SystemExit(main())
