"""The live view: revisions while a scan runs, and at its end the reconstruction from the file."""

from __future__ import annotations

import json
import multiprocessing
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabry_perot import RecoveryPolicy, simulator
from fabry_perot.simulator import phantoms
from steradian.core.exceptions import Cancelled, InvalidInput, NotFound
from steradian.imaging import Volume, reconstruct
from steradian.imaging.signal.conditioning import Display
from steradian.masks import equi_steradian_mask, equiangular_mask
from steradian.plans import ScanPlan
from steradian.quality import above_threshold, correlation
from steradian.reconstructions.live import follow as live
from steradian.reconstructions.live.follow import LiveReconstruction, reconstruct_live
from steradian.reconstructions.live.preview import CoarseParameters, choose_preview
from steradian.reconstructions.live.revision_metrics import Revision
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import resolve_setup
from steradian.reconstructions.pipeline.run import reconstruct_scan
from steradian.reconstructions.volumes.file import read_volume
from steradian.reconstructions.volumes.reader import VolumeReader
from steradian.scans.acquisition.run import run_scan
from steradian.scans.file.read import read_scan
from steradian.scans.file.tail import IdleDetector, ScanTail
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.recording import Recording
from steradian_benchmarks.live import live as benchmark
from support.alines import Aline
from support.pacing import InStep

SAMPLES, INTERVAL, SPEED = 256, 8e-9, 1500.0
CUT = 1.32e-3
"""Metres, between the upper ball, which is brighter, and the lower."""
PARAMETERS = ReconstructionParameters.create(modes=32)


class GrowingScan:
    """A scan file of two balls, filled on demand."""

    def __init__(self, path: Path, order: str = "progressive", count: int = 200) -> None:
        self.path = path
        mask = equi_steradian_mask(4e-3, 1.2e-3, count)
        self.plan = ScanPlan.create(mask=mask, samples=SAMPLES, sound_speed=SPEED, order=order)
        balls = phantoms.Balls(
            centres=np.array([[0.3e-3, -0.2e-3, 1.2e-3], [-0.6e-3, 0.5e-3, 1.5e-3]]),
            sigmas=np.array([70e-6, 90e-6]),
            amplitudes=np.array([1.0, 0.7]),
        )
        pressure = phantoms.pressure(balls, mask.positions, np.arange(SAMPLES) * INTERVAL, SPEED)
        self.scale = float(np.abs(pressure).max()) / 30000
        self.counts = np.rint(pressure / self.scale).astype(np.int16)
        create_scan_file(path, self.plan, simulated=True)
        self.done = 0

    def measure(self, count: int) -> None:
        points = range(self.done, min(self.done + count, self.plan.mask.count))
        with ScanFileWriter(self.path) as store:
            store.append(Aline(p, self.counts[self.plan.visit[p]], scale=self.scale) for p in points)
        self.done = points.stop

    @property
    def is_over(self) -> bool:
        return self.done == self.plan.mask.count


@pytest.fixture
def scan(tmp_path: Path) -> GrowingScan:
    return GrowingScan(tmp_path / "scan.h5")


def test_a_growing_image_is_seen_and_judged_from_the_near_field_on(scan: GrowingScan, tmp_path: Path) -> None:
    """As its picture is, and as the image is when the scan is over: the ball above the cut is not seen."""
    parameters, output = ReconstructionParameters.create(modes=32, display=Display(near_field=CUT)), tmp_path / "live"
    scan.measure(150)
    view = LiveReconstruction(scan.path, output, parameters, "full")
    revision = view.update()
    assert revision is not None
    volume = view.volume()
    below = volume.values[..., volume.axes.z >= CUT].max(axis=2)
    assert np.array_equal(VolumeReader(output / "projections.h5").projection("z"), below)
    assert below.max() < 0.8 * volume.values.max()
    assert revision.quality["maximum"] == pytest.approx(float(below.max()))
    scan.measure(1000)
    reconstruct_live(scan.path, output, parameters, is_over=lambda: True, wait=lambda _: None)
    last = json.loads((output / "revision.json").read_text())
    whole = read_volume(output / "volume.h5")
    assert last["final"]
    assert last["quality"]["maximum"] == pytest.approx(float(whole.values[..., whole.axes.z >= CUT].max()))


def _distance(image: np.ndarray, reference: np.ndarray) -> float:
    return float(np.linalg.norm(image - reference) / np.linalg.norm(reference))


def _from_scratch(
    scan: GrowingScan, view: LiveReconstruction, parameters: ReconstructionParameters = PARAMETERS
) -> Volume:
    """All A-lines of the file, with the view's voxels."""
    recording = read_scan(scan.path)
    traces = recording.traces * np.asarray(recording.scale)[:, None]
    geometry, grid, method, compute = view.preview.apply(resolve_setup(recording, parameters))
    return reconstruct(geometry.acquisition(view.preview.decimate(traces)), grid, method, compute=compute)


def _whole(recording: Recording, parameters: ReconstructionParameters, traces: np.ndarray) -> Volume:
    """Reconstruct A-lines with the full image's parameters."""
    geometry, grid, method, compute = resolve_setup(recording, parameters)
    return reconstruct(geometry.acquisition(traces), grid, method, compute=compute)


@pytest.mark.long
def test_revisions_appear_as_alines_come_and_the_last_is_the_reconstruction_from_the_file(
    scan: GrowingScan, tmp_path: Path
) -> None:
    """Each pause between two looks at the file brings 40 A-lines: five revisions, then the full one."""
    output, seen = tmp_path / "live", []
    scan.measure(40)

    def revised(_: object) -> None:
        seen.append(json.loads((output / "revision.json").read_text()))
        for axis in "xyz":
            assert (output / f"mip-{axis}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        stored = VolumeReader(output / ("volume.h5" if seen[-1]["final"] else "projections.h5"))
        assert list(stored.lattice.shape) == seen[-1]["image"]["shape"]
        assert stored.projection("z").max() == pytest.approx(seen[-1]["quality"]["maximum"])

    report = reconstruct_live(
        scan.path,
        output,
        PARAMETERS,
        is_over=lambda: scan.is_over,
        interval=0.1,
        revised=revised,
        wait=lambda _: scan.measure(40),
    )
    points = [revision["points"] for revision in seen]
    assert points == [*[40, 80, 120, 160, 200, report.planned][: len(points) - 1], report.planned]
    assert len(points) >= 5
    assert [revision["number"] for revision in seen] == list(range(1, len(seen) + 1))
    assert [revision["final"] for revision in seen] == [False] * (len(seen) - 1) + [True]
    assert seen[0]["quality"]["correlation_with_previous"] is None
    assert all(revision["quality"]["correlation_with_previous"] > 0.5 for revision in seen[2:])
    assert all(revision["quality"]["sharpness"] > 0 for revision in seen)
    gaps = [revision["coverage"]["largest_gap_m"] for revision in seen[:-1]]
    assert gaps == sorted(gaps, reverse=True)
    reference = tmp_path / "reference"
    reconstruct_scan(scan.path, reference, PARAMETERS)
    same = _distance(read_volume(output / "volume.h5").values, read_volume(reference / "volume.h5").values)
    assert same < 1e-6
    for axis in "xyz":
        assert (output / f"mip-{axis}.png").read_bytes() == (reference / f"mip-{axis}.png").read_bytes()
    assert {path.name for path in reference.iterdir()} | {"revision.json"} == {path.name for path in output.iterdir()}


def test_coverage_of_stopped_scan_is_reported_as_area_fraction(scan: GrowingScan, tmp_path: Path) -> None:
    """A mask's points stand for areas that differ tenfold."""
    told: list[Revision] = []
    looks = iter([False, False, True])

    def is_over() -> bool:
        return next(looks, True)

    scan.measure(60)
    reconstruct_live(scan.path, tmp_path / "out", PARAMETERS, is_over=is_over, interval=0.0, revised=told.append)
    weights = scan.plan.mask.weights
    sensed = weights[scan.plan.visit[:60]].sum() / weights.sum()
    assert told[-1].final
    assert told[-1].coverage["area"] == pytest.approx(sensed, rel=1e-6)
    assert abs(sensed - 60 / len(weights)) > 0.01


@pytest.mark.long
@pytest.mark.parametrize("detail", ["full", "preview"])
@pytest.mark.parametrize("order", ["progressive", "snake"])
def test_the_image_grown_from_all_alines_is_the_one_made_from_the_file_at_once(
    tmp_path: Path, order: str, detail: str
) -> None:
    scan = GrowingScan(tmp_path / "scan.h5", order)
    view = LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS, detail)  # type: ignore[arg-type]
    while not scan.is_over:
        scan.measure(37)
        view.update()
    assert _distance(view.volume().values, _from_scratch(scan, view).values) < 1e-4
    if detail == "full":
        report = reconstruct_scan(scan.path, tmp_path / "whole", PARAMETERS)
        assert view.volume().values.shape == report.shape


def test_a_preview_has_a_quarter_of_the_voxels_and_shows_the_same_projection(scan: GrowingScan, tmp_path: Path) -> None:
    scan.measure(1000)
    views = [LiveReconstruction(scan.path, tmp_path / d, PARAMETERS, d) for d in ("preview", "full")]  # type: ignore[arg-type]
    for view in views:
        view.update()
    small, full = (view.volume() for view in views)
    assert small.values.size <= 0.25 * full.values.size
    assert small.spacing[:2] == full.spacing[:2]
    assert correlation(small.mip("z"), full.mip("z")) > 0.98


@pytest.mark.long
@pytest.mark.parametrize("detail", ["preview", "full"])
def test_image_grown_in_layers_is_the_one_of_these_layers(scan: GrowingScan, tmp_path: Path, detail: str) -> None:
    layers = [{"sound_speed": SPEED, "thickness": 0.8e-3}, {"sound_speed": 1650.0}]
    parameters = PARAMETERS.replace(medium=layers, depth_range=(0.2e-3, 1.9e-3))
    scan.measure(1000)
    view = LiveReconstruction(scan.path, tmp_path / "live", parameters, detail)  # type: ignore[arg-type]
    view.update()
    reconstruct_scan(scan.path, tmp_path / "whole", parameters)
    whole, grown = read_volume(tmp_path / "whole" / "volume.h5"), view.volume()
    places = [v.axes.z[np.unravel_index(v.values.argmax(), v.values.shape)[2]] for v in (whole, grown)]
    assert abs(places[0] - places[1]) <= grown.spacing[2]
    if detail == "full":  # which may begin a slice earlier
        assert _distance(grown.values[..., -whole.values.shape[2] :], whole.values) < 1e-4


def test_weights_fitted_to_the_points_so_far_make_a_half_done_pass_a_better_projection(tmp_path: Path) -> None:
    """In the middle of the last pass of a progressive order one half of the aperture is twice as dense as the other."""
    scan = GrowingScan(tmp_path / "scan.h5", count=800)
    view = LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS, "full")
    scan.measure(int(0.62 * scan.plan.mask.count))
    view.update()
    grown, plain = view.volume(), _from_scratch(scan, view)
    scan.measure(1000)
    model = _from_scratch(scan, view).mip("z")
    interest = above_threshold(model)
    alike = [correlation(image.mip("z"), model, interest) for image in (grown, plain)]
    assert 1 - alike[0] < 0.7 * (1 - alike[1])


def test_live_common_median_is_recomputed_each_revision(scan: GrowingScan, tmp_path: Path) -> None:
    parameters = PARAMETERS.replace(conditioning=replace(PARAMETERS.conditioning, remove_common="median"))
    view = LiveReconstruction(scan.path, tmp_path / "live", parameters, "full")
    while not scan.is_over:
        scan.measure(90)
        view.update()
    recording = read_scan(scan.path)
    traces = recording.traces * np.asarray(recording.scale)[:, None]
    traces -= np.median(traces, axis=0)
    whole = _whole(recording, parameters, traces)
    assert _distance(view.volume().values, whole.values) < 1e-4


def test_an_aline_measured_again_replaces_the_first_one(scan: GrowingScan, tmp_path: Path) -> None:
    view = LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS, "full")
    good = scan.counts[scan.plan.visit[0]].copy()
    scan.counts[scan.plan.visit[0]] = 30000
    scan.measure(1000)
    view.update()
    with ScanFileWriter(scan.path) as store:
        store.append([Aline(0, good, scale=scan.scale)])
    view.update()
    assert _distance(view.volume().values, _from_scratch(scan, view).values) < 1e-4


def test_a_row_that_is_being_written_is_left_for_the_next_look(scan: GrowingScan) -> None:
    scan.measure(10)
    follower = ScanTail(scan.path)
    place = int(scan.plan.visit[0])
    with scan.path.open("r+b") as file:  # half of the row has another value than its checksum says
        at = scan.path.read_bytes().index(scan.counts[place].tobytes())
        file.seek(at)
        file.write(b"\x55" * 64)
    first = follower.read_new()
    assert len(first.points) == 9
    assert place not in first.points
    with scan.path.open("r+b") as file:
        file.seek(at)
        file.write(scan.counts[place].tobytes())
    second = follower.read_new()
    assert second.points.tolist() == [place]
    np.testing.assert_allclose(second.traces[0], scan.counts[place] * scan.scale, rtol=1e-6)
    assert not len(follower.read_new().points)


def test_live_update_without_new_data_or_cancelled_keeps_last_revision(scan: GrowingScan, tmp_path: Path) -> None:
    output, asked = tmp_path / "live", []
    scan.measure(50)

    def cancelled() -> bool:
        asked.append(1)
        return (output / "revision.json").exists() and len(asked) > 40

    with pytest.raises(Cancelled):
        reconstruct_live(
            scan.path, output, PARAMETERS, is_over=lambda: False, interval=0.1, wait=lambda _: None, cancelled=cancelled
        )
    assert json.loads((output / "revision.json").read_text())["number"] == 1
    assert not (output / "volume.h5").exists()


def test_a_scan_that_ends_without_a_file_or_with_a_method_that_cannot_grow_is_refused(
    scan: GrowingScan, tmp_path: Path
) -> None:
    with pytest.raises(NotFound):
        reconstruct_live(tmp_path / "none.h5", tmp_path / "live", is_over=lambda: True)
    scan.measure(10)
    with pytest.raises(InvalidInput, match="interpolated"):
        reconstruct_live(
            scan.path, tmp_path / "live", PARAMETERS.replace(method="interpolated"), is_over=lambda: False, interval=0
        )
    with pytest.raises(InvalidInput, match="frame"):
        LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS, frame=1)


def test_without_the_scanners_word_a_scan_is_over_when_whole_or_quiet_for_long(
    scan: GrowingScan, tmp_path: Path
) -> None:
    now = [0.0]
    quiet, absent = (IdleDetector(path, 30.0, lambda: now[0]) for path in (scan.path, tmp_path / "none.h5"))
    assert not quiet()
    assert not absent()
    now[0] = 29.0
    scan.measure(10)
    assert not quiet()
    now[0] = 58.0
    assert not quiet()
    assert absent()
    now[0] = 60.0
    assert quiet()
    scan.measure(1000)
    assert quiet()


def test_preview_decimation_keeps_signal_band_and_removes_rest() -> None:
    preview = choose_preview(226, 1024, 60e-6, 11.84e-6)
    assert preview == CoarseParameters(226, 4)
    assert choose_preview(452, 1024, 30e-6, 11.84e-6).modes < 452
    times = np.arange(1024) * INTERVAL
    low, high = (np.exp(-(((times - 4e-6) / 1e-6) ** 2)) * np.sin(2 * np.pi * f * times) for f in (5e6, 30e6))
    reduced = preview.decimate(np.stack([low, high]))
    assert reduced.shape == (2, 256)
    np.testing.assert_allclose(reduced[0], low[::4], atol=1e-3)
    assert np.abs(reduced[1]).max() < 1e-3


@pytest.mark.long
def test_revisions_while_another_process_scans_1605_points(scan: GrowingScan, tmp_path: Path) -> None:
    """The paper's mask on a simulated scanner, about 4 s long; the image is small so that the test is quick."""
    scan.measure(10)
    LiveReconstruction(scan.path, tmp_path / "before", PARAMETERS).update()  # loads the compiled code
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    plan = ScanPlan.create(mask=mask, samples=SAMPLES, sound_speed=SPEED, order="progressive")
    path, seen, spawning = tmp_path / "yarn.h5", [], multiprocessing.get_context("spawn")
    revised = spawning.Value("i", 0)
    parameters = ReconstructionParameters.create(modes=56)

    def note(revision: Revision) -> None:
        seen.append(revision)
        revised.value = len(seen)

    with simulator.launch(speed=8.0) as scanner:
        how = {"control": InStep(revised), "recovery": RecoveryPolicy(within=60.0)}
        process = spawning.Process(target=run_scan, args=(plan, scanner.url, path), kwargs=how)
        process.start()
        try:
            report = reconstruct_live(
                path,
                tmp_path / "live",
                parameters,
                is_over=lambda: not process.is_alive(),
                interval=0.2,
                revised=note,
            )
        finally:
            process.join(30)
    assert process.exitcode == 0
    points = [revision.points for revision in seen]
    assert points == [*sorted(set(points[:-1])), 1605]
    assert len(points) >= 4
    assert 0 < points[0] < points[-2] <= 1605
    assert report.sensors == report.planned == 1605
    reconstruct_scan(path, tmp_path / "reference", parameters)
    values = [read_volume(tmp_path / name / "volume.h5").values for name in ("live", "reference")]
    assert _distance(*values) < 1e-4


def test_concurrent_live_read_does_not_block_scan_writer(scan: GrowingScan, tmp_path: Path) -> None:
    """A view reads while a store writes, in two threads; nothing fails, is missed or is added half."""
    view, over = LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS), threading.Event()

    def write() -> None:
        with ScanFileWriter(scan.path) as store:
            for some in np.array_split(np.arange(scan.plan.mask.count), 40):
                store.append(Aline(int(p), scan.counts[scan.plan.visit[p]], scale=scan.scale) for p in some)
        over.set()

    writer = threading.Thread(target=write)
    writer.start()
    began = time.monotonic()
    while not over.is_set() and time.monotonic() - began < 20:
        view.update()
    writer.join()
    view.update()
    assert _distance(view.volume().values, _from_scratch(scan, view).values) < 1e-4


def test_a_line_of_sensors_is_followed_too(tmp_path: Path) -> None:
    mask = equiangular_mask(4e-3, 1.2e-3, 60)
    plan = ScanPlan.create(mask=mask, samples=SAMPLES, sound_speed=SPEED)
    create_scan_file(tmp_path / "scan.h5", plan, simulated=True)
    counts = np.random.default_rng(0).integers(-1000, 1000, (mask.count, SAMPLES)).astype(np.int16)
    view = LiveReconstruction(tmp_path / "scan.h5", tmp_path / "live", PARAMETERS, "full")
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        for some in np.array_split(np.arange(mask.count), 3):
            store.append(Aline(int(p), counts[plan.visit[p]]) for p in some)
            view.update()
    recording = read_scan(tmp_path / "scan.h5")
    traces = recording.traces.astype(np.float32)
    whole = _whole(recording, PARAMETERS, traces)
    assert _distance(view.volume().values, whole.values) < 1e-4
    assert {path.name for path in (tmp_path / "live").iterdir()} == {"mip-y.png", "projections.h5", "revision.json"}


def test_a_view_that_begins_late_takes_the_alines_in_pieces(
    scan: GrowingScan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "MAX_BATCH", 32)
    scan.measure(1000)
    view = LiveReconstruction(scan.path, tmp_path / "live", PARAMETERS)
    revision = view.update()
    assert revision is not None
    assert revision.points == scan.plan.mask.count
    assert view.number == 1
    assert _distance(view.volume().values, _from_scratch(scan, view).values) < 1e-4


@pytest.mark.long
def test_the_benchmark_finds_the_grown_image_equal_to_the_one_made_at_once() -> None:
    rows = benchmark(quick=True, revisions=3)
    assert {(row["detail"], row["order"]) for row in rows} == {
        (detail, order) for detail in ("preview", "full") for order in ("progressive", "snake")
    }
    assert all(row["last_error"] < 1e-4 for row in rows)
    assert all(row["revision_s"] > 0 and row["full_s"] > 0 for row in rows)


def test_a_later_frame_of_a_scan_is_followed_by_its_number(tmp_path: Path) -> None:
    mask = equi_steradian_mask(4e-3, 1.2e-3, 60)
    plan = ScanPlan.create(mask=mask, samples=SAMPLES, sound_speed=SPEED, frames=2)
    path, count = tmp_path / "scan.h5", mask.count
    create_scan_file(path, plan, simulated=True)
    counts = np.random.default_rng(0).integers(-1000, 1000, (2 * count, SAMPLES)).astype(np.int16)
    view = LiveReconstruction(path, tmp_path / "live", PARAMETERS, "full", frame=1)
    with ScanFileWriter(path) as store:
        store.append(Aline(p, counts[p]) for p in range(count))
        assert view.update() is None
        store.append(Aline(p, counts[p]) for p in range(count, 2 * count))
    assert view.update() is not None
    recording = read_scan(path, 1)
    traces = recording.traces.astype(np.float32)
    whole = _whole(recording, PARAMETERS, traces)
    assert _distance(view.volume().values, whole.values) < 1e-4
