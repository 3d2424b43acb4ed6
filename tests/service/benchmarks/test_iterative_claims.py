"""At full size: iterative reconstruction, speed of sound and film hold what the paper page claims (minutes)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from steradian_benchmarks.paper import focus, iterative
from steradian_benchmarks.paper.sections import SectionContext, Verdict


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("section", [iterative.SECTION, focus.SECTION], ids=lambda section: section.name)
def test_every_claim_of_the_section_holds_at_full_size(section, tmp_path: Path) -> None:
    part = json.loads(
        json.dumps(section.measure(SectionContext(False, tmp_path, lambda done, total: None)), allow_nan=False)
    )
    print(section.write(part))
    for claim in section.claims(part):
        assert claim.verdict is Verdict.HOLDS, f"{claim.text}: {claim.ours}"


@pytest.mark.long
# The order shares the time that compiling takes in a fresh clone: what the first compiles, the second needs too.
@pytest.mark.parametrize("section", [focus.SECTION, iterative.SECTION], ids=lambda section: section.name)
def test_quick_section_run_writes_page_matching_json(section, tmp_path: Path) -> None:
    part = json.loads(
        json.dumps(section.measure(SectionContext(True, tmp_path, lambda done, total: None)), allow_nan=False)
    )
    text = section.write(part)
    pictures = [line.split("(paper/")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert pictures
    assert all((tmp_path / name).stat().st_size > 1000 for name in pictures)
    assert all(claim.ours for claim in section.claims(part))
    if section is iterative.SECTION:
        found = part["rows"][0]["images"]
        assert f"{found['direct']['volume']:.3f}" in text
        assert found["iterative"]["volume"] > found["direct"]["volume"]
    else:
        assert f"{part['speeds'][0]['best']:,.2f} m/s" in text
        assert part["film"]["rows"][0]["amplitude"] < 0.75
