"""Typer application ``steradian``: registration of its commands, and exit codes and messages of errors."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from steradian._version import __version__
from steradian.cli import (
    backup,
    benchmark,
    benchmark_inspection,
    benchmark_nodes,
    check,
    demo,
    export,
    inspect_alines,
    key,
    mask,
    measure,
    plan,
    reconstruct,
    scan,
    scanner,
    serve,
    sound_speed,
    sound_speed_benchmark,
    storage,
    what_if,
    worker,
)
from steradian.cli import (
    import_ as importing,
)
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

COMMAND_ORDER = (
    *("mask", "plan", "scan", "scanner", "look", "reconstruct"),
    *("what-if", "sound-speed", "measure", "import", "export"),
    *("demo", "benchmark", "serve", "api", "acquisition", "worker", "key", "storage", "check", "backup", "restore"),
)
"""Commands as help lists them: in the order of the work."""


class _OrderedGroup(TyperGroup):
    """Command group that lists commands in the order of :data:`COMMAND_ORDER`."""

    def list_commands(self, ctx: Any) -> list[str]:
        return sorted(
            super().list_commands(ctx),
            key=lambda name: COMMAND_ORDER.index(name) if name in COMMAND_ORDER else len(COMMAND_ORDER),
        )


app = typer.Typer(
    cls=_OrderedGroup,
    name="steradian",
    help="""Sparse photoacoustic tomography: design a mask, scan it, reconstruct the volume.

    Quantities take a unit (13.56mm, 60um, 8ns, 500kHz, 1500m/s); a bare number is in m, s, Hz or m/s.

    Exit codes: 0 done, 2 bad input, 3 file missing or damaged, 4 in conflict with what exists, 5 scanner failed,
    130 stopped, 1 anything else.""",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
app.add_typer(mask.app, name="mask")
app.command("plan")(plan.plan)
app.add_typer(scan.app, name="scan")
app.add_typer(scanner.app, name="scanner")
app.command("look")(inspect_alines.look)
app.command("reconstruct")(reconstruct.reconstruct)
app.command("what-if")(what_if.what_if)
app.command("sound-speed")(sound_speed.sound_speed)
app.command("measure")(measure.measure)
app.command("import")(importing.import_)
app.command("export")(export.export)
benchmark.app.command("scale")(benchmark_nodes.scale)
benchmark.app.command("look")(benchmark_inspection.look)
benchmark.app.command("sound-speed")(sound_speed_benchmark.sound_speeds)
app.add_typer(benchmark.app, name="benchmark")
app.command("demo")(demo.demo)
app.command("serve")(serve.serve)
app.command("api")(serve.api)
app.command("acquisition")(serve.acquisition)
app.command("worker")(worker.worker)
app.add_typer(key.app, name="key")
app.add_typer(storage.app, name="storage")
app.command("check")(check.check)
app.command("backup")(backup.backup)
app.command("restore")(backup.restore)


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
