"""Sizes of volumes before they are made: expected as they become, and large ones never unasked."""

import os
import pty
import subprocess
import sys

import numpy as np
import pytest

from steradian import ScanPlan, grid_mask
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.pipeline.size_limit import LargeVolume, expected_shape
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.opening import open_recording
from support.alines import Aline
from support.commands import run_here


def scan_of(path, aperture, samples):
    mask = grid_mask(aperture, 8, aperture / 8)
    create_scan_file(path, ScanPlan.create(mask=mask, samples=samples, sampling_interval=10e-9, order="given"))
    random = np.random.default_rng(0)
    with ScanFileWriter(path) as store:
        store.append(Aline(row, random.integers(-9, 9, samples).astype(np.int16)) for row in range(64))
    return path


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """A scan of 60 mm, whose default image has 1,000 × 1,000 × 300 voxels, 1.4 GB with its coarser copies."""
    return scan_of(tmp_path_factory.mktemp("wide") / "scan.h5", 60e-3, 300)


CASES = [{}, {"modes": 20, "upsampling": 2}, {"depth_range": (0.2e-3, 0.7e-3)}, {"conditioning": {"delay": 2e-6}}]


@pytest.mark.parametrize("given", CASES, ids=lambda given: ", ".join(given) or "defaults")
def test_expected_shape_is_the_volumes(tmp_path, given):
    scan = scan_of(tmp_path / "scan.h5", 1.6e-3, 128)
    parameters = ReconstructionParameters.create(**given)
    report = reconstruct_scan(scan, tmp_path / "out", parameters)
    assert expected_shape(open_recording(scan), parameters) == tuple(report.shape)


def test_large_volume_without_consent_is_refused_with_size(wide, tmp_path):
    with pytest.raises(LargeVolume, match=r"modes is 1000; allowed: .* 1.\d+ GB \(1000 × 1000 × 300 voxels of 60 µm"):
        reconstruct_scan(wide, tmp_path / "out", agreed=False)
    out = run_here("reconstruct", wide, "-o", "out", cwd=tmp_path, code=2)
    assert "with --yes" in " ".join(out.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_large_volume_is_asked_about_at_a_terminal(wide, tmp_path):
    near, far = pty.openpty()
    command = [sys.executable, "-m", "steradian", "reconstruct", wide, "-o", "out"]
    with subprocess.Popen(command, cwd=tmp_path, stdin=far, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as asked:
        os.write(near, b"n\n")
        said, _ = asked.communicate(timeout=120)
    for end in (near, far):
        os.close(end)
    assert "Make it? [y/N]" in said.decode()
    assert asked.returncode == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.long
@pytest.mark.parametrize("given", [{"modes": 100}, {"depth_range": (0.0, 0.1e-3)}])
def test_smaller_volume_of_the_same_scan_needs_no_consent(wide, tmp_path, given):
    report = reconstruct_scan(wide, tmp_path, ReconstructionParameters.create(**given), agreed=False)
    assert report.shape[0] in (100, 1000)
