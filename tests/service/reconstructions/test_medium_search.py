"""Speeds and thicknesses of layers, and time zero, found within their errors in A-lines simulated by rays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Acquisition, AcquisitionGeometry, ImageGrid, Layer, Medium
from steradian.jobs.requests import SoundSpeedRequest
from steradian.phantoms import Balls, layered_pressure
from steradian.reconstructions.studies import medium_fit
from steradian.reconstructions.studies.boundary_echoes import PlaneEchoes
from steradian.reconstructions.studies.medium_scan import scan_medium
from steradian.reconstructions.studies.medium_search import FoundMedium, find_medium
from steradian.reconstructions.studies.medium_unknowns import MediumState, resolve_unknowns
from steradian.reconstructions.studies.misfit_minimum import least
from steradian.reconstructions.studies.timed_operator import TimedOperator

TRUE = Medium([Layer(1480.0, 1.5e-3), Layer(1600.0)])
SIDE, COUNT, DT, SAMPLES = 5e-3, 20, 20e-9, 180
LINE = Medium([Layer(1480.0, 4e-3), Layer(2000.0, 4e-3), Layer(2600.0)])
LINE_DT, PITCH, SENSORS = 40e-9, 0.25e-3, 96


def start(medium: Medium, **factors: float) -> Medium:
    """Return the medium with parameters such as ``c2`` or ``d1`` multiplied by factors."""
    return Medium([
        Layer(
            layer.sound_speed * factors.get(f"c{i}", 1.0),
            layer.thickness and layer.thickness * factors.get(f"d{i}", 1.0),
        )
        for i, layer in enumerate(medium.layers, start=1)
    ])  # fmt: skip


def plane_scan(seed: int, upper: int) -> tuple[np.ndarray, np.ndarray]:
    """Return A-lines at 30 dB of ``upper`` balls above the boundary and eight below, and positions (M, 2)."""
    random = np.random.default_rng(seed)
    axis = (np.arange(COUNT) + 0.5) / COUNT - 0.5
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    positions = SIDE * (grid + random.uniform(-0.4, 0.4, grid.shape) / COUNT)
    depths = np.r_[random.uniform(0.8e-3, 1.1e-3, upper), random.uniform(2e-3, 3e-3, 8)]
    places = np.column_stack([random.uniform(-1.8e-3, 1.8e-3, (len(depths), 2)), depths])
    balls = Balls(places, np.full(len(depths), 70e-6), random.uniform(0.5, 1, len(depths)))
    traces = layered_pressure(balls, positions, TRUE, samples=SAMPLES, sampling_interval=DT)
    return traces + random.standard_normal(traces.shape) * np.abs(traces).max() * 10**-1.5, positions


def line_scan(seed: int, echoes: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return A-lines at 30 dB of three balls in each layer, and positions (M,); with plane echoes where asked for."""
    random = np.random.default_rng(seed)
    x = (np.arange(SENSORS) - SENSORS // 2) * PITCH
    depths = 1e-3 * np.array([1.8, 2.4, 3.0, 5.0, 5.8, 6.8, 9.5, 11.0, 12.5])
    places = np.column_stack([random.uniform(-7e-3, 7e-3, 9), np.zeros(9), depths])
    balls = Balls(places, np.full(9, 120e-6), random.uniform(0.7, 1, 9))
    positions = np.column_stack([x, np.zeros(SENSORS)])
    traces = layered_pressure(balls, positions, LINE, samples=450, sampling_interval=LINE_DT)
    if echoes:
        times = LINE_DT * np.arange(450)
        for depth in LINE.boundaries:
            later = (times - LINE.time_at(depth) - 80e-9) / 60e-9
            traces += np.abs(traces).max() * -later * np.exp(-(later**2) / 2)
    return traces + random.standard_normal(traces.shape) * np.abs(traces).max() * 10**-1.5, x


def on_line(seed: int, echoes: bool, medium: Medium, search: list[str] | None = None, **options: Any) -> FoundMedium:
    traces, x = line_scan(seed, echoes)
    acquisition = Acquisition(traces, x, dt=LINE_DT, medium=medium, aperture=SENSORS * PITCH)
    return find_medium(acquisition, search, modes=SENSORS, **options)


def values_of(found: FoundMedium) -> np.ndarray:
    return np.array([each.value for each in found.parameters])


def test_medium_search_on_a_line_with_plane_echoes_finds_speeds_and_thickness() -> None:
    moved = start(LINE, c1=1.05, d2=0.95)
    found = on_line(0, True, moved, ["layer1.sound_speed", "layer2.thickness"], standard_error=False)
    np.testing.assert_allclose(values_of(found), [1480.0, 4e-3], rtol=0.02)
    assert [each.criterion for each in found.parameters] == ["boundary echo", "boundary echo"]
    assert "plane echo at 2.6" in found.notes[0]


@pytest.mark.parametrize(
    ("echoes", "way"),
    [
        pytest.param(*case, marks=pytest.mark.long if case in ((False, 0.95), (True, 1.05)) else pytest.mark.nightly)
        for case in ((False, 0.95), (False, 1.05), (True, 0.95), (True, 1.05))
    ],
)
def test_medium_search_on_a_line_finds_all_speeds_within_two_percent(echoes: bool, way: float) -> None:
    found = on_line(1, echoes, start(LINE, c1=way, c2=way, c3=way))
    np.testing.assert_allclose(values_of(found), [layer.sound_speed for layer in LINE.layers], rtol=0.02)
    assert not any(each.at_edge for each in found.parameters)


@pytest.mark.long
def test_medium_search_on_a_line_finds_speed_and_thickness_of_a_layer() -> None:
    found = on_line(2, True, start(LINE, c2=1.05, d2=0.95), ["layer2.sound_speed", "layer2.thickness"])
    for each, true in zip(found.parameters, (2000.0, 4e-3), strict=True):
        assert each.standard_error is not None
        assert abs(each.value - true) < 3 * each.standard_error
    assert "trades against" in " ".join(found.notes)


@pytest.mark.long
def test_medium_search_on_a_line_finds_a_thickness_by_the_image_below() -> None:
    moved, names = start(LINE, d1=0.97, c2=1.03), ["layer1.thickness", "layer2.sound_speed"]
    found = on_line(5, False, moved, names)
    assert [each.criterion for each in found.parameters] == ["sharpness", "sharpness"]
    for each, true in zip(found.parameters, (4e-3, 2000.0), strict=True):
        assert each.standard_error is not None
        assert abs(each.value - true) < 3 * each.standard_error


@pytest.mark.long
def test_medium_search_on_a_line_finds_time_zero_by_the_echo_of_a_known_layer() -> None:
    traces, x = line_scan(4, True)
    late = Acquisition(traces, x, dt=LINE_DT, t0=0.15e-6, medium=LINE, aperture=SENSORS * PITCH)
    found = find_medium(late, ["time_zero", "layer2.sound_speed"], modes=SENSORS)
    for each, true in zip(found.parameters, (0.0, 2000.0), strict=True):
        assert each.criterion == "boundary echo"
        assert each.standard_error is not None
        assert abs(each.value - true) < 2 * each.standard_error


SPEEDS = (3, ("layer1.sound_speed", "layer2.sound_speed"), {"c1": 0.95, "c2": 1.05})
SPEED_AND_THICKNESS = (0, ("layer2.sound_speed", "layer1.thickness"), {"c2": 0.95, "d1": 1.05})


@pytest.mark.parametrize(
    ("upper", "search", "moved", "seed"),
    [
        pytest.param(*SPEEDS, 1, marks=pytest.mark.long),
        pytest.param(*SPEEDS, 2, marks=pytest.mark.nightly),
        pytest.param(*SPEED_AND_THICKNESS, 1, marks=pytest.mark.nightly),
        pytest.param(*SPEED_AND_THICKNESS, 2, marks=pytest.mark.nightly),
    ],
)
def test_medium_fit_covers_the_truth_within_three_errors(
    upper: int, search: tuple[str, ...], moved: dict[str, float], seed: int
) -> None:
    traces, positions = plane_scan(seed, upper)
    acquisition = Acquisition(traces, positions, dt=DT, medium=start(TRUE, **moved), aperture=SIDE)
    found = find_medium(acquisition, search)
    for each in found.parameters:
        true = MediumState(TRUE).value(resolve_unknowns([each.name], MediumState(TRUE))[0])
        assert each.criterion == "misfit"
        assert each.standard_error is not None
        assert abs(each.value - true) < 3 * each.standard_error
    if upper:
        np.testing.assert_allclose(values_of(found), [1480.0, 1600.0], rtol=0.01)


@pytest.mark.long
def test_medium_fit_with_all_free_notes_what_the_record_does_not_determine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(medium_fit, "ROUNDS", 1)  # the start is the truth
    traces, positions = plane_scan(3, 0)
    search = ["layer1.sound_speed", "layer2.sound_speed", "layer1.thickness", "time_zero"]
    found = find_medium(Acquisition(traces, positions, dt=DT, medium=TRUE, aperture=SIDE), search)
    assert any("is not determined by this record" in note or "trade against" in note for note in found.notes)
    zero = found.parameters[3]
    assert zero.standard_error is not None
    assert abs(zero.value) < 3 * zero.standard_error


def test_plane_echo_is_found_at_its_rise_and_not_in_noise() -> None:
    traces, _ = line_scan(3, True)
    found = PlaneEchoes(traces, LINE_DT, 0.0).between(2.4e-6, 3.0e-6)
    assert found is not None
    assert found.rise == pytest.approx(LINE.time_at(4e-3), abs=40e-9)
    assert found.rise < found.peak
    without, _ = line_scan(3, False)
    assert PlaneEchoes(without, LINE_DT, 0.0).between(2.4e-6, 3.0e-6) is None


def test_least_of_a_quadratic_has_its_place_and_the_scatter_of_the_noise() -> None:
    random = np.random.default_rng(0)
    design, true = random.standard_normal((200, 5, 2)), np.array([0.7, -0.4])

    def at(x: np.ndarray, noise: np.ndarray) -> np.ndarray:
        return design @ (x - true) + noise

    found = []
    for _ in range(200):
        noise = random.standard_normal((200, 5))
        behind, ahead = ([at(way * unit, noise) for unit in np.eye(2)] for way in (-1, 1))
        minimum = least(at(np.zeros(2), noise), behind, ahead, np.full(2, 5.0))
        found.append((minimum.step, np.diag(minimum.covariance)))
    steps, variances = (np.array(each) for each in zip(*found, strict=True))
    np.testing.assert_allclose(steps.mean(axis=0), true, atol=0.02)
    np.testing.assert_allclose(steps.std(axis=0), np.sqrt(variances.mean(axis=0)), rtol=0.15)


def test_least_of_two_parameters_with_one_effect_has_an_undetermined_direction() -> None:
    random = np.random.default_rng(0)
    effect, noise = random.standard_normal((50, 20)), 0.1 * random.standard_normal((50, 20))
    behind, ahead = ([noise + way * effect for _ in range(2)] for way in (-1, 1))
    minimum = least(noise, behind, ahead, np.full(2, 5.0))
    assert minimum.undetermined.shape == (2, 1)
    assert np.sqrt(np.diag(minimum.covariance)).min() > 3


def test_timed_operator_of_any_thickness_has_the_same_slices_and_an_exact_adjoint() -> None:
    shapes = set()
    for thickness in (1.4e-3, 1.61e-3):
        medium = Medium([Layer(1480.0, thickness), Layer(1600.0)])
        geometry = AcquisitionGeometry(plane_scan(0, 0)[1][::8], 40, dt=1e-7, medium=medium, aperture=SIDE)
        model = TimedOperator(geometry, ImageGrid(12), (4, 36), tolerance=1e-6)
        shapes.add(model.volume_shape)
    random = np.random.default_rng(0)
    volume, traces = random.standard_normal(model.volume_shape), random.standard_normal(model.trace_shape)
    left, right = np.vdot(model.forward(volume), traces), np.vdot(volume, model.backward(traces))
    assert left == pytest.approx(right, rel=1e-5)
    assert shapes == {(12, 12, 32)}


@pytest.mark.parametrize(
    ("search", "message"),
    [
        (["layer3.sound_speed"], r"search is layer3.sound_speed; allowed: a layer from 1 to 2"),
        (["layer2.thickness"], r"search is layer2.thickness; allowed: a thickness of a layer above the last"),
        (["density"], r"search is density; allowed: layer1.sound_speed"),
        (["time_zero", "time_zero"], r"each once"),
        ([], r"at least one of"),
    ],
)
def test_search_of_unknown_parameters_is_refused(search: list[str], message: str) -> None:
    layers = [{"sound_speed": 1480, "thickness": 1.5e-3}, {"sound_speed": 1600}]
    with pytest.raises(InvalidInput, match=message):
        resolve_unknowns(search, MediumState(TRUE))
    with pytest.raises(InvalidInput, match=message):
        SoundSpeedRequest.create(scan_id="s1", search=search, parameters={"medium": layers})


def test_search_span_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"span is 0.7; allowed: at least 0.001, at most 0.5"):
        resolve_unknowns(None, MediumState(TRUE), span=0.7)
    request = SoundSpeedRequest.create(scan_id="s1")
    assert (request.first, request.last, request.is_of_medium) == (1380.0, 1620.0, False)


@pytest.mark.long
def test_medium_of_a_recording_is_written_as_json_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in (("ROUNDS", 1), ("SUPPORT_STEPS", 2), ("STEPS", 2)):
        monkeypatch.setattr(medium_fit, name, few)
    p = np.random.default_rng(0).standard_normal((64, 16, 16)).astype(np.float32)
    file = tmp_path / "scan.npz"
    np.savez(file, p=p, dt=20e-9, dx=100e-6, c=1500.0)
    from steradian.cli.app import app

    options = ["--layer", "1480m/s:0.4mm", "--layer", "1580m/s", "--search", "layer1.thickness"]
    result = CliRunner().invoke(app, ["sound-speed", str(file), str(tmp_path / "cli"), *options])
    assert result.exit_code == 0, result.output
    assert "layer1.thickness" in result.output
    written = json.loads((tmp_path / "cli" / "sound-speed.json").read_text())
    assert [each["name"] for each in written["parameters"]] == ["layer1.thickness"]
    assert written["medium"]["layers"][1]["sound_speed"] == 1580
    assert (tmp_path / "cli" / "sound-speed.png").stat().st_size > 5000
    result = CliRunner().invoke(
        app, ["sound-speed", str(file), str(tmp_path / "no"), *options[:4], "--first", "1400m/s"]
    )
    assert result.exit_code != 0
    found = scan_medium(file, tmp_path / "one", search=["layer1.sound_speed", "time_zero"])
    assert [each.unit for each in found.parameters] == ["m/s", "s"]
