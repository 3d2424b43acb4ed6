"""What a sparse mask would have come to on a scan that was dense."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fabry_perot.simulator import phantoms
from steradian.core.exceptions import InvalidInput
from steradian.masks import Mask, equi_steradian_mask, grid_mask, subset_mask
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.studies.what_if import SubsetReport, compare_subset, select_subset
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

YARN = Path(__file__).parents[2] / "data" / "yarn_kwave_slice.npz"
SIDE, PITCH, DEPTH = 64, 60e-6, 1.2e-3
APERTURE = SIDE * PITCH


def _grid(side: int, pitch: float) -> Mask:
    """All points of a square grid as they lie in a recording: from −side//2 on."""
    line = (np.arange(side) - side // 2) * pitch
    positions = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    aperture = side * pitch
    weights = np.full(side**2, aperture**2 / side**2)
    return Mask(aperture=aperture, positions=positions, weights=weights, arrangement={"arrangement": "grid"})


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dense recording of a small yarn around the point of interest, in closed form, with 30 dB noise."""
    random = np.random.default_rng(4)
    yarn = phantoms.yarn(0, centre=(0.0, 0.0, DEPTH), radius=0.4e-3)
    objects = phantoms.Balls(yarn.centres, np.minimum(yarn.sigmas, 60e-6), yarn.amplitudes)
    times = np.arange(256) * 8e-9
    traces = phantoms.pressure(objects, _grid(SIDE, PITCH).positions, times, 1500.0)
    traces = traces + 10 ** (-30 / 20) * np.abs(traces).max() * random.standard_normal(traces.shape)
    path = tmp_path_factory.mktemp("dense") / "balls.npz"
    p = traces.T.reshape(256, SIDE, SIDE).astype(np.float32)
    np.savez(path, p=p, dt=8e-9, dx=PITCH, c=1500.0)
    return path


@pytest.mark.long
@pytest.mark.parametrize("points", ["nearest", "exact"])
def test_through_all_of_its_own_points_a_scan_is_the_full_image(balls: Path, tmp_path: Path, points: str) -> None:
    report = compare_subset(balls, _grid(SIDE, PITCH), tmp_path, points=points)  # type: ignore[arg-type]
    assert report.quality["volume_correlation"] == pytest.approx(1.0, abs=1e-6)
    assert report.quality["mip_z_correlation"] == pytest.approx(1.0, abs=1e-6)
    assert report.quality["volume_error"] < 1e-3
    assert not any("sharpness" in name for name in report.quality)  # of few sensors the largest
    assert (report.used, report.merged, report.share) == (SIDE**2, 0, 1.0)
    assert report.displacement_m["largest"] < 1e-12


def test_the_report_and_both_pictures_are_written(balls: Path, tmp_path: Path) -> None:
    report = compare_subset(balls, equi_steradian_mask(APERTURE, DEPTH, 200), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"what-if.json", "mip-z.png", "mip-z-full.png"}
    written = json.loads((tmp_path / "what-if.json").read_text())
    assert written["quality"] == report.quality
    assert written["share"] == pytest.approx(report.used / SIDE**2)
    assert written["saved"]["points"] == SIDE**2 - report.used
    assert report.diameter_m == pytest.approx(2 * DEPTH)


@pytest.mark.long
def test_equal_steradians_beat_grids_of_more_points_around_the_point_of_interest(balls: Path, tmp_path: Path) -> None:
    """The paper's finding: correlation of the z-projection within a disc around the point of interest."""
    sparse = compare_subset(balls, equi_steradian_mask(APERTURE, DEPTH, 150), tmp_path / "steradian", diameter=1.6e-3)
    side = int(np.ceil(np.sqrt(sparse.used)))
    best = -1.0
    for interval in (2, 3, 4, 5):
        line = np.arange(-(side // 2) * interval, side // 2 * interval + 1, interval)
        line = line[(line >= -SIDE // 2) & (line < SIDE // 2)]
        numbers = ((line[:, None] + SIDE // 2) * SIDE + line[None, :] + SIDE // 2).ravel()
        grid = subset_mask(_grid(SIDE, PITCH), numbers.tolist(), weighting="uniform")
        found = compare_subset(balls, grid, tmp_path / f"grid{interval}", points="exact", diameter=1.6e-3)
        best = max(best, found.quality["mip_z_correlation"])
    ours = sparse.quality["mip_z_correlation"]
    assert 1 - ours < 0.8 * (1 - best), (ours, best)


@pytest.mark.long
def test_on_data_this_project_did_not_write_equal_steradians_beat_the_same_number_at_random(tmp_path: Path) -> None:
    """k-Wave's yarn, an eighth of its sensors, with the mask's weights against equal ones as well."""
    recording = open_recording(YARN)
    mask = equi_steradian_mask(recording.aperture, 1.5e-3, 500)
    ours = compare_subset(YARN, mask, tmp_path / "ours")
    equal = compare_subset(YARN, mask, tmp_path / "equal", ReconstructionParameters.create(weights="uniform"))
    picked = np.random.default_rng(0).choice(len(recording.positions), ours.used, replace=False)
    random = subset_mask(_grid(SIDE, recording.aperture / SIDE), sorted(picked))
    other = compare_subset(YARN, random, tmp_path / "random", diameter=ours.diameter_m)
    found = [r.quality["mip_z_correlation"] for r in (ours, equal, other)]
    assert found[0] > 0.9
    assert found[0] > max(found[1:]), found
    assert ours.share < 0.13
    assert set(ours.correlation_by_diameter)
    assert all(-1 <= v <= 1 for v in ours.correlation_by_diameter.values())


def _through(mask: Mask, points: str = "nearest") -> tuple[Recording, SubsetReport]:
    return select_subset(open_recording(YARN), mask, points)  # type: ignore[arg-type]


def test_points_that_pick_the_same_aline_are_merged_and_their_weights_added() -> None:
    recording = open_recording(YARN)
    pitch = recording.aperture / SIDE
    positions = np.array([[0.1 * pitch, 0.0], [-0.2 * pitch, 0.1 * pitch], [3 * pitch, 0.0]])
    area = recording.aperture**2
    mask = Mask(
        aperture=recording.aperture,
        positions=positions,
        weights=area * np.array([0.2, 0.3, 0.5]),
        arrangement={"kind": "x"},
    )
    sparse, report = _through(mask)
    assert (report.asked, report.used, report.merged) == (3, 2, 1)
    np.testing.assert_allclose(sparse.positions, [[0, 0], [3 * pitch, 0]], atol=1e-12)
    assert sparse.weights is not None
    np.testing.assert_allclose(sparse.weights, area * np.array([0.5, 0.5]))
    assert report.displacement_m["largest"] == pytest.approx(np.hypot(0.2, 0.1) * pitch)
    rows = [int(np.flatnonzero((recording.positions == p).all(axis=1))[0]) for p in sparse.positions]
    np.testing.assert_array_equal(sparse.traces, recording.traces[rows])


def test_an_exact_mask_with_points_not_measured_is_refused_with_their_number_and_distance() -> None:
    recording = open_recording(YARN)
    pitch = recording.aperture / SIDE
    mask = _grid(SIDE, pitch)
    positions = mask.positions.copy()
    positions[:7] += [0.25 * pitch, 0]
    with pytest.raises(InvalidInput, match=rf"7 of {len(positions)} points .* {0.25e6 * pitch:.4g} µm"):
        _through(mask.replace(positions=positions), "exact")


def test_masks_that_do_not_fit_the_scan_are_refused() -> None:
    with pytest.raises(InvalidInput, match="aperture"):
        _through(grid_mask(0.5, 10, 40e-3))
    line = Mask(aperture=1e-3, positions=[[0.0], [1e-4]], weights=[5e-4, 5e-4], arrangement={"kind": "line"})
    with pytest.raises(InvalidInput, match="plane"):
        _through(line)
    with pytest.raises(InvalidInput, match="nearest or exact"):
        _through(_grid(64, 1e-5), "some")
