"""A backup that no test changes, its folder, and a small disk."""

import pytest

from support.backups import Whole
from support.disks import small_disk


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder and a backup of it, which no test changes."""
    folder = tmp_path_factory.mktemp("made")
    kept = Whole(folder / "data")
    kept.back_up(folder / "backup")
    return kept, folder / "backup"


@pytest.fixture
def kept(made, tmp_path):
    return made[0].at(tmp_path / "data")


@pytest.fixture
def small(tmp_path):
    with small_disk(tmp_path / "small") as folder:
        yield folder
