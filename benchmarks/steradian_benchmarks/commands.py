"""Commands of ``python -m steradian_benchmarks``: benchmarks of a checkout, each with a baseline in the same run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from steradian.cli.benchmark_output import JsonFile, print_and_save, save
from steradian.cli.console import console, finish_with_summary, progress_bar
from steradian_benchmarks.compute_commands import gpu, iterative_amplitudes, learned_positions, operators

app = typer.Typer(
    help="Measure this installation; prints a table and, with --json, writes it to a file.", no_args_is_help=True
)
app.command()(gpu)
app.command()(operators)
app.command("learned-positions")(learned_positions)
app.command("iterative-amplitudes")(iterative_amplitudes)


@app.command()
def masks(json_file: JsonFile = None) -> None:
    """Time the creation of masks and orders of visit, with path length and evenness of the solid angles."""
    from steradian_benchmarks.masks import masks as measure

    with progress_bar() as progress:
        rows = measure(progress=progress)
    print_and_save("masks", rows, json_file)


@app.command()
def amplitudes(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/amplitudes.md.")] = None,
) -> None:
    """Compare amplitudes of a ball and a vessel tree through masks and an import with dense grids of the same area."""
    from steradian_benchmarks import amplitudes as measured

    with progress_bar() as progress:
        rows = measured.amplitudes(progress=progress)
    if page is not None:
        measured.write_page(page, rows)
    print_and_save("amplitudes", rows, json_file)


@app.command()
def tuning(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the tables into this page, docs/tuning.md.")] = None,
) -> None:
    """Compare orders of interrogation on uneven films at 1 kHz and 50 Hz, 5 ms a retuning, and time them.

    'expected s' is the preview's, 'simulated s' by the simulated hardware's clock, 'faster' over a snake tuned anew at
    every point.
    """
    from steradian_benchmarks import visit_orders as measured

    with progress_bar() as progress:
        rows = measured.tuning(progress=progress)
    if page is not None:
        measured.write_page(page, rows)
    print_and_save("tuning", rows, json_file)


@app.command()
def beams(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/beams.md.")] = None,
) -> None:
    """Compare several interrogation beams with a single one: scan time and image, on the yarn's mask.

    'expected s' is the preview's, 'simulated s' by the simulated hardware's clock, 'share' over one beam's.
    """
    from steradian_benchmarks import beams as measured

    with progress_bar() as progress:
        rows = measured.beams(progress=progress)
    if page is not None:
        measured.write_page(page, rows)
    print_and_save("beams", rows, json_file)


@app.command()
def link(json_file: JsonFile = None) -> None:
    """Time the scanner's link: A-lines decoded per second beside the raw rate, and stored durably under full load."""
    from steradian_benchmarks.link_throughput import link as measure

    with progress_bar() as progress:
        rows = measure(progress=progress)
    print_and_save("link", rows, json_file)


@app.command()
def storage(
    json_file: JsonFile = None,
    folder: Annotated[Path | None, typer.Option(help="A folder on the disk to measure.")] = None,
) -> None:
    """Time durable A-lines into a scan file beside a plain file appended to and synchronised at the same batch size.

    'ratio' is the scan file's rate over the plain file's and 'limit' what it must not fall below.
    """
    from steradian_benchmarks.storage import storage as measure

    with progress_bar() as progress:
        rows = measure(folder=folder, progress=progress)
    print_and_save("storage", rows, json_file)


@app.command()
def stop(
    json_file: JsonFile = None,
    presses: Annotated[int, typer.Option(help="Scans that are stopped under each condition.", min=1)] = 25,
) -> None:
    """Time the emergency stop of scans at 1 kHz: idle, beside two busy processes, with the database locked.

    'last shot' is from the request to the laser's last shot, by the simulated scanner's own clock, and 'limit' what
    that must not exceed; 'answer' is from the request to the answer, 'confirmed' how often it held the scanner's word.
    """
    from steradian_benchmarks.stop_latency import stop as measure

    with progress_bar() as progress:
        rows = measure(presses=presses, progress=progress)
    print_and_save("stop", rows, json_file)


@app.command()
def queue(
    json_file: JsonFile = None,
    jobs: Annotated[int, typer.Option(help="Reconstructions for the throughput; 0 leaves it out.", min=0)] = 20,
    load: Annotated[int, typer.Option(help="Short jobs for the load; 0 leaves it out.", min=0)] = 400,
) -> None:
    """Time the job queue: reconstructions a second, waiting times, and 400 jobs under eight readers.

    'cpu s per job' counts every process. With
    STERADIAN_DATABASE_URL the queue is on PostgreSQL.
    """
    from steradian_benchmarks.queue import queue as measure

    with progress_bar() as progress:
        database = os.environ.get("STERADIAN_DATABASE_URL")
        rows = measure(jobs=jobs, load_jobs=load, database_url=database, progress=progress)
    for row in rows:
        print_and_save(row["case"], [row], None)
    save("queue", rows, json_file)


@app.command()
def live(
    json_file: JsonFile = None,
    revisions: Annotated[int, typer.Option(help="Parts in which the A-lines of the scan arrive.", min=2)] = 16,
    quick: Annotated[bool, typer.Option(help="A small scan: whether it runs, no measurement.")] = False,
) -> None:
    """Time the revisions of the live view beside images reconstructed from scratch at full resolution, in turns.

    'ratio' is a revision's time over the full image's, 'ratio with last' counts the full image at the end as a
    revision, 'limit' is what that must not exceed; 'last error' is how far the image grown from all A-lines is from
    the one made at once (relative l2).
    """
    from steradian_benchmarks.live import live as measure

    with progress_bar() as progress:
        rows = measure(quick=quick, revisions=revisions, progress=progress)
    print_and_save("live", rows, json_file)


@app.command()
def series(
    json_file: JsonFile = None,
    quick: Annotated[bool, typer.Option(help="A small scan: whether it runs, no measurement.")] = False,
) -> None:
    """Time a series of 20 frames as one job beside its frames one by one, and a warm iterative series beside cold fits.

    'ratio' is the series' time over that of the frames, with all files and pictures; 'limit' what it must not exceed.
    """
    from steradian_benchmarks.series import series as measure

    with progress_bar() as progress:
        rows = measure(quick=quick, progress=progress)
    print_and_save("series", rows, json_file)


@app.command()
def stages(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the tables into this page, docs/stages.md.")] = None,
    quick: Annotated[bool, typer.Option(help="Few points, one object: whether it runs, no measurement.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Measure nothing: take an earlier --json, for --page.")] = None,
) -> None:
    """Image vessels at random places by a survey and a focus, and end scans of yarns early, beside whole scans.

    Takes a quarter of an hour on two processors.
    """
    from steradian_benchmarks import stages_report as report

    with progress_bar() as progress:
        rows = report.measure(quick=quick, figures=figures, progress=progress)
    for part, lines in report.summaries(rows).items():
        print_and_save(part, lines, None)
    save("stages", rows, json_file)
    if page is not None:
        report.write_page(page, rows)
    if not quick and (missed := report.violations(rows)):
        console().print("\n".join(missed))
        raise typer.Exit(1)


@app.command()
def budget(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/which-mask.md.")] = None,
    quick: Annotated[bool, typer.Option(help="Two scans, direct method: whether it runs, no measurement.")] = False,
    figures: Annotated[Path | None, typer.Option(help="Measure nothing: take an earlier --json, for --page.")] = None,
) -> None:
    """Compare contrast and width predicted by 'steradian design' with those of 20 simulated scans.

    Takes ten minutes on two processors. Fails when a direct prediction is off by more than 2 dB or 10 %.
    """
    from steradian_benchmarks import budget as measured

    with progress_bar() as progress:
        rows = measured.read(figures) if figures else measured.budget(quick=quick, progress=progress)
    print_and_save("budget", rows, json_file)
    if page is not None:
        measured.write_page(page, rows)
    if not quick and (missed := measured.violations(rows)):
        console().print("\n".join(missed))
        raise typer.Exit(1)


@app.command()
def look(
    json_file: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="Runs; the fastest counts.", min=1)] = 5,
    quick: Annotated[bool, typer.Option(help="2,000 A-lines: whether it runs, no measurement.")] = False,
) -> None:
    """Time the inspection of 50,000 A-lines of 1,024 samples beside one real FFT of all of them, in turns.

    'ratio' is the inspection over the FFT; the command fails when 'inspect s' exceeds 'limit s'.
    """
    from steradian_benchmarks.inspecting import inspecting as measure

    with progress_bar() as progress:
        rows = measure(quick=quick, repeats=repeats, progress=progress)
    print_and_save("look", rows, json_file)
    if not quick and rows[0]["inspect_s"] > rows[0]["limit_s"]:
        console().print(f"{rows[0]['inspect_s']:.2f} s exceed {rows[0]['limit_s']:g} s")
        raise typer.Exit(1)


@app.command("sound-speed")
def sound_speeds(
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the table into this page, docs/sound-speed.md.")] = None,
) -> None:
    """Estimate the speed of sound in 60 simulated scans of known speed; in m/s."""
    from steradian_benchmarks import sound_speed as measured

    with progress_bar() as progress:
        rows = measured.sound_speeds(progress=progress)
    if page is not None:
        measured.write_page(page, rows)
    print_and_save("sound-speed", rows, json_file)


@app.command()
def paper(
    output: Annotated[Path, typer.Option(help="Folder for paper.md; pictures and JSON go into paper/ in it.")] = Path(
        "paper-benchmark"
    ),
    quick: Annotated[bool, typer.Option(help="Small versions of all: whether they run, no measurement.")] = False,
    only: Annotated[
        list[str] | None, typer.Option(help="Section to measure; others are kept; may be repeated.")
    ] = None,
    readme: Annotated[
        Path | None, typer.Option(help="Also put the summary between the markers of this file.", exists=True)
    ] = None,
) -> None:
    """Repeat the paper's experiments with simulated data: tables, pictures and JSON, published figures beside ours.

    Takes some ten minutes on two processors.
    """
    from steradian_benchmarks.paper import paper as measure
    from steradian_benchmarks.paper.page import claims_of

    with progress_bar() as progress:
        document = measure(output, quick=quick, only=tuple(only or ()), readme=readme, progress=progress)
    table = Table("claim", "paper", "ours", "holds", box=None, pad_edge=False, show_edge=False)
    for claim in claims_of(document):
        table.add_row(claim.text, claim.paper, claim.ours, claim.verdict.value)
    console().print(table)
    finish_with_summary(("page", output / "paper.md"), ("figures", output / "paper" / "paper.json"), ("all", output))
