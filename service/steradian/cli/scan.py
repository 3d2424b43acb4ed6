"""``steradian scan``: run, resume and check scans."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from steradian.cli.console import console, finish_with_summary, progress_bar, show_figures
from steradian.cli.scanner import clearing_command
from steradian.cli.scanner_port import PHANTOM, at_baud, scanner_port
from steradian.cli.stage_options import EnoughOption, FocusOption, SurveyOption, parse_places, plan_with_stages
from steradian.core.exceptions import DamagedFile, FaultLatched, InvalidInput

if TYPE_CHECKING:
    from steradian.scans.acquisition.run import ScanSummary
    from steradian.scans.acquisition.session_control import SessionControl
    from steradian.scans.acquisition.stages import StagePlanner


class _DefaultCommandGroup(TyperGroup):
    """Typer command group with the default command ``run``: ``scan PLAN`` means ``scan run PLAN``."""

    def parse_args(self, context: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(context, args)


app = typer.Typer(
    cls=_DefaultCommandGroup,
    no_args_is_help=True,
    help="""Run a plan on a scanner and keep the A-lines in a scan file; go on with a scan that ended early.

    'steradian scan PLAN' is short for 'steradian scan run PLAN'. However a scan ends, its file holds every A-line
    that was acknowledged and can be reconstructed. Ctrl-C turns the laser off, stores what was fired and says how to go
    on; a second Ctrl-C leaves at once.""",
)
Scanner = Annotated[str, typer.Option(help="Port of the scanner (/dev/ttyUSB0, socket://host:port), or 'simulated'.")]
Baud = Annotated[
    int | None,
    typer.Option(
        metavar="BD",
        help="Baud rate of a serial port, like PORT?baud=BD. [default: the plan's, if it was made with another --baud"
        " than 12,000,000, otherwise 3,000,000]",
    ),
]
Speed = Annotated[float, typer.Option(help="How much faster than real time a simulated scan runs.")]
Phantom = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="What a simulated scanner looks at: yarn, tree, star, usaf, vessels, or an .npz file of balls or a"
        " volume; not the objects of `mask compare`."
        f" [default: {PHANTOM}]",
    ),
]
File = Annotated[Path, typer.Argument(help="A scan file.")]


@app.command("run")
def run(
    plan: Annotated[Path, typer.Argument(help="A plan file, made by 'steradian plan'.")],
    scanner: Scanner = "simulated",
    baud: Baud = None,
    simulator_speed: Speed = 20.0,
    phantom: Phantom = None,
    survey: SurveyOption = None,
    focus: FocusOption = None,
    enough: EnoughOption = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The scan file to write (HDF5).")] = Path("scan.h5"),
) -> None:
    """Run a plan on a scanner and store the A-lines in a scan file.

    With --survey a part of the points is spread evenly over the aperture, and the others are focused on what their
    image shows, within the plan's number of points and its aperture.
    """
    from steradian.plans import ScanPlan
    from steradian.plans.files import read_json
    from steradian.scans.acquisition.run import run_scan

    wanted = plan_with_stages(read_json(ScanPlan, plan), survey, focus, enough)
    chosen = parse_places(focus or [])
    scanner = at_baud(scanner, baud, wanted)
    summary = _run_with_scanner(
        output,
        scanner,
        simulator_speed,
        phantom,
        lambda port, control, planner: run_scan(
            wanted, port, output, scan_id=new_scan_id(), control=control, planner=planner, chosen=chosen
        ),
        bool(wanted.stages or wanted.stopping),
    )
    _show(summary, scanner)


@app.command("resume")
def resume(
    file: File,
    plan: Annotated[Path | None, typer.Option(help="Refuse unless the scan is of this plan.")] = None,
    scanner: Scanner = "simulated",
    baud: Baud = None,
    simulator_speed: Speed = 20.0,
    phantom: Phantom = None,
    focus: FocusOption = None,
) -> None:
    """Resume an interrupted or partial scan in the same file.

    Before a missing point is measured the scan proves that it is the same: plan, scanner and tuning must be, and a
    reference point is measured again and compared. Otherwise it is refused (exit code 4) and every difference named.
    """
    _resume_or_retry(file, plan, scanner, baud, simulator_speed, phantom, retry=0, focus=focus)


@app.command("retry")
def retry(
    file: File,
    flags: Annotated[
        int, typer.Option(min=0, max=15, help="Quality flags, summed: 1 saturated, 2 mistuned, 4 misfire, 8 partial.")
    ] = 15,
    scanner: Scanner = "simulated",
    baud: Baud = None,
    simulator_speed: Speed = 20.0,
    phantom: Phantom = None,
) -> None:
    """Measure the missing points again, and those with a quality flag, after the same checks as resume."""
    _resume_or_retry(file, None, scanner, baud, simulator_speed, phantom, retry=flags)


@app.command("check")
def check(
    file: File,
    repair: Annotated[bool, typer.Option(help="Correct the table of stored A-lines.")] = True,
) -> None:
    """Verify every A-line of a scan file that is not being written, and correct the table of stored A-lines.

    A-lines themselves are never changed. A damaged one counts as missing from then on: 'steradian scan resume'
    measures it again. Without --repair a file that is not sound ends with exit code 3.
    """
    from steradian.scans.file.verify import verify_scan_file

    with progress_bar() as progress:
        report = verify_scan_file(file, repair=repair, progress=progress)
    figures = {
        "damaged": _rows(report.damaged.tolist()),
        "complete but not listed": _rows(report.unlisted.tolist()),
        "table": "sound" if report.is_consistent else "corrected" if repair else "not corrected",
    }
    show_figures(str(file), figures)
    if not report.is_consistent and not repair:
        raise DamagedFile(f"{file}: the table of stored A-lines is wrong; --repair corrects it")
    finish_with_summary((f"{report.intact:,} of {report.rows:,} A-lines intact", file))


def _resume_or_retry(
    file: Path,
    plan: Path | None,
    scanner: str,
    baud: int | None,
    speed: float,
    phantom: str | None,
    *,
    retry: int,
    focus: list[str] | None = None,
) -> None:
    from steradian.plans import ScanPlan
    from steradian.plans.files import read_json
    from steradian.scans.acquisition.run import needs_planner, resume_scan

    wanted = None if plan is None else read_json(ScanPlan, plan)
    chosen = parse_places(focus or [])
    if focus and not chosen:
        raise InvalidInput("focus", ", ".join(focus), "a place such as 2.6mm,-1.8mm,2mm (x, y, depth)")
    scanner = at_baud(scanner, baud, wanted)
    summary = _run_with_scanner(
        file,
        scanner,
        speed,
        phantom,
        lambda port, control, planner: resume_scan(
            file, port, plan=wanted, retry=retry, control=control, planner=planner, chosen=chosen
        ),
        needs_planner(file),
    )
    for finding in summary.findings:
        console().print(f"compared: {finding}")
    _show(summary, scanner)


def new_scan_id() -> str:
    """Return a new random scan identifier in the service's format."""
    from ulid import ULID

    return f"s{ULID()}".lower()


def _run_with_scanner(
    file: Path,
    scanner: str,
    speed: float,
    phantom: str | None,
    work: Callable[[str, SessionControl, StagePlanner | None], ScanSummary],
    in_stages: bool,
) -> ScanSummary:
    """Call ``work(port, control, planner)`` with Ctrl-C handling, first starting a simulated scanner if requested.

    The planner of stages is there if the scan is ``in_stages``.
    """
    from steradian.cli.terminal_scan_control import terminal_scan_control
    from steradian.reconstructions.stages.planner import ChildStagePlanner
    from steradian.reconstructions.warmup import warmup_in_background

    needed = () if phantom is None else ("--phantom", phantom)
    if scanner != "simulated":
        if phantom is not None:
            raise InvalidInput("phantom", phantom, "none with a real scanner, or --scanner simulated")
        needed = ("--scanner", scanner)
    with (
        terminal_scan_control(file, needed) as control,
        scanner_port(scanner, speed=speed, phantom=phantom or PHANTOM) as port,
        ChildStagePlanner() if in_stages else nullcontext() as planner,
    ):
        with warmup_in_background(), progress_bar() as progress:
            control.attach_progress_bar(progress)
            try:
                summary = work(port, control, planner)
            except FaultLatched as error:
                raise FaultLatched(error.code_number, f"{error}: {clearing_command(port)}") from error
        control.end(summary)
        return summary


def _show(summary: ScanSummary, scanner: str) -> None:
    figures: dict[str, object] = {"shots fired": f"{summary.fired:,}"}
    if summary.end == "enough":
        figures["ended by"] = "its stopping rule"
    if summary.rescued:
        figures["of an earlier session"] = f"{summary.rescued} A-lines that the scanner still held"
    show_figures("Scan" + (" (simulated)" if scanner == "simulated" else ""), figures)
    finish_with_summary((f"{summary.stored:,} of {summary.points:,} A-lines", summary.path))


def _rows(rows: list[int]) -> str:
    if not rows:
        return "none"
    return f"{len(rows)}: rows " + ", ".join(map(str, rows[:10])) + (", …" if len(rows) > 10 else "")
