"""SECURITY.md: every defence names a test that exists."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "SECURITY.md").read_text()
NAMED = sorted(set(re.findall(r"`(test_\w+\.py)::(\w+)`", PAGE)))


def test_every_line_of_every_table_of_rules_names_a_test():
    rows = [line for table in PAGE.split("| rule | shown by |\n")[1:] for line in table.split("\n\n")[0].splitlines()]
    rules = [row for row in rows if row.startswith("| ")]
    assert len(rules) > 25
    assert [row for row in rules if not re.search(r"\| `test_\w+\.py::\w+`", row)] == []


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_named_test_exists_in_one_file(file, name):
    found = [path for path in (ROOT / "tests").rglob(file) if f"\ndef {name}(" in path.read_text()]
    assert len(found) == 1
