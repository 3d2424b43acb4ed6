"""Standard errors as a second volume, and suppressed artefacts, from the command line and in reports."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import steradian
from steradian.cli.subset_options import parse_subsets, refuse_series
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import prepare, reconstruct_scan
from steradian.reconstructions.pipeline.sensor_subsets import SubsetOptions
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.opening import open_recording
from support.commands import run_here

SIDE = 16
PLAIN = ("--sound-speed", "1500", "--device", "cpu")
PARAMETERS = ReconstructionParameters.create(sound_speed=1500.0, device="cpu")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A-lines of a ball below 16 × 16 sensors with noise, as k-Wave would have written them."""
    axis = (np.arange(SIDE) - SIDE // 2) * 100e-6
    r = np.sqrt(axis[:, None] ** 2 + axis[None, :] ** 2 + 0.6e-3**2)
    ct = np.arange(100)[:, None, None] * 20e-9 * 1500.0
    p = (r - ct) / r * np.exp(-((r - ct) ** 2) / (2 * 0.1e-3**2))
    p += 0.02 * np.random.default_rng(0).standard_normal(p.shape)
    file = tmp_path / "scan.npz"
    np.savez(file, p=p.astype(np.float32), dt=20e-9, dx=100e-6, c=1500.0)
    return file


@pytest.mark.long
def test_standard_errors_are_a_second_volume_and_the_image_stays_as_it_is(scan: Path, tmp_path: Path) -> None:
    told = run_here("reconstruct", scan, *PLAIN, "--uncertainty", cwd=tmp_path)
    folder = tmp_path / "reconstruction"
    errors, image = read_volume(folder / "uncertainty.h5"), read_volume(folder / "volume.h5")
    acquisition, setup = prepare(open_recording(scan), PARAMETERS)
    expected = steradian.uncertainty(acquisition, setup.grid, setup.method, compute=setup.compute)
    np.testing.assert_array_equal(errors.values, expected.values)
    assert errors.spacing == image.spacing
    reconstruct_scan(scan, tmp_path / "plain", PARAMETERS)
    np.testing.assert_array_equal(image.values, read_volume(tmp_path / "plain" / "volume.h5").values)
    assert not (tmp_path / "plain" / "uncertainty.h5").exists()
    assert json.loads((tmp_path / "plain" / "report.json").read_text())["uncertainty"] is None
    report = json.loads((folder / "report.json").read_text())
    shown = errors.axes.z >= report["near_field_m"]
    assert report["uncertainty"]["file"] == "uncertainty.h5"
    assert report["uncertainty"]["replicates"] == 8
    assert report["uncertainty"]["median"] == pytest.approx(float(np.median(errors.values[..., shown])))
    above = image.values[..., shown] > 3 * errors.values[..., shown]
    assert report["uncertainty"]["above_three"] == pytest.approx(float(above.mean()))
    assert 0 < above.mean() < 0.2
    assert "uncertainty.h5" in told


@pytest.mark.long
def test_artefacts_are_suppressed_on_request_only_and_report_and_file_say_so(scan: Path, tmp_path: Path) -> None:
    told = run_here("reconstruct", scan, *PLAIN, "--suppress-artefacts", cwd=tmp_path)
    folder = tmp_path / "reconstruction"
    acquisition, setup = prepare(open_recording(scan), PARAMETERS)
    expected = steradian.suppress_artefacts(acquisition, setup.grid, setup.method, compute=setup.compute)
    np.testing.assert_allclose(read_volume(folder / "volume.h5").values, expected.values, atol=1e-6)
    report = json.loads((folder / "report.json").read_text())
    assert any("artefacts were suppressed" in note and "not for measuring" in note for note in report["notes"])
    assert "artefacts were suppressed" in report["provenance"]["values"]
    assert "artefacts were suppressed" in " ".join(told.split())
    reconstruct_scan(scan, tmp_path / "plain", PARAMETERS)
    plain = json.loads((tmp_path / "plain" / "report.json").read_text())
    assert not any("suppressed" in note for note in plain["notes"])
    assert "values" not in plain["provenance"]


@pytest.mark.parametrize(
    ("options", "given", "said"),
    [
        (SubsetOptions(uncertainty=True), {"method": "iterative"}, "uncertainty.*direct method"),
        (SubsetOptions(suppress_artefacts=True), {"method": "iterative"}, "suppress_artefacts.*direct method"),
        (SubsetOptions(uncertainty=True), {"motion": True}, "uncertainty.*without motion"),
        (SubsetOptions(suppress_artefacts=True), {"motion": True}, "suppress_artefacts.*without motion"),
        (SubsetOptions(True, True), {}, "uncertainty.*without suppress_artefacts"),
    ],
)
def test_what_does_not_go_together_is_refused(
    options: SubsetOptions, given: dict[str, Any], said: str, scan: Path
) -> None:
    with pytest.raises(InvalidInput, match=said):
        options.check(open_recording(scan), **{"method": "nedner", "motion": False, **given})


def test_lines_and_few_sensors_are_refused(tmp_path: Path) -> None:
    """Of a line, standard errors exist; halves of its sensors are not made."""
    few, line = tmp_path / "few.npz", tmp_path / "line.npz"
    np.savez(few, p=np.zeros((50, 3, 3), np.float32), dt=20e-9, dx=100e-6, c=1500.0)
    np.savez(
        line, p=np.repeat(np.arange(50) > 30, 32).reshape(50, 32).astype(np.float32), dt=20e-9, dx=100e-6, c=1500.0
    )
    for options in (SubsetOptions(uncertainty=True), SubsetOptions(suppress_artefacts=True)):
        with pytest.raises(InvalidInput, match="16 or more sensors"):
            options.check(open_recording(few), "nedner", motion=False)
    SubsetOptions(uncertainty=True).check(open_recording(line), "nedner", motion=False)
    with pytest.raises(InvalidInput, match="in a plane"):
        SubsetOptions(suppress_artefacts=True).check(open_recording(line), "nedner", motion=False)


@pytest.mark.parametrize("wanted", [(True, False), (False, True)])
def test_series_and_scans_that_are_followed_are_refused(wanted: tuple[bool, bool]) -> None:
    with pytest.raises(InvalidInput, match="without follow"):
        parse_subsets(*wanted, follow=True)
    with pytest.raises(InvalidInput, match="one image"):
        refuse_series(parse_subsets(*wanted, follow=False))
    refuse_series(parse_subsets(False, False, follow=True))
