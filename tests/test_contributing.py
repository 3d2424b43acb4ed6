"""CONTRIBUTING.md: what it says how to add is added to a copy of the house, as it says, and used there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DIFFS, (ENGINE,) = (re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) for kind in ("diff", "python"))

ARRANGEMENT = """
import numpy as np
from pydantic import TypeAdapter
from steradian.masks import Arrangement, Mask

wanted = TypeAdapter(Arrangement).validate_python({"arrangement": "ring", "aperture": 0.01, "count": 12, "depth": 2e-3})
mask = wanted.build()
assert np.allclose(np.linalg.norm(mask.positions, axis=1), 5e-3)
assert (mask.count, mask.depth, mask.arrangement["arrangement"]) == (12, 2e-3, "ring")
"""
FORMAT = """
import numpy as np
from pathlib import Path
from steradian.imaging import VoxelAxes, Volume
from steradian.reconstructions.exporting import export_volume
from steradian.reconstructions.volumes.file import write_volume

values = np.random.default_rng(1).normal(size=(3, 4, 5)).astype(np.float32)
axes = VoxelAxes(*(np.arange(count) * 1e-3 for count in values.shape))
write_volume(Path("volume.h5"), Volume(values, axes, (1e-3,) * 3), parameters={}, provenance={})
export_volume(Path("volume.h5"), Path("volume.raw"), format="raw")
assert (np.fromfile("volume.raw", np.float32).reshape(values.shape[::-1]) == values.T).all()
"""
JOB = """
import numpy as np
from pathlib import Path
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.tasks.context import JobContext
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.data_dir.layout import DataDirectory
from support.alines import Aline

data, plan, said = DataDirectory(Path("data")), ScanPlan.create(mask=grid_mask(0.01, 3, 1e-3), samples=64), []
data.create()
create_scan_file(data.scan_file("s1"), plan, scan_id="s1")
with ScanFileWriter(data.scan_file("s1")) as store:
    store.append([Aline(point, np.ones(64, np.int16), point + 1) for point in range(4)])
work = JobContext(data, data.job("j1").root, "ada", PlanCache(), lambda *told: said.append(told), FolderBlobStore(data))
assert JOB_TYPES["count"].run(work, {"scan_id": "s1"}) == {"alines": 4, "planned": 9}
assert said == [("counting", 1, 1)]
"""
ENGINES = """
import numpy as np
from steradian.imaging import AcquisitionGeometry, Compute, ImageGrid, ReconstructionPlan
from steradian.imaging.engines import run_inverse

random = np.random.default_rng(1)
positions, traces = (random.random((20, 2)) - 0.5) * 0.01, random.normal(size=(20, 64))
geometry = AcquisitionGeometry(positions, 64, dt=8e-9, sound_speed=1500.0, aperture=0.01)
plan = ReconstructionPlan(geometry, ImageGrid(8), compute=Compute(device="cpu"))
engine = CountingEngine(plan.tables, threads=2)
image = run_inverse(engine, traces)
assert engine.made == 1
ours = plan.run(traces).values
assert np.abs(image - ours).max() < 1e-4 * np.abs(ours).max()
"""
HTTP = """
import subprocess, sys

command = [sys.executable, "-m", "steradian.api.export_openapi"]
known = subprocess.run(command, capture_output=True, check=True, text=True).stdout
assert all(f'"{name}"' in known for name in ("ring", "raw", "count"))
"""


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """A copy with all that the page says how to add."""
    folder = tmp_path_factory.mktemp("house")
    for part in ("service", "driver"):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    assert len(DIFFS) == 3
    for diff in DIFFS:
        done = subprocess.run(["git", "apply", "-C1", "-"], input=diff, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize(
    "use", [ARRANGEMENT, FORMAT, JOB, HTTP], ids=["an arrangement", "a format", "a kind of job", "all over HTTP"]
)
def test_contributing_instructions_yield_working_extension(house, tmp_path, use):
    path = os.pathsep.join(str(each) for each in (house / "service", house / "driver", ROOT / "tests"))
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", use], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]


def test_engine_of_contributing_is_tried_without_changing_anything(tmp_path):
    """Without a copy, whose kernels would be compiled anew."""
    code = ENGINE + ENGINES
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
