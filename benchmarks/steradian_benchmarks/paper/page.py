"""Renderer of the paper's benchmark page and the README's summary from the JSON document of measurements."""

from __future__ import annotations

from itertools import chain
from typing import Any

from steradian.core.exceptions import InvalidInput
from steradian_benchmarks.paper.markdown import number, table
from steradian_benchmarks.paper.sections import RULE, Claim, Verdict, sections

BEGIN, END = "<!-- paper: begin, written by `python -m steradian_benchmarks paper` -->", "<!-- paper: end -->"


def page(document: dict[str, Any]) -> str:
    """Return the whole benchmark page as Markdown.

    Parameters
    ----------
    document
        What :func:`steradian_benchmarks.paper.paper` returned or its JSON file holds.

    Returns
    -------
    str
        Markdown; sections that were not measured are left out.
    """
    parts = document["sections"]
    measured = [section for section in sections() if section.name in parts]
    machine = document["machine"]
    claims = claims_of(document)
    blocks = [
        "# The paper done again",
        "Written by `python -m steradian_benchmarks paper`; every figure below comes from "
        "[its JSON](paper/paper.json), none is typed in.\nThe paper is Schmid et al., *Computational Realization of a "
        "Non-Equidistant Grid Sampling in Photoacoustics with a\nNon-Uniform FFT*. Its data are measured ones, ours "
        "are simulated: what is compared is what each method makes of the same data.",
        f"{document['software']}, Python {machine['python']}, {machine['cpus']} processors, "
        f"{number(sum(parts[s.name]['seconds'] for s in measured) / 60, 1)} minutes, {document['measured'][:10]}.",
    ]
    if any(parts[section.name].get("quick") for section in measured):
        blocks.append("**Parts of this were run with `--quick`: they show that it runs and measure nothing.**")
    blocks += ["## In short", RULE, _counted(claims), _summary(claims)]
    for section in measured:
        blocks += [f"## {section.title}", section.write(parts[section.name]).strip()]
    return "\n\n".join(blocks) + "\n"


def readme_block(document: dict[str, Any]) -> str:
    """Return the README's summary of the benchmark, with its markers."""
    claims = claims_of(document)
    return f"{BEGIN}\n{_counted(claims)}\n\n{_summary([c for c in claims if c.headline])}{END}"


def put_into_readme(text: str, document: dict[str, Any]) -> str:
    """Replace the block between the markers of the README.

    Raises
    ------
    InvalidInput
        When the text has no such markers.
    """
    if BEGIN not in text or END not in text:
        raise InvalidInput("readme", "no markers", f"a file with the lines {BEGIN} and {END}")
    before, rest = text.split(BEGIN, 1)
    return before + readme_block(document) + rest.split(END, 1)[1]


def claims_of(document: dict[str, Any]) -> list[Claim]:
    """Collect the claims of the sections that were measured."""
    parts = document["sections"]
    return list(chain.from_iterable(s.claims(parts[s.name]) for s in sections() if s.name in parts))


def _counted(claims: list[Claim]) -> str:
    of = [claim.verdict for claim in claims]
    return (
        f"Of {len(of)} claims {of.count(Verdict.HOLDS)} hold, {of.count(Verdict.SIGN)} by their sign only,"
        f" {of.count(Verdict.FAILS)} do not."
    )


def _summary(claims: list[Claim]) -> str:
    shown = {Verdict.HOLDS: "yes", Verdict.SIGN: "sign only", Verdict.FAILS: "**no**"}
    rows = [[c.text, c.paper or "–", c.ours, shown[c.verdict]] for c in claims]
    return table(["claim", "paper", "ours", "holds"], rows)
