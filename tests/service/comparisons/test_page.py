"""The page about masks shows what its commands say."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from steradian.cli.mask import app

DOCS = Path(__file__).parents[3] / "docs"
PAGE = DOCS / "which-mask.md"


@pytest.mark.long
def test_commands_of_the_page_are_understood_and_its_pictures_are_there():
    """Each command is run without its object, and without the scan that surveys it: a second instead of minutes."""
    text = PAGE.read_text()
    commands = re.findall(r"^steradian mask (compare .*)$", text, re.MULTILINE)
    assert len(commands) >= 2
    for command in commands:
        words = re.sub(r" --(phantom|phantom-radius|modes|plot|iterations|region) \S+", "", command).split()
        words = [word for word in words if word != "staged"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        for line in done.output.splitlines():
            if line.strip().startswith(("points", "spacing", "shortest travel", "time at")):
                assert " ".join(line.split()) in " ".join(text.split())
    for picture in re.findall(r"\]\((\S+\.png)\)", text):
        assert (DOCS / picture).read_bytes()[:4] == b"\x89PNG"
