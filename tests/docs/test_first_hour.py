"""The first hour: each block of the README and of the tutorial, as written, in its order, in a fresh environment.

A block that cannot be run here stands after a comment ``<!-- not run: why -->``, and is counted.
"""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from support.waiting import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]
ROOT = Path(__file__).parents[2]
BLOCK = re.compile(
    r"^(?:<!-- not run: (?P<why>[^\n]*?) -->\n\n?)?```(?P<kind>sh|python)\n(?P<code>.*?)^```", re.S | re.M
)
FETCHED = ("pyproject.toml", "README.md", "LICENSE", "service", "driver", "clients")
PORT = 8000
"""The one that the pages name."""


def blocks(name):
    return [(found["kind"], found["code"], found["why"]) for found in BLOCK.finditer((ROOT / name).read_text("utf-8"))]


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """What somebody has who has fetched the project, as far as it is installed, and nothing else of it."""
    folder = tmp_path_factory.mktemp("steradian")
    for name in FETCHED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)
    return folder


class Terminal:
    """Types blocks into one bash, which ends at the first that fails."""

    def __init__(self, folder, python):
        self.folder, self._python, self._lines = folder, python, ["set -euo pipefail"]

    def type(self, kind, code):
        shown = f"printf '%s\\n' {len(self._lines)} >typed"
        if kind == "sh":
            self._lines += [code, shown]
        else:
            self._lines += [f"{self._python} - <<'THE_BLOCK_ENDS'\n{code}THE_BLOCK_ENDS", shown]

    def run(self):
        """Run it all; returns what was printed."""
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(("VIRTUAL_ENV", "PYTHON"))
        }
        python = Path(sys._base_executable).parent  # where this very version is python3
        environment |= {"MPLBACKEND": "agg", "PATH": f"{python}:{environment['PATH']}"}
        how = {"cwd": self.folder, "env": environment, "stdin": subprocess.PIPE, "text": True}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "start_new_session": True}
        bash = subprocess.Popen(["bash"], **how, **pipes)
        try:
            said, _ = bash.communicate("\n".join(self._lines), timeout=1500)
        finally:
            for number in (signal.SIGTERM, signal.SIGKILL):
                try:
                    os.killpg(bash.pid, number)
                except ProcessLookupError:
                    break
        assert bash.returncode == 0, said[-4000:]
        return said


@pytest.fixture
def free_port():
    """Wait until nobody else on this machine listens where the pages say."""

    def is_free():
        with socket.socket() as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            return tried.connect_ex(("127.0.0.1", PORT)) != 0

    until(is_free)


def test_few_blocks_are_not_run():
    left_out = [why for name in ("README.md", "docs/tutorial.md") for _, _, why in blocks(name) if why is not None]
    assert left_out == ["the whole suite, which CI runs by this very line"]
    assert [len(blocks(name)) for name in ("README.md", "docs/tutorial.md")] == [3, 17]


def test_the_readme_then_the_tutorial_as_written(copy, free_port):
    readme = Terminal(copy, ".venv/bin/python")
    (kind, service, why), *_ = blocks("clients/http/README.md")
    for block in blocks("README.md"):
        if block[2] is None:
            readme.type(*block[:2])
    assert (kind, why) == ("sh", None)
    readme.type("sh", ".venv/bin/steradian serve &")  # as the sentence before the block says
    readme.type("sh", f"until curl --silent --fail http://127.0.0.1:{PORT}/readyz; do sleep 0.2; done")
    readme.type("sh", service)
    readme.type("sh", "kill $!\nwait $!")
    said = readme.run()
    report = json.loads((copy / "demo" / "report.json").read_text())
    assert report["mask_count"] == 1605
    assert report["correlation"] > report["grid_correlation"] > 0.9
    assert "(226, 226, 1024)" in said
    for picture in ("demo/mip-z.png", "mip-z.png"):
        assert (copy / picture).read_bytes().startswith(b"\x89PNG")

    tutorial = Terminal(copy, "python")
    for kind, code, _ in blocks("docs/tutorial.md"):
        tutorial.type(kind, code)
    said = tutorial.run()
    assert "brightest at x 0.00, y 0.00, depth 3.0" in said
    assert "(96, 96, 1024)" in said
    saturation = {name: float(mean) for name, mean in re.findall(r"^(artery|vein) +0 +190 +(0\.\d+)", said, re.M)}
    assert saturation == pytest.approx({"artery": 0.95, "vein": 0.65}, abs=0.01)
    for made in (
        "image/volume.h5",
        "better/mip-z.png",
        "mine/report.json",
        "seen-by-few/what-if.json",
        "mask.png",
        "so2.png",
    ):
        assert (copy / "first-hour" / made).is_file(), made
