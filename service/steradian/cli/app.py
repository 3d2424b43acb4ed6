"""Typer application ``steradian``: table of its commands, and exit codes and messages of errors."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_group

from steradian._version import __version__
from steradian.cli.console import print_error
from steradian.core.exceptions import (
    Cancelled,
    Conflict,
    DamagedFile,
    InvalidInput,
    NotFound,
    ScanFailed,
    SteradianError,
)

EXIT_CODES: dict[type[SteradianError], int] = {
    InvalidInput: 2,
    NotFound: 3,
    DamagedFile: 3,
    Conflict: 4,
    ScanFailed: 5,
    Cancelled: 130,
}
"""Exit code of each kind of error; 1 for any other, 0 for success."""

COMMANDS = {
    "mask": "mask:app",
    "design": "design:design",
    "plan": "plan:plan",
    "scan": "scan:app",
    "scanner": "scanner:app",
    "look": "inspect_alines:look",
    "reconstruct": "reconstruct:reconstruct",
    "what-if": "what_if:what_if",
    "sound-speed": "sound_speed:sound_speed",
    "measure": "measure:measure",
    "unmix": "unmix:unmix",
    "figure": "figure:figure",
    "wavelengths": "wavelengths:wavelengths",
    "import": "import_:import_",
    "export": "export:export",
    "demo": "demo:demo",
    "benchmark": "benchmark:app",
    "serve": "serve:serve",
    "api": "serve:api",
    "acquisition": "serve:acquisition",
    "worker": "worker:worker",
    "key": "key:app",
    "storage": "storage:app",
    "check": "check:check",
    "backup": "backup:backup",
    "restore": "backup:restore",
}
"""Module of this package and the function or typer application in it, for each command in the order of help."""
MARKUP: Final = "markdown"
"""Markup of help texts."""


class _LazyGroup(TyperGroup):
    """Command group that imports the module of a command when the command is used or listed."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands: dict[str, Any] = dict.fromkeys(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name, ``None`` for an unknown name."""
        if cmd_name in COMMANDS and self.commands[cmd_name] is None:
            module, _, name = COMMANDS[cmd_name].partition(":")
            command = getattr(import_module(f"steradian.cli.{module}"), name)
            part = typer.Typer(rich_markup_mode=MARKUP)
            if isinstance(command, typer.Typer):
                part.add_typer(command, name=cmd_name)
            else:
                part.command(cmd_name)(command)
            self.commands[cmd_name] = get_group(part).commands[cmd_name]
        return self.commands.get(cmd_name)


app = typer.Typer(
    cls=_LazyGroup,
    name="steradian",
    help="""Sparse photoacoustic tomography: design a mask, scan it, reconstruct the volume.

    Quantities take a unit (13.56mm, 60um, 8ns, 500kHz, 1500m/s); a bare number is in m, s, Hz or m/s.

    Exit codes: 0 done, 2 bad input, 3 file missing or damaged, 4 in conflict with what exists, 5 scanner failed,
    130 stopped, 1 anything else.""",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=MARKUP,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"steradian {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Define the options before the command: ``--version``."""


def main() -> None:
    """Run the command line; print known errors as one line on standard error and exit with their code."""
    try:
        app()
    except SteradianError as error:
        print_error(str(error))
        sys.exit(next((code for kind, code in EXIT_CODES.items() if isinstance(error, kind)), 1))
    except SystemExit as end:
        if isinstance(getattr(end.__context__, "__cause__", None), KeyboardInterrupt):  # typer says nothing of it
            print_error("stopped")
        raise
    except OSError as error:
        print_error(f"{error.filename or 'input/output'}: {error.strerror or error}")
        sys.exit(1)
    except Exception as error:
        if (said := _said_by_database(error)) is None:
            raise
        print_error(f"the database cannot be used: {said}")
        sys.exit(1)


def _said_by_database(error: Exception) -> str | None:
    """Return the message of a database error; ``None`` for any other error."""
    loaded = sys.modules.get("sqlalchemy.exc")
    if loaded is None or not isinstance(error, loaded.DBAPIError):
        return None
    return " ".join(str(error.orig).split())
