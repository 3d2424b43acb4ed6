"""The paper's benchmark: it runs, its page and the README say what its JSON holds, and its claims are borne out."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian_benchmarks.commands import app
from steradian_benchmarks.paper import paper
from steradian_benchmarks.paper.markdown import number, spread, table
from steradian_benchmarks.paper.page import BEGIN, END, claims_of, page, put_into_readme, readme_block
from steradian_benchmarks.paper.sections import SECTION_NAMES, Claim, Verdict, sections

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(600),  # the small run of the benchmark takes some 15 s, many times that on a busy machine
]


@pytest.fixture(scope="module")
def committed():
    return json.loads((DOCS / "paper" / "paper.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """One run of the sections that this file is about, small, through the command."""
    folder = tmp_path_factory.mktemp("paper")
    readme = folder / "README.md"
    readme.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", "utf-8")
    only = [word for name in ("resolution", "tree", "yarn") for word in ("--only", name)]
    arguments = ["paper", "--quick", "--output", str(folder), "--readme", str(readme), *only]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return folder


@pytest.mark.long
def test_the_command_leaves_page_pictures_and_json(quick) -> None:
    text = (quick / "paper.md").read_text("utf-8")
    shown = re.findall(r"\]\((paper/[^)]+)\)", text)
    assert {name for name in shown if name.endswith(".png")} >= {
        "paper/chart.png",
        "paper/tree.png",
        "paper/yarn-full.png",
    }
    for name in shown:
        assert (quick / name).stat().st_size > 1000
    document = json.loads((quick / "paper" / "paper.json").read_text("utf-8"))
    assert set(document["sections"]) == {"resolution", "tree", "yarn"}
    assert text == page(document)
    assert "--quick" in text


@pytest.mark.long
def test_the_command_fills_the_readme_between_its_markers(quick) -> None:
    text = (quick / "README.md").read_text("utf-8")
    assert text.startswith("before\n" + BEGIN)
    assert text.endswith(END + "\nafter\n")
    assert "\nold\n" not in text


@pytest.mark.long
def test_single_section_run_preserves_other_sections(quick) -> None:
    before = json.loads((quick / "paper" / "paper.json").read_text("utf-8"))
    after = paper(quick, quick=True, only=("tree",))
    assert after["sections"]["yarn"] == before["sections"]["yarn"]
    assert [row["seed"] for row in after["sections"]["tree"]["rows"]] == [0] * 4


@pytest.mark.long
def test_it_stops_when_it_is_cancelled_and_reports_by_section(tmp_path) -> None:
    seen = []
    with pytest.raises(Cancelled):
        paper(
            tmp_path,
            quick=True,
            only=("tree",),
            progress=lambda stage, done, total: seen.append((stage, done, total)),
            cancelled=lambda: len(seen) > 1,
        )
    assert [stage for stage, _, _ in seen] == ["tree"] * 2
    assert not (tmp_path / "paper.md").exists()


def test_an_unknown_section_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidInput, match="tree"):
        paper(tmp_path, only=("forest",))


def test_a_file_without_markers_is_left_alone() -> None:
    with pytest.raises(InvalidInput, match="markers"):
        put_into_readme("nothing here", {"sections": {}})


def test_every_name_is_a_section_of_that_name() -> None:
    assert [section.name for section in sections()] == list(SECTION_NAMES)


def test_documentation_page_matches_json(committed) -> None:
    assert (DOCS / "paper.md").read_text("utf-8") == page(committed)


def test_readme_figures_match_json(committed) -> None:
    assert readme_block(committed) in (ROOT / "README.md").read_text("utf-8")


def test_the_documentation_was_measured_in_full(committed) -> None:
    assert not any(part["quick"] for part in committed["sections"].values())


def test_the_pages_figures_follow_the_json(committed) -> None:
    """Other correlations in the JSON make other figures on the page: none is typed in."""
    factors = itertools.cycle((0.9, 0.8, 0.85))  # not all alike, since some figures are ratios

    def shifted(value):
        match value:
            case bool() | int() | str() | None:
                return value
            case float():
                return next(factors) * value
            case list():
                return [shifted(item) for item in value]
        return {key: shifted(item) for key, item in value.items()}

    other = {**committed, "sections": {name: shifted(part) for name, part in committed["sections"].items()}}
    rows, changed = ([line for line in page(d).splitlines() if line.startswith("|")] for d in (committed, other))
    same = [a for a, b in zip(rows, changed, strict=True) if a == b and re.search(r"\d\.\d{2}", a)]
    assert [row for row in same if "paper's tree" not in row] == []


@pytest.mark.parametrize(
    "words",
    ["3-D yarn: NEDNER", "2-D tree: equiangular closer", "2-D tree: NEDNER"],
)
def test_claims_that_small_versions_can_show_have_their_sign(quick, words) -> None:
    """Not that of the yarn's mask against grids: with a sixteenth of the points they are alike (see comparisons)."""
    measured = json.loads((quick / "paper" / "paper.json").read_text("utf-8"))
    claims = [claim for claim in claims_of(measured) if claim.text.startswith(words)]
    assert len(claims) == 1
    assert claims[0].verdict is not Verdict.FAILS, claims[0]


@pytest.mark.parametrize(
    ("runs", "figure", "verdict"),
    [
        ((0.2, 0.4), 0.3, Verdict.HOLDS),
        ((0.2, 0.4), 0.44, Verdict.HOLDS),  # their standard deviation is 0.141
        ((0.2, 0.4), 0.45, Verdict.SIGN),
        ((0.2, 0.4), None, Verdict.HOLDS),
        ((0.2, -0.01), 0.0, Verdict.FAILS),
        ((0.0,), None, Verdict.FAILS),
        ((0.1,), 0.2, Verdict.SIGN),
    ],
)
def test_claim_verdict_follows_runs_and_figure(runs, figure, verdict) -> None:
    assert Claim("it", runs, "so", figure=figure).verdict is verdict


def test_the_page_counts_every_claim_and_so_does_the_readme(committed) -> None:
    claims = claims_of(committed)
    counted = f"Of {len(claims)} claims {sum(claim.verdict is Verdict.HOLDS for claim in claims)} hold"
    assert counted in page(committed)
    assert counted in readme_block(committed)
    shown = [line for line in page(committed).split("## In short")[1].split("## ")[0].splitlines() if "| " in line]
    assert len(shown) == len(claims) + 1


def test_claims_contain_only_finite_measurements(committed) -> None:
    """Neither one that holds nor one that does not."""
    for claim in claims_of(committed):
        assert any(letter.isdigit() for letter in claim.ours), claim
        assert all(math.isfinite(run) for run in claim.runs), claim


def test_numbers_are_written_for_people() -> None:
    assert [number(-1234.5, 1), number(None), number(float("nan"))] == ["−1,234.5", "–", "–"]
    assert [spread([0.5, 0.25], 2), spread([0.5], 1)] == ["0.25–0.50", "0.5"]
    assert table(["a", "b|c"], [[1, 2]]) == "| a | b\\|c |\n|---|--:|\n| 1 | 2 |\n"
