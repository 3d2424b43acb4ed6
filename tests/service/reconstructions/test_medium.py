"""Layers and attenuation in requests: place of a ball simulated by rays, files, report, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Attenuation, Layer, Medium, Volume
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.request_versions import current
from steradian.jobs.requests import SoundSpeedRequest, to_job_request
from steradian.phantoms import Balls, layered_pressure
from steradian.reconstructions.live.follow import reconstruct_live
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import sound_speed_of
from steradian.reconstructions.pipeline.run import reconstruct_in_memory, reconstruct_scan
from steradian.reconstructions.pipeline.size_limit import expected_shape
from steradian.reconstructions.studies.sound_speed_search import scan_sound_speed
from steradian.reconstructions.studies.width import measure_width
from steradian.reconstructions.volumes.file import read_parameters, read_volume
from steradian.scans.opening import open_recording

SIDE, PITCH, DT, SAMPLES = 24, 100e-6, 20e-9, 110
LAYERS: list[dict[str, Any]] = [{"sound_speed": 1480, "thickness": 1e-3}, {"sound_speed": 1700}]
TISSUE = {"coefficient": 0.75, "power": 1.5}
CENTRE = np.array([0.2e-3, -0.1e-3, 2.0e-3])
AXIS = (np.arange(SIDE) - SIDE // 2) * PITCH


def write_recording(path: Path, medium: Medium) -> Path:
    """Write the A-lines of a ball in a medium in k-Wave's form, with a speed of sound of 1480 m/s."""
    positions = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
    ball = Balls(CENTRE[None], np.array([90e-6]), np.ones(1))
    traces = layered_pressure(ball, positions, medium, samples=SAMPLES, sampling_interval=DT)
    p = traces.T.reshape(SAMPLES, SIDE, SIDE)
    np.savez(path, p=p.astype(np.float32), dt=DT, dx=PITCH, c=1480.0)
    return path


@pytest.fixture(scope="module")
def layered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    medium = Medium([Layer(1480.0, 1e-3), Layer(1700.0)])
    return write_recording(tmp_path_factory.mktemp("layered") / "scan.npz", medium)


def place(volume: Volume) -> np.ndarray:
    at = np.unravel_index(volume.values.argmax(), volume.values.shape)
    return np.array([volume.coordinates(name)[i] for name, i in zip(volume.names, at, strict=True)])


def test_layers_image_a_ball_at_its_depth_within_a_voxel(layered: Path) -> None:
    recording = open_recording(layered)
    volume = reconstruct_in_memory(recording, ReconstructionParameters.create(medium=LAYERS))
    assert (np.abs(place(volume) - CENTRE) <= volume.spacing).all()
    one_speed = reconstruct_in_memory(recording, ReconstructionParameters())
    assert abs(place(one_speed)[2] - CENTRE[2]) > 2 * volume.spacing[2]


@pytest.mark.long
def test_layers_of_the_iterative_method_image_a_ball_at_its_depth(layered: Path) -> None:
    recording = open_recording(layered)
    iterative = {"method": "iterative", "iterative": {"iterations": 3}, "depth_range": (1.5e-3, 2.4e-3)}
    volume = reconstruct_in_memory(recording, ReconstructionParameters.create(medium=LAYERS, **iterative))
    assert (np.abs(place(volume) - CENTRE) <= volume.spacing).all()


def test_layer_without_speed_has_the_scans(layered: Path) -> None:
    recording = open_recording(layered)
    parameters = ReconstructionParameters.create(medium=[{"thickness": 1e-3}, {"sound_speed": 1700}])
    assert sound_speed_of(recording, parameters) == 1480
    given = reconstruct_in_memory(recording, ReconstructionParameters.create(medium=LAYERS))
    np.testing.assert_array_equal(reconstruct_in_memory(recording, parameters).values, given.values)


@pytest.mark.long
def test_medium_is_in_report_and_volume_file(layered: Path, tmp_path: Path) -> None:
    medium = [{"thickness": 1e-3, "sound_speed": 1700}, {"attenuation": TISSUE}]
    report = reconstruct_scan(layered, tmp_path, ReconstructionParameters.create(medium=medium))
    written = json.loads((tmp_path / "report.json").read_text())
    for used in (report.parameters, written["parameters"]):
        assert used["sound_speed"] is None
        assert used["medium"][1] == {"sound_speed": 1480, "thickness": None, "density": None, "attenuation": TISSUE}
    assert written["sound_speed_m_s"] == 1480
    assert any("beyond 61° to the normal does not reach the film" in note for note in written["notes"])
    assert any("noise gain" in note for note in written["notes"])
    depths, gains = np.transpose(written["noise_gain"])
    assert depths[0] >= 1e-3
    assert gains.min() > 0
    with Image.open(tmp_path / "noise-gain.png") as drawn:
        assert drawn.width > drawn.height > 300
    again = read_parameters(tmp_path / "volume.h5")
    assert ReconstructionParameters.create(**written["parameters"]) == again
    assert again.medium is not None
    assert again.medium[0].sound_speed == 1700
    assert read_volume(tmp_path / "volume.h5").sound_speed == 1480


def test_stored_request_has_the_layers_again() -> None:
    wanted = ReconstructionRequest.create(scan_id="s1", parameters={"medium": [*LAYERS[:1], {"attenuation": TISSUE}]})
    payload = json.loads(json.dumps(to_job_request("r1", wanted).payload))
    assert ReconstructionRequest.create(**current(payload)) == wanted


def test_attenuation_compensation_raises_a_ball(tmp_path: Path) -> None:
    law = {"coefficient": 8.0, "power": 1.1}
    recording = open_recording(
        write_recording(tmp_path / "scan.npz", Medium([Layer(1480.0, attenuation=Attenuation(**law))]))
    )
    plain, compensated = (
        reconstruct_in_memory(recording, ReconstructionParameters.create(**given))
        for given in ({}, {"medium": [{"attenuation": law}]})
    )
    lossless = open_recording(write_recording(tmp_path / "lossless.npz", Medium([Layer(1480.0)])))
    top = reconstruct_in_memory(lossless, ReconstructionParameters()).values.max()
    assert plain.values.max() < 0.6 * top
    assert compensated.values.max() == pytest.approx(top, rel=0.1)


@pytest.mark.parametrize("given", [{}, {"depth_range": (0.5e-3, None)}, {"depth_range": (0.5e-3, 2.2e-3)}])
def test_expected_shape_of_layers_is_the_volumes(layered: Path, given: dict[str, Any]) -> None:
    recording, parameters = open_recording(layered), ReconstructionParameters.create(medium=LAYERS, **given)
    assert expected_shape(recording, parameters) == reconstruct_in_memory(recording, parameters).values.shape


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"medium": LAYERS, "sound_speed": 1500}, "sound_speed is 1500.0; allowed: none beside a medium"),
    ({"medium": []}, "medium is "),
    ({"medium": [{"sound_speed": 15}]}, r"medium.0.sound_speed is 15; allowed: at least 300, at most 12000 \(m/s\)"),
    ({"medium": [{"thickness": -1e-3}, {}]}, r"medium.0.thickness is -0.001; allowed: at least 1e-06, at most 1 \(m\)"),
    ({"medium": [{}, {}]}, r"medium.0.thickness is missing; allowed: at least 1e-06, at most 1 \(m\)"),
    ({"medium": [{"thickness": 1e-3}, {"thickness": 2e-3}]}, "medium.1.thickness is 0.002; allowed: none for the last"),
    ({"medium": [{"thickness": 1e-3, "density": 998}, {}]}, "medium.1.density is missing; .*all layers or for none"),
    (
        {"medium": [{"attenuation": {"coefficient": 0.75, "power": 3}}]},
        "medium.0.attenuation.power is 3; allowed: at least 0, at most 2.9",
    ),
    ({"medium": LAYERS, "method": "linear"}, "method is linear; allowed: nedner, ner, iterative for a medium"),
    ({"medium": LAYERS, "method": "iterative", "device": "gpu"}, "device is gpu; allowed: auto or cpu"),
]


@pytest.mark.parametrize(("given", "words"), REFUSED)
def test_impossible_medium_is_refused_with_field_value_and_range(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        ReconstructionParameters.create(**given)


def test_depth_beyond_the_record_is_refused_by_its_range(layered: Path) -> None:
    parameters = ReconstructionParameters.create(medium=LAYERS, depth_range=(0, 9e-3))
    with pytest.raises(InvalidInput, match=r"depth_range is .*; allowed: two depths in metres"):
        reconstruct_in_memory(open_recording(layered), parameters)


def test_studies_of_one_speed_refuse_a_medium(layered: Path, tmp_path: Path) -> None:
    lossy = {"medium": [{"attenuation": TISSUE}]}
    with pytest.raises(InvalidInput, match=r"parameters.medium is with attenuation"):
        ReconstructionRequest.create(scan_id="s1", follow=True, parameters=lossy)
    with pytest.raises(InvalidInput, match=r"medium is with attenuation"):
        reconstruct_live(layered, tmp_path, ReconstructionParameters.create(**lossy), is_over=lambda: True)
    with pytest.raises(
        InvalidInput, match=r"first is 1400, last 1500; allowed: none beside search or parameters.medium"
    ):
        SoundSpeedRequest.create(scan_id="s1", first=1400, last=1500, parameters={"medium": LAYERS})
    with pytest.raises(InvalidInput, match=r"medium is 2 layers"):
        scan_sound_speed(layered, tmp_path, ReconstructionParameters.create(medium=LAYERS))


def test_width_in_layers_is_measured_without_correction(layered: Path) -> None:
    parameters = ReconstructionParameters.create(medium=LAYERS)
    volume = reconstruct_in_memory(open_recording(layered), parameters)
    start, end = ((CENTRE[0], CENTRE[1], CENTRE[2] + reach) for reach in (-0.3e-3, 0.3e-3))
    found = measure_width(volume, layered, start, end, parameters=parameters)
    assert 100e-6 < found.fwhm < 300e-6
    assert found.corrected is None
    assert "layered or attenuating medium" in str(found.reason)
