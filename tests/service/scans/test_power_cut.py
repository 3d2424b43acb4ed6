"""The power fails between any two writes, and the disk has taken only some sectors of what was not synchronised."""

import dataclasses
import random
import shutil

import h5py
import numpy as np
import pytest

from steradian.scans.file import writer as storing
from steradian.scans.file.read import read_scan
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file

SECTOR = 512
CUTS = 120
SUBSETS = 400


class Disk:
    """Knows what of a file is on the disk for sure, and which writes since may be there or not, sector by sector."""

    def __init__(self, path, monkeypatch):
        self.path = path
        self.durable = bytearray(path.read_bytes())
        self.pending, self.moments, self.acknowledged = [], [], 0
        overwrite, sync = ScanFileWriter._overwrite, storing.sync_data

        def note(store, offset, data):
            overwrite(store, offset, data)
            self.pending.append((offset, bytes(data)))
            self.moment()

        def synchronise(handle):
            sync(handle)
            for offset, data in self.pending:
                self.durable[offset : offset + len(data)] = data
            self.pending.clear()
            self.moment()

        monkeypatch.setattr(ScanFileWriter, "_overwrite", note)
        monkeypatch.setattr(storing, "sync_data", synchronise)

    def moment(self):
        self.moments.append((bytes(self.durable), list(self.pending), self.acknowledged))

    @staticmethod
    def after_a_cut(moment, chance):
        """What is found when the power comes back."""
        image, pending, _ = moment
        image = bytearray(image)
        for offset, data in pending:
            at = offset
            while at < offset + len(data):
                end = min(at - at % SECTOR + SECTOR, offset + len(data))
                if chance.random() < 0.5:
                    image[at:end] = data[at - offset : end - offset]
                at = end
        return image


@pytest.fixture
def alines(alines):
    """What goes with each A-line is its own."""
    chance = np.random.default_rng(2)
    return [
        dataclasses.replace(
            aline,
            scale=chance.uniform(0.1, 0.9),
            energy=chance.uniform(0.8, 1.2),
            wavelength_m=chance.uniform(1.54e-6, 1.56e-6),
            fire_time_s=chance.uniform(0, 100),
            quality=int(chance.integers(16)),
            averages=int(chance.integers(1, 9)),
            time_zero_offset_s=chance.uniform(-1e-6, 1e-5),
            dc_v=chance.uniform(0, 2),
            gain_db=chance.uniform(-6, 6),
        )
        for aline in alines
    ]


@pytest.fixture
def disk_after_scan(tmp_path, plan, alines, monkeypatch):
    path = tmp_path / "scan.h5"
    create_scan_file(path, plan)
    disk = Disk(path, monkeypatch)
    with ScanFileWriter(path) as store:
        for first in range(0, len(alines), 5):
            store.append(alines[first : first + 5])
            disk.acknowledged = first + 5
            store.record_shot_count(disk.acknowledged)
    monkeypatch.undo()
    return disk


@pytest.mark.long
def test_acknowledged_alines_survive_power_cut(disk_after_scan, plan, alines, tmp_path):
    """… what is called stored is what was measured, and the rest of the scan fits into the same file."""
    chance = random.Random(5)
    truth = np.empty((plan.mask.count, plan.samples), np.int16)
    truth[plan.visit] = [aline.samples for aline in alines]
    path = tmp_path / "after.h5"
    for moment in chance.sample(disk_after_scan.moments, CUTS):
        path.write_bytes(Disk.after_a_cut(moment, chance))
        acknowledged = plan.visit[: moment[2]]
        unrepaired = read_scan(path) if moment[2] else None
        report = verify_scan_file(path)
        with ScanFileWriter(path) as store:
            stored = ~store.missing
            assert stored[acknowledged].all()
            for row in np.flatnonzero(stored):
                np.testing.assert_array_equal(store.read_row(row), truth[row])
            if unrepaired is not None:
                assert len(acknowledged) <= len(unrepaired.traces) <= report.intact
            missing = store.missing[plan.visit]
            store.append(alines[point] for point in np.flatnonzero(missing))
        np.testing.assert_array_equal(read_scan(path).traces, truth)


@pytest.mark.long
def test_stored_alines_after_power_cut_have_their_samples_and_columns(disk_after_scan, plan, alines, tmp_path):
    """Any subset of the sectors that were not synchronised may be there; then the check, which may list more rows."""
    accepted = cut_and_compare(disk_after_scan, plan, alines, tmp_path, SUBSETS, random.Random(8))
    assert accepted > 10 * SUBSETS


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_ten_thousand_power_cuts(disk_after_scan, plan, alines, tmp_path):
    cut_and_compare(disk_after_scan, plan, alines, tmp_path, 10_000, random.Random(9))


def cut_and_compare(disk, plan, alines, tmp_path, subsets, chance):
    """Count the rows accepted after so many cuts; those with a wrong sample or column fail."""
    path, by_row = tmp_path / "after.h5", [alines[point] for point in np.argsort(plan.visit)]
    shutil.copy(disk.path, path)
    names = {"time_zero_s": "time_zero_offset_s"}
    with h5py.File(path, "r") as file:
        columns = {name: data.dtype for name, data in file["alines"].items() if name not in ("crc32c", "status")}
    truth = {
        name: np.array([getattr(aline, names.get(name, name)) for aline in by_row]).astype(kind)
        for name, kind in columns.items()
    }
    accepted, wrong = 0, dict.fromkeys(columns, 0)
    for _ in range(subsets):
        path.write_bytes(Disk.after_a_cut(chance.choice(disk.moments), chance))
        verify_scan_file(path)
        with h5py.File(path, "r") as file:
            stored = np.flatnonzero(file["alines/status"][:])
            for name, values in truth.items():
                differs = file["alines"][name][:][stored] != values[stored]
                wrong[name] += int((differs.any(axis=1) if differs.ndim > 1 else differs).sum())
        accepted += len(stored)
    assert not any(wrong.values()), f"wrong rows of {accepted} in {subsets} cuts: {wrong}"
    return accepted


@pytest.mark.long
def test_a_cut_between_writes_can_damage_an_aline_and_the_check_sees_it(disk_after_scan, plan, tmp_path):
    """The simulation is worth its name: some cuts leave torn A-lines, which are told from whole ones."""
    chance, torn = random.Random(6), 0
    path = tmp_path / "after.h5"
    for moment in chance.choices(disk_after_scan.moments, k=400):
        path.write_bytes(Disk.after_a_cut(moment, chance))
        report = verify_scan_file(path)
        torn += len(report.damaged)
        assert verify_scan_file(path).is_consistent
    assert torn


def test_upload_record_after_power_cut_is_intact_or_absent(tmp_path, plan, monkeypatch):
    path = tmp_path / "scan.h5"
    create_scan_file(path, plan)
    disk, chance = Disk(path, monkeypatch), random.Random(7)
    uploads = [storing.UploadRecord(plan.visit[: 10 + number].copy(), 77 + number, number, 1000) for number in range(6)]
    with ScanFileWriter(path) as store:
        for upload in uploads:
            store.record_upload(upload)
    monkeypatch.undo()
    known = {upload.tag: upload.rows.tolist() for upload in uploads}
    seen = set()
    for moment in disk.moments * 4:
        shutil.copy(path, tmp_path / "after.h5")
        (tmp_path / "after.h5").write_bytes(Disk.after_a_cut(moment, chance))
        with ScanFileWriter(tmp_path / "after.h5") as store:
            last = store.last_upload()
            seen.add(last and last.tag)
            assert last is None or last.rows.tolist() == known[last.tag]
    assert len(seen) > 3
