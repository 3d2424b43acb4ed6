"""Scans as IPASC files, judged by the consortium's own library."""

import shutil
import subprocess
from dataclasses import replace

import h5py
import numpy as np
import pytest

from steradian import ScanPlan
from steradian.core.exceptions import Cancelled, DamagedFile, InvalidInput, NotFound
from steradian.scans.exporting import export_scan
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording


@pytest.fixture
def scan(tmp_path, plan, alines):
    path = tmp_path / "scan.h5"
    create_scan_file(path, plan, scan_id="s1", scanner="SIM-1", simulated=True, time_zero=2.5e-7)
    with ScanFileWriter(path) as store:
        store.append(
            replace(aline, time_zero_offset_s=2.5e-7, fire_time_s=12.5 + 0.02 * aline.point) for aline in alines
        )
    return path


def test_a_lines_that_begin_at_different_times_come_out_at_their_times(tmp_path, plan, alines):
    """A short pulse 1.2 µs after the laser's, recorded with another time zero at each point: one closed form."""
    chance = np.random.default_rng(3)
    starts = chance.integers(0, 8000, len(alines)) * 1e-10
    times, height = np.arange(plan.samples) * plan.sampling_interval, 20_000

    def pulse(times):
        return np.exp(-(((times - 1.2e-6) / 40e-9) ** 2))

    lines = [
        replace(aline, samples=np.rint(height * pulse(start + times)).astype(np.int16), time_zero_offset_s=start)
        for aline, start in zip(alines, starts, strict=True)
    ]
    create_scan_file(tmp_path / "scan.h5", plan)
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        store.append(lines)
    again = open_recording(export_scan(tmp_path / "scan.h5", tmp_path / "out.hdf5"))
    grid = again.time_zero + np.arange(again.traces.shape[1]) * plan.sampling_interval
    assert again.time_zero == pytest.approx(starts.min(), abs=1e-15)
    truth = np.broadcast_to(0.5 * height * pulse(grid), again.traces.shape)
    np.testing.assert_allclose(again.traces, truth, atol=2)


def test_pacfish_reads_every_mandatory_tag_and_finds_them_consistent(tmp_path, scan, plan):
    """Tags, units and shapes are what the consortium's reader and consistency checker want."""
    import pacfish
    from pacfish.qualitycontrol import ConsistencyChecker

    data = pacfish.load_data(str(export_scan(scan, tmp_path / "out.hdf5")))
    acquisition, device = data.meta_data_acquisition, data.meta_data_device
    checker = ConsistencyChecker()
    assert checker.check_acquisition_meta_data(acquisition)
    assert checker.check_device_meta_data(device)
    assert checker.check_binary_data(data.binary_time_series_data)
    tags = pacfish.MetadataAcquisitionTags
    missing = [tag.tag for tag in tags.TAGS if tag.mandatory and acquisition.get(tag.tag) is None]
    device_tags = pacfish.MetadataDeviceTags
    missing += [tag.tag for tag in (device_tags.GENERAL, device_tags.DETECTORS) if tag.tag not in device]
    general = (device_tags.UNIQUE_IDENTIFIER, device_tags.FIELD_OF_VIEW)
    missing += [tag.tag for tag in general if device["general"].get(tag.tag) is None]
    assert missing == []
    assert data.get_sampling_rate() == pytest.approx(1 / plan.sampling_interval)
    assert data.get_speed_of_sound() == plan.sound_speed
    assert data.get_custom_meta_datum("custom_t0") == 2.5e-7
    assert data.get_sizes().tolist() == [plan.mask.count, plan.samples, 1, 1]
    positions = data.get_detector_position()
    np.testing.assert_array_equal(positions[:, :2], plan.mask.positions)
    np.testing.assert_array_equal(positions[:, 2], 0)
    assert len(data.get_detector_ids()) == plan.mask.count
    np.testing.assert_allclose(data.get_field_of_view()[:4], plan.mask.aperture / 2 * np.array([-1, 1, -1, 1]))


def test_export_opened_by_pacfish_lacks_only_unknown_tags(tmp_path, scan, plan):
    """Of the standard's optional tags those are there that a scan knows: gains, times, wavelengths (0: unknown)."""
    import pacfish
    from pacfish.qualitycontrol import CompletenessChecker

    data = pacfish.load_data(str(export_scan(scan, tmp_path / "out.hdf5")))
    about = data.meta_data_acquisition
    check = CompletenessChecker.check_metadatum_from_dict
    missing = {tag.tag for tag in pacfish.MetadataAcquisitionTags.TAGS if check(about, tag)[1]}
    energy, poses = "pulse_energy", "measurement_spatial_poses"
    surroundings = {"temperature_control", "acoustic_coupling_agent", "frequency_domain_filter", "regions_of_interest"}
    assert missing == {energy, poses} | surroundings
    np.testing.assert_array_equal(data.get_acquisition_wavelengths(), [0.0])  # PATATO asks for its shape
    assert about["measurements_per_image"] == plan.mask.count
    assert about["overall_gain"] == 1
    np.testing.assert_array_equal(about["measurement_timestamps"], [12.5])


def test_samples_are_in_the_pressure_unit_and_in_the_masks_order(tmp_path, scan, plan, alines):
    """Row m is the A-line of position m, counts times scale."""
    with h5py.File(export_scan(scan, tmp_path / "out.hdf5")) as file:
        series = file["binary_time_series_data"][..., 0, 0]
    np.testing.assert_array_equal(series[plan.visit], [0.5 * aline.samples.astype(np.float32) for aline in alines])


def test_export_includes_pulse_energies_and_quality_flags_and_keeps_series(tmp_path, plan, alines):
    """Whoever reads the file may divide by the one and leave out by the other."""
    wanted = plan.replace(frames=2, excitation=(7e-7, 8e-7))
    points, path = plan.mask.count, tmp_path / "frames.h5"
    create_scan_file(path, wanted)
    with ScanFileWriter(path) as store:
        for frame in range(4):
            for aline in alines:
                point = frame * points + aline.point
                store.append([replace(aline, point=point, energy=1 + frame / 8, quality=frame)])
    with h5py.File(export_scan(path, tmp_path / "out.hdf5")) as file:
        about, series = file["meta_data"], file["binary_time_series_data"]
        assert about["custom_pulse_energy"].shape == about["custom_quality_flags"].shape == (points, 2, 2)
        for frame in range(4):
            light, repeat = divmod(frame, 2)
            assert set(about["custom_pulse_energy"][:, light, repeat]) == {1 + frame / 8}
            assert set(about["custom_quality_flags"][:, light, repeat]) == {frame}
            np.testing.assert_array_equal(series[..., light, repeat], series[..., 0, 0])


def test_an_exported_scan_comes_back_as_it_was(tmp_path, scan, plan):
    """Out and in again: positions, weights, aperture, depth, times and pressures are the same."""
    import_scan(export_scan(scan, tmp_path / "out.hdf5"), tmp_path / "back.h5")
    old, new = open_recording(scan), open_recording(tmp_path / "back.h5")
    np.testing.assert_array_equal(new.traces * new.scale[:, None], old.traces * old.scale[:, None])
    np.testing.assert_array_equal(new.positions, old.positions)
    np.testing.assert_allclose(new.weights, old.weights, rtol=1e-12)
    for name in ("aperture", "depth", "sampling_interval", "sound_speed", "time_zero"):
        assert getattr(new, name) == pytest.approx(getattr(old, name), rel=1e-12)


def test_points_that_are_missing_or_torn_are_left_out(tmp_path, plan, alines):
    """A partial scan exports what it has; a row that does not match its checksum is not passed off as data."""
    create_scan_file(tmp_path / "part.h5", plan)
    with pytest.raises(DamagedFile, match="no point"):
        export_scan(tmp_path / "part.h5", tmp_path / "out.hdf5")
    with ScanFileWriter(tmp_path / "part.h5") as store:
        store.append(alines[:20])
    torn = int(plan.visit[3])
    with h5py.File(tmp_path / "part.h5", "r+") as file:
        file["alines/samples"][torn, 5] ^= 1
    with h5py.File(export_scan(tmp_path / "part.h5", tmp_path / "out.hdf5")) as file:
        assert file["binary_time_series_data"].shape[0] == len(file["meta_data_device/detectors"]) == 19
        kept = np.array([group["detector_position"][:2] for group in file["meta_data_device/detectors"].values()])
    wanted = sorted(set(plan.visit[:20].tolist()) - {torn})
    np.testing.assert_array_equal(kept, plan.mask.positions[wanted])


def test_frames_and_wavelengths_have_their_own_axes(tmp_path, plan, alines):
    """[detector, sample, wavelength, frame], with the wavelengths as a tag."""
    several = ScanPlan.create(mask=plan.mask, samples=plan.samples, frames=2, excitation=(7e-7, 8e-7, 9e-7))
    create_scan_file(tmp_path / "several.h5", several)
    rows = np.arange(several.aline_count)
    with ScanFileWriter(tmp_path / "several.h5") as store:
        for frame in range(6):
            first = alines[0]
            same = [replace(first, point=frame * plan.mask.count + m, scale=1 + frame) for m in range(plan.mask.count)]
            store.append(same, rows)
    with h5py.File(export_scan(tmp_path / "several.h5", tmp_path / "out.hdf5")) as file:
        series = file["binary_time_series_data"]
        assert series.shape == (plan.mask.count, plan.samples, 3, 2)
        np.testing.assert_allclose(file["meta_data/acquisition_wavelengths"], [7e-7, 8e-7, 9e-7])
        ratio = series[4, 9] / np.float32(alines[0].samples[9])
    np.testing.assert_allclose(ratio, [[1, 2], [3, 4], [5, 6]])


def test_octave_reads_a_scan_and_its_ipasc_file(tmp_path, scan, plan, alines):
    """Both load as numbers, axes reversed: sample 8 of the sixth A-line and its position come out the same."""
    program = shutil.which("octave")
    if program is None:
        pytest.skip("needs Octave: apt-get install octave (or dnf, brew install octave)")
    export_scan(scan, tmp_path / "out.hdf5")
    code = """
        s = load('-hdf5', 'scan.h5'); i = load('-hdf5', 'out.hdf5');
        detectors = i.meta_data_device.detectors; names = fieldnames(detectors);
        printf('%.17g ', s.alines.samples(8, 6), s.alines.scale(6), s.mask.positions(:, 6), size(s.alines.samples));
        place = detectors.(names{6}).detector_position;
        printf('%.17g ', i.binary_time_series_data(1, 1, 8, 6), place(1:2), numel(names));
    """
    command = [program, "--no-gui", "--quiet", "--eval", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = np.array(done.stdout.split(), float)
    count = float(alines[int(np.flatnonzero(plan.visit == 5)[0])].samples[7])
    where = plan.mask.positions[5]
    np.testing.assert_allclose(told[:6], [count, 0.5, *where, plan.samples, plan.mask.count], rtol=1e-12)
    np.testing.assert_allclose(told[6:], [0.5 * count, *where, plan.mask.count], rtol=1e-12)


def test_progress_stop_and_refusals(tmp_path, scan, plan):
    """Every detector and A-line is counted; a stop leaves nothing; what is no scan or format is refused by name."""
    seen = []
    export_scan(scan, tmp_path / "out.hdf5", progress=lambda *told: seen.append(told))
    assert {stage for stage, _, _ in seen} == {"checked A-lines", "A-lines", "detectors"}
    assert seen[-1] == ("detectors", plan.mask.count, plan.mask.count)
    for allowed in (0, 2, 4):
        answers = iter([False] * allowed + [True])
        with pytest.raises(Cancelled):
            export_scan(scan, tmp_path / "stopped.hdf5", cancelled=lambda answers=answers: next(answers))
    with pytest.raises(InvalidInput, match="ipasc"):
        export_scan(scan, tmp_path / "stopped.hdf5", format="dicom")
    with pytest.raises(NotFound):
        export_scan(tmp_path / "none.h5", tmp_path / "stopped.hdf5")
    with pytest.raises(DamagedFile, match="expected 'steradian-scan'"):
        export_scan(tmp_path / "out.hdf5", tmp_path / "stopped.hdf5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.hdf5", "scan.h5"]
