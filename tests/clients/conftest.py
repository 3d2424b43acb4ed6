import os
import subprocess
from pathlib import Path

import pytest

from support.services import Service

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A running service with a simulated scanner; not for longer than it is needed, as it is never quite idle."""
    service = Service(tmp_path_factory.mktemp("data")).start()
    yield service
    service.close()


@pytest.fixture(scope="module")
def url(running):
    """Address of that service."""
    return running.url


class Tools:
    """Others' programs, in the folder that tests/clients/tools/install.sh fills."""

    def __init__(self, folder):
        self.folder = folder
        places = [str(folder / "python" / "bin"), str(folder / "node_modules" / ".bin"), os.environ["PATH"]]
        silent = {"REDOCLY_TELEMETRY": "off", "REDOCLY_SUPPRESS_UPDATE_NOTICE": "1"}
        self.environment = os.environ | silent | {"PATH": ":".join(places)}

    def ask(self, *command, cwd=ROOT):
        """Run one to its end, whatever that is."""
        how = {"cwd": cwd, "env": self.environment, "timeout": 300}
        return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, **how)

    def run(self, *command, cwd=ROOT):
        """Run one that has to succeed; returns what it printed."""
        ran = self.ask(*command, cwd=cwd)
        assert ran.returncode == 0, f"{' '.join(map(str, command))}\n{ran.stdout}{ran.stderr}"
        return ran.stdout


@pytest.fixture(scope="session")
def tools():
    """Others' tools; skipped where they are not installed."""
    folder = Path(os.environ.get("STERADIAN_TOOLS", ROOT / ".tools")).absolute()
    if not (folder / "node_modules" / ".bin").is_dir():
        pytest.skip("needs others' tools: tests/clients/tools/install.sh")
    return Tools(folder)
