"""``steradian benchmark scale``: load test of a service with several nodes and workers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from steradian.cli.benchmark_output import JsonFile, print_and_save, save
from steradian.cli.console import progress_bar


def scale(
    database: Annotated[str, typer.Option(help="An empty PostgreSQL database: postgresql://…")],
    store: Annotated[str, typer.Option(help="A store that may be thrown away: s3://bucket/prefix.")],
    store_endpoint: Annotated[str | None, typer.Option(help="Its address, if it is not Amazon's.")] = None,
    seconds: Annotated[float, typer.Option(help="Duration of the mixed clients' load.", min=1)] = 60.0,
    clients: Annotated[int, typer.Option(help="Mixed clients.", min=1)] = 200,
    jobs: Annotated[int, typer.Option(help="Jobs of each number of workers.", min=1)] = 20,
    json_file: JsonFile = None,
    page: Annotated[Path | None, typer.Option(help="Also write the tables into this page, docs/scale.md.")] = None,
) -> None:
    """Compare one service with several nodes on this machine: many clients, one or three workers, folder or store.

    Keys of the store come from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY. 'share' is of the jobs a second that all
    processors could make at what one costs all of the machine, database and store too, with one worker.
    """
    from steradian.benchmarks.scale import scale as measure
    from steradian.benchmarks.scale_report import write_page

    shared = {"database_url": database, "store": store, "store_endpoint": store_endpoint}
    with progress_bar() as progress:
        rows = measure(shared, seconds=seconds, clients=clients, jobs=jobs, progress=progress)
    for kind in ("jobs", "arrivals", "scanners", "total", "route", "memory"):
        chosen = [row for row in rows if row["case"] == kind]
        named = dict.fromkeys(key for row in chosen for key in row)
        print_and_save(
            kind, chosen, None, [name for name in named if name not in {"over_time", "statuses", "lasting_s"}]
        )
    save("scale", rows, json_file)
    if page is not None:
        write_page(page, rows)
