"""Pages of the documentation that are written from what they describe, each time the site is built."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

DOCS = Path(__file__).parents[1]
METHODS = ("get", "put", "post", "patch", "delete")
LIBRARY = {
    "Masks": "equi_steradian_mask equiangular_mask grid_mask hexagonal_mask custom_mask Mask compare_masks design_scan",
    "Plans and scans": "ScanPlan Scan open",
    "Reconstruction": "reconstruct Acquisition AcquisitionGeometry ImageGrid Compute ReconstructionPlan ForwardOperator"
    " FrameChoice Volume uncertainty suppress_artefacts measure_width quality",
    "Medium": "Medium Layer Attenuation find_medium",
    "Scans in stages": "survey focus",
    "Reconstruction methods": "Nufft Ner LinearKappa NearestKappa Gridded Iterative",
    "Errors": "SteradianError InvalidInput",
}
"""The public names, as a reader looks for them."""


def library() -> str:
    """Describe the library by its docstrings, which the site's builder puts in."""
    import steradian

    named = {name for names in LIBRARY.values() for name in names.split()}
    public = {*steradian.__all__, "open"}
    if named != public:
        raise ValueError(f"the page of the library and steradian.__all__ differ by {named ^ public}")
    text = (
        "# The library\n\nAll lengths are in metres, times in seconds, speeds in m/s, unless a parameter says"
        " otherwise. M is the number of sensors, N_t that of samples. `import steradian` gives access to all names.\n"
    )
    for title, names in LIBRARY.items():
        text += f"\n## {title}\n"
        for name in names.split():
            home = "steradian.quality" if name == "quality" else f"{steradian._HOMES[name]}.{name}"
            text += f"\n::: {home}\n"
    return text


def commands() -> str:
    """Describe the command line by its own help."""
    from typer.cli import get_docs_for_click
    from typer.main import get_command

    from steradian.cli.app import app

    command = get_command(app)
    context = command.context_class(command, info_name="steradian")
    text: str = get_docs_for_click(obj=command, ctx=context, name="steradian", title="The command line")
    return text


def settings() -> str:
    """List what a deployment may choose."""
    from steradian.core.settings import PREFIX, Settings
    from steradian.core.validation_errors import describe_range

    text = (
        "# Settings\n\nEnvironment variables. Some are also options of [`steradian serve`](command-line.md).\n\n"
        "| variable | default | allowed | meaning |\n|---|---|---|---|\n"
    )
    for name, field in Settings.model_fields.items():
        default = "needed" if field.is_required() else "none" if field.default is None else f"`{field.default}`"
        default = "empty" if field.default == "" else default
        values = ", ".join(f"`{value}`" for value in get_args(field.annotation) if isinstance(value, str))
        told = (f"`{PREFIX}{name.upper()}`", default, describe_range(field) or values, field.description or "")
        text += f"| {' | '.join(told)} |\n"
    return text


def routes() -> str:
    """List the operations of the HTTP API by their subjects."""
    document = json.loads((DOCS / "openapi.json").read_text("utf-8"))
    found: dict[str, list[str]] = {tag["name"]: [] for tag in document["tags"]}
    for path, operations in document["paths"].items():
        for method in METHODS:
            if operation := operations.get(method):
                found[operation["tags"][0]].append(_row(method, path, operation))
    text = (
        "# The HTTP API\n\n[openapi.json](../openapi.json) describes all of it: parameters with their limits and units,"
        " responses, problems and examples. A running service shows the same at `/docs`, with forms to send requests."
        " Error responses are [problems](../problems.md).\n"
    )
    for tag in document["tags"]:
        rows = "\n".join(found[tag["name"]])
        text += f"\n## {tag['name']}\n\n{tag['description']}.\n\n| operation | | summary |\n|---|---|---|\n{rows}\n"
    return text


def _row(method: str, path: str, operation: dict[str, Any]) -> str:
    return f"| {method.upper()} | `{path}` | {operation['summary']} |"


def decisions() -> str:
    """List the decisions by their titles."""
    text = "# Decisions\n\nEach page records one decision; a changed decision gets a new page.\n\n"
    for path in sorted((DOCS / "adr").glob("[0-9]*.md")):
        title = re.sub(r"^# (\d+)\. ", r"\1: ", path.read_text("utf-8").partition("\n")[0])
        text += f"- [{title}]({path.name})\n"
    return text


PAGES: dict[str, Callable[[], str]] = {
    "reference/library.md": library,
    "reference/command-line.md": commands,
    "reference/settings.md": settings,
    "reference/http.md": routes,
    "adr/index.md": decisions,
}
"""What is written by what."""
