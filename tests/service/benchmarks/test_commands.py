"""Benchmark commands that documents and scripts quote exist, and a benchmark starts the service that it measures."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from steradian.cli.benchmark import app as installed
from steradian.core.settings import Settings
from steradian_benchmarks.commands import app as of_the_checkout
from steradian_benchmarks.service import running_service

ROOT = Path(__file__).parents[3]
SOURCES = [
    path
    for pattern in ("*.md", "docs/**/*.md", "driver/*.md", "benchmarks/*.*", "benchmarks/*/**/*.py", ".ci/*")
    for path in sorted(ROOT.glob(pattern))
]
QUOTED = {
    r"steradian benchmark ([a-z-]+)": installed,
    r"-m steradian_benchmarks ([a-z-]+)": of_the_checkout,
}


@pytest.mark.parametrize(("pattern", "app"), QUOTED.items())
def test_quoted_benchmark_commands_exist(pattern, app):
    quoted = {command for path in SOURCES for command in re.findall(pattern, path.read_text(encoding="utf-8"))}
    assert len(quoted) >= 2
    assert quoted <= set(get_command(app).commands)


@pytest.mark.long
def test_running_service_yields_the_service_that_it_started(tmp_path):
    with running_service(Settings.create(data=tmp_path, port=0, workers=0)) as service:
        assert service.request("/masks") == {"items": []}
