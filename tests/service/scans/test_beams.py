"""Scans with several beams: every A-line in the row of its point, whole places again, foreign files checked."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from scripted import QUIET, Script, samples

from fabry_perot.simulator import launch, phantoms
from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.masks import equi_steradian_mask, multi_beam_mask
from steradian.masks.multi_beam import read_beams
from steradian.plans import ScanPlan
from steradian.scans.acquisition.run import resume_scan, run_scan
from steradian.scans.acquisition.session_control import Command, SessionOutcome
from steradian.scans.file.create import geometry_checksum
from steradian.scans.file.read import read_scan
from steradian.scans.importing import import_scan

BEAMS = read_beams("3x2", 0.7e-3)


@pytest.fixture(scope="module")
def plan():
    mask = multi_beam_mask(equi_steradian_mask(13.56e-3, 3.6e-3, 90), BEAMS)
    return ScanPlan.create(mask=mask, beams=BEAMS, samples=512, pulse_rate=100.0)


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=5.0, beams="3x2", beam_spacing=0.7e-3, **QUIET) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def whole(simulator, plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "scan.h5"
    return run_scan(plan, simulator.url, path), path


@pytest.mark.long
def test_each_row_is_the_pressure_at_its_own_point_and_a_places_rows_share_their_shot(plan, whole):
    """Closed form at the mask's points, whatever the order of visit."""
    summary, path = whole
    assert (summary.stored, summary.fired) == (plan.mask.count, plan.mask.count // 6)
    recording = read_scan(path)
    assert recording.provenance["beams"] == "6"
    where = np.rint(plan.mask.positions * 1e9) * 1e-9
    true = phantoms.pressure(phantoms.yarn(0), where, np.arange(512) * 8e-9, 1500.0)
    scale = np.asarray(recording.scale)[:, None]
    np.testing.assert_array_equal(recording.traces, np.rint(true.astype(np.float64) / scale))
    with h5py.File(path) as file:
        assert file["alines/energy"].attrs["nominal_j"] == pytest.approx(20e-3)
        shots, beam = file["alines/shot"][:].reshape(-1, 6), file["plan/beam"][:]
        np.testing.assert_allclose(file["plan/beams"], BEAMS, atol=1e-15)
    assert (shots == shots[:, :1]).all()
    assert np.unique(shots).size == len(shots)
    assert (beam.reshape(-1, 6) == np.arange(6)).all()


def test_a_scan_that_was_stopped_goes_on_with_whole_places_and_ends_the_same(plan, simulator, whole, tmp_path):
    path = tmp_path / "scan.h5"
    before = run_scan(plan, simulator.url, path, control=Script((20, Command.STOP)))
    assert before.end is SessionOutcome.STOPPED
    assert before.stored == 6 * before.fired < plan.mask.count
    with h5py.File(path, "r+") as file:  # the row of one beam is lost
        lost = int(np.flatnonzero(file["alines/status"][:])[8])
        file["alines/status"][lost], file["alines/crc32c"][lost] = 0, 1
    after = resume_scan(path, simulator.url, plan=plan)
    places = (plan.mask.count - before.stored) // 6 + 1
    assert (after.end, after.fired) == (SessionOutcome.COMPLETE, before.fired + places + 16), (
        "and the reference, by one beam"
    )
    np.testing.assert_array_equal(samples(path), samples(whole[1]))


@pytest.mark.long
def test_scan_with_mismatched_beams_is_refused_before_file_is_created(plan, tmp_path):
    path = tmp_path / "scan.h5"
    for settings, match in (({"beams": "3x2", "beam_spacing": 0.6e-3}, r"beams\[2\]"), ({}, "at most 1")):
        with launch(repeat=1, **settings) as other, pytest.raises(InvalidInput, match=match):
            run_scan(plan, other.url, path)
    assert not path.exists()


def test_an_own_file_is_taken_over_with_its_beams(whole, tmp_path):
    import_scan(whole[1], tmp_path / "copy.h5")
    with h5py.File(whole[1]) as one, h5py.File(tmp_path / "copy.h5") as other:
        for name in ("plan/beams", "plan/beam", "plan/visit", "alines/samples"):
            np.testing.assert_array_equal(one[name], other[name])
        assert one["alines/energy"].attrs["nominal_j"] == other["alines/energy"].attrs["nominal_j"]


@pytest.mark.parametrize(("name", "match"), [("plan/visit", "apart"), ("plan/beams", "differs from the plan")])
def test_a_strangers_file_that_takes_places_apart_is_refused(whole, tmp_path, name, match):
    path = tmp_path / "scan.h5"
    path.write_bytes(whole[1].read_bytes())
    with h5py.File(path, "r+") as file:
        values = file[name][:]
        first, second = (1, 7) if name == "plan/visit" else (1, 2)
        values[[first, second]] = values[[second, first]]
        file[name][:] = values
        file.attrs["geometry_crc32c"] = geometry_checksum(file)
    with pytest.raises(DamagedFile, match=match):
        import_scan(path, tmp_path / "copy.h5")
