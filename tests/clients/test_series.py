"""Six frames at two wavelengths, from a file to oxygen saturation and pictures: Python client, curl and terminal."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nibabel
import numpy as np
import pytest
from PIL import Image

from support.series_scan import LIGHTS, SATURATION, write_scan

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]
CLIENTS = Path(__file__).parents[2] / "clients"
FRAMES = 3


@pytest.fixture
def scan(tmp_path):
    return write_scan(tmp_path / "scan.h5", repeats=FRAMES)


def run(*command, folder, **more):
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, **more}
    ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=380)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def assert_pictures(folder):
    for name in ("series.png", "saturation.png"):
        with Image.open(folder / name) as picture:
            assert min(picture.size) > 200, name


def test_python_client_example_unmixes_six_frames_to_the_saturation(url, scan, tmp_path):
    said = run(sys.executable, CLIENTS / "python/examples/series.py", "scan.h5", folder=tmp_path, STERADIAN_URL=url)
    lines = re.findall(r"frames \[(\d)\] at (\d+) nm: (\S+)", said)
    assert [(int(number), float(light) * 1e-9) for number, light, _ in lines] == [
        (number, pytest.approx(LIGHTS[number // FRAMES])) for number in range(2 * FRAMES)
    ]
    found, error = map(float, re.search(r"saturation (\S+) ± (\S+) in", said).groups())
    assert abs(found - SATURATION) < 0.03
    assert 0 < error < 0.05
    assert_pictures(tmp_path)
    (exported,) = tmp_path.glob("*.nii.gz")
    peaks = nibabel.load(exported).get_fdata().max(axis=(0, 1, 2))
    assert peaks == pytest.approx([float(value) for *_, value in lines], rel=1e-3)


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl: apt-get install curl")
def test_curl_script_unmixes_six_frames_to_the_saturation(url, scan, tmp_path):
    run(CLIENTS / "http/series.sh", "scan.h5", url, folder=tmp_path)
    frames = json.loads((tmp_path / "series.json").read_text())["report"]["frames"]
    assert [each["numbers"] for each in frames] == [[number] for number in range(2 * FRAMES)]
    assert np.load(tmp_path / "volume-0.npy").max() == pytest.approx(frames[0]["maximum"], rel=1e-6)
    found = json.loads((tmp_path / "saturation.json").read_text())["report"]["unmixing"]["saturation"]
    assert abs(found["mean"] - SATURATION) < 0.03
    saturation = np.load(tmp_path / "saturation.npy")
    assert abs(np.nanmedian(saturation) - SATURATION) < 0.05
    assert_pictures(tmp_path)


def test_commands_unmix_six_frames_to_the_saturation(scan, tmp_path):
    run("steradian", "reconstruct", "scan.h5", "-o", "series", "--modes", "24", folder=tmp_path)
    run("steradian", "unmix", "series", "--fluence", "uniform", "-o", "so2", folder=tmp_path)
    found = json.loads((tmp_path / "so2" / "report.json").read_text())["saturation"]
    assert abs(found["mean"] - SATURATION) < 0.03
    shutil.copy(tmp_path / "series" / "mip-z.png", tmp_path / "series.png")
    shutil.copy(tmp_path / "so2" / "saturation.png", tmp_path / "saturation.png")
    assert_pictures(tmp_path)
