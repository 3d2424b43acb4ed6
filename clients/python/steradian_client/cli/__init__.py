"""Command line ``steradian-client``, which needs the optional dependencies ``cli``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; an error response ends the program with one line and exit code 1."""
    try:
        from steradian_client.cli.app import app
    except ModuleNotFoundError as error:
        if error.name not in {"typer", "rich"}:
            raise
        sys.exit(f"{error.name} is missing: pip install 'steradian-client[cli]'")
    from steradian_client.errors import ClientError

    try:
        app()
    except (ClientError, TimeoutError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
