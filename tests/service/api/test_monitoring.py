"""``monitoring/``: the rules speak when they should, and rules and dashboard ask for figures that the service gives."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import httpx
import pytest

from steradian.runtime.heartbeat import Heartbeat

FOLDER = Path(__file__).parents[3] / "monitoring"
NAME = re.compile(r"\bsteradian_\w+")


@pytest.fixture(scope="module")
def given(server):
    """Names of all series of a service that has answered something and has a worker."""
    sign = server.data.heartbeat("worker-0")
    sign.write_text("{}")
    httpx.get(f"{server.url}/api/v1/masks", timeout=250)
    text = httpx.get(f"{server.url}/metrics", timeout=250).text
    sign.unlink()
    return {re.split(r"[{ ]", line)[0] for line in text.splitlines() if line and line[0] != "#"}


def test_metrics_report_worker_gpu(server):
    sign = server.data.heartbeat("worker-7")
    with Heartbeat(sign) as heart:
        heart.set_gpu("NVIDIA H100")
        text = httpx.get(f"{server.url}/metrics", timeout=250).text
    assert 'steradian_gpu{gpu="NVIDIA H100",process="worker-7"} 1.0' in text
    assert not re.search('steradian_gpu{.*process="api"', text)


@pytest.mark.parametrize("file", ["alerts.yml", "grafana.json"])
def test_only_figures_that_there_are_are_asked_for(given, file):
    text = (FOLDER / file).read_text(encoding="utf-8")
    asked = set(NAME.findall(text))
    assert len(asked) >= 6
    assert asked - given == set()


def test_the_dashboard_has_an_expression_in_each_panel_and_no_two_in_one_place():
    board = json.loads((FOLDER / "grafana.json").read_text(encoding="utf-8"))
    panels = board["panels"]
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)
    assert all(target["expr"] for panel in panels for target in panel["targets"])


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed (Debian: prometheus)")
@pytest.mark.parametrize("command", [("check", "rules", "alerts.yml"), ("test", "rules", "alerts_test.yml")])
def test_promtool_finds_the_rules_right(command):
    done = subprocess.run(["promtool", *command], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
