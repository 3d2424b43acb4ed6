"""docs/licences.md: what comes with Steradian is listed, and has a licence that may stand beside ours."""

from pathlib import Path

from licences import FREE, needed

PAGE = (Path(__file__).parents[1] / "docs" / "licences.md").read_text(encoding="utf-8")
LISTED = dict(line.strip("| ").split(" | ", 1) for line in PAGE.splitlines() if line.startswith("| "))


def test_all_that_is_installed_is_listed():
    installed = needed()
    assert len(installed) > 50
    assert installed.keys() - LISTED.keys() == set(), "python tests/licences.py > docs/licences.md"


def test_every_licence_allows_use_beside_ours():
    """Those that are installed, whose versions differ from Python to Python, and those of the page."""
    found = {**LISTED, **needed()}
    found.pop("distribution")
    assert [name for name, licence in found.items() if not FREE.search(licence)] == []
