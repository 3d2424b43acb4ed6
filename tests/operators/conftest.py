"""Operators of other libraries: only with -m operators, with the packages of constraints-operators.txt."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave these modules out of other runs: they import the libraries, and would be listed as skipped."""
    wanted = "operators" in config.option.markexpr and "not operators" not in config.option.markexpr
    return None if wanted else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.operators)
