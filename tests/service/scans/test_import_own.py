"""Scan files of our own from strangers: written anew from what is proven in them, nothing else."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from steradian import ScanPlan, equi_steradian_mask
from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.reconstructions.scan_plan_reader import read_stored_plan
from steradian.scans.file import schema
from steradian.scans.file.create import geometry_checksum
from steradian.scans.file.measurement_order import ScanProgram
from steradian.scans.file.read import read_scan
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, UploadRecord, create_scan_file
from steradian.scans.importing import import_scan

SECRET = b"root:x:0:0:a line of a file of the server's:"


@pytest.fixture
def own(tmp_path, plan, alines):
    path = tmp_path / "own.h5"
    create_scan_file(path, plan, scan_id="s1", scanner="SIM-1", scanner_model="M", simulated=True, time_zero=2.5e-7)
    with ScanFileWriter(path) as store:
        store.append(alines[:20])
        store.record_shot_count(27)
        store.set_reference(3, 1.55e-6, 0.2, 0.7)
        store.record_upload(UploadRecord(np.arange(5, 30), 77, 27, 1234))
    return path


def _external(name, kind, shape):
    """Datasets whose bytes lie in a file of the server's."""

    def poison(file, shape=shape):
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        shape = file["plan/visit"].shape if shape is None else shape
        size = int(np.prod(shape)) * np.dtype(kind).itemsize
        made.set_external(b"secret", 0, size)
        space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
        if name in file:
            del file[name]
        group, _, last = name.rpartition("/")
        h5py.h5d.create(file[group or "/"].id, last.encode(), h5py.h5t.py_create(np.dtype(kind)), space, made)

    return poison


@pytest.mark.parametrize(
    ("name", "kind", "shape"),
    [
        ("fired", "i8", ()),
        ("run/queue", "i8", None),
        ("run/upload", "i8", (5,)),
        ("run/reference", "f8", (4,)),
        ("plan/wavelengths", "f8", None),
        ("plan/bias", "f8", None),
        ("plan/frame_excitation", "f8", (1,)),
        ("plan/visit", "i8", None),
        ("alines/shot", "u4", None),
    ],
)
def test_no_dataset_may_lie_in_a_file_of_the_server(tmp_path, own, monkeypatch, name, kind, shape):
    """External storage is no link: what it names must not come back as a count of shots, or as anything."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret").write_bytes(SECRET * 100)
    with h5py.File(own, "r+") as file:
        _external(name, kind, shape)(file)
    with pytest.raises(DamagedFile, match=f"{name} keeps its data in another file"):
        import_scan(own, tmp_path / "new" / "scan.h5")
    assert list((tmp_path / "new").iterdir()) == []


def attribute(place, name, value):
    def poison(file):
        file[place].attrs[name] = value

    return poison


def value(place, index, new):
    def poison(file):
        file[place][index] = new

    return poison


def unknown_dataset(file):
    file["plan/more"] = np.zeros(3)


def unknown_group(file):
    file.create_group("alines/deeper")


def dataset_for_a_group(file):
    del file["run"]
    file["run"] = np.zeros(3)


def points_of_interest(file):
    file["mask"].attrs["arrangement"] = json.dumps({"points_of_interest": [{"offset": "here"}]})


def _moved(weights):
    """As much is added to one weight as is taken from another."""
    values = weights[()]
    values[:2] += np.array([1e-9, -1e-9])
    weights[...] = values


REFUSED = {
    "an unknown dataset": (unknown_dataset, "plan/more is unknown"),
    "an unknown group": (unknown_group, "alines/deeper is unknown"),
    "a dataset for a group": (dataset_for_a_group, "run is unknown"),
    "a newer version": (attribute("/", "schema_version", 99), "schema_version is 99; allowed: 1"),
    "no version": (lambda file: file.attrs.__delitem__("schema_version"), "schema_version is None; allowed: 1"),
    "a version that is not a number": (attribute("/", "schema_version", np.zeros((2, 2))), "shape"),
    "no record of uploads": (lambda file: file.__delitem__("run/upload"), "run/upload"),
    "no document of the plan": (lambda file: file["plan"].attrs.__delitem__("document"), "no document in JSON"),
    "no checksum of the geometry": (lambda file: file.attrs.__delitem__("geometry_crc32c"), "match their checksum"),
    "an order that visits a point twice": (value("plan/visit", 0, 5), r"each of \d+ points once"),
    "an order beyond the points": (value("plan/visit", 0, 1000), r"each of \d+ points once"),
    "a position that is none": (value("mask/positions", (3, 0), np.nan), "positions"),
    "a position outside": (value("mask/positions", (3, 0), 1.0), "within the aperture"),
    "a weight below zero": (value("mask/weights", 3, -1e-6), "weights"),
    "an endless aperture": (attribute("mask", "aperture_m", np.inf), "aperture_m"),
    "no arrangement": (attribute("mask", "arrangement", "[1, 2"), "JSON"),
    "an arrangement that is not a number": (attribute("mask", "arrangement", '{"a": NaN}'), "NaN is not a number"),
    "an arrangement without end": (attribute("mask", "arrangement", "[" * 100_000), "JSON"),
    "points of interest that are none": (points_of_interest, "points of interest"),
    "two sampling intervals": (attribute("plan", "sampling_interval_s", 1e-8), "sampling_interval"),
    "two numbers of samples": (attribute("plan", "samples", 255), "samples"),
    "a document of another plan": (attribute("plan", "document", '{"samples": 255}'), "samples"),
    "a document of no plan": (attribute("plan", "document", '{"sample": 255}'), "only the fields"),
    "a time zero that is none": (attribute("plan", "time_zero_s", np.nan), "time_zero_s"),
    "a time zero of hours": (attribute("plan", "time_zero_s", 3600.0), "time_zero_s"),
    "light that the plan does not know": (value("plan/frame_excitation", 0, 7e-7), "frame_excitation"),
    "a state that is none": (value("alines/status", 3, 7), "status"),
    "shots that nobody can fire": (value("fired", (), -5), "fired"),
    "a weight moved by a bit": (lambda file: _moved(file["mask/weights"]), "checksum"),
    "a reference beyond the points": (value("run/reference", 0, 1e9), "run/reference"),
    "a reference that is none": (value("run/reference", 2, np.nan), "run/reference"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_import_of_invalid_scan_file_is_refused_without_leftovers(tmp_path, own, what):
    """Unknown objects, contradictions and values out of range: named, and nothing is left behind."""
    poison, words = REFUSED[what]
    with h5py.File(own, "r+") as file:
        poison(file)
    with pytest.raises((DamagedFile, InvalidInput), match=words) as refusal:
        import_scan(own, tmp_path / "new" / "scan.h5")
    assert str(tmp_path) not in str(refusal.value)
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize(
    "said", [{"scale": np.inf}, {"scale": -1.0}, {"energy": np.nan}, {"wavelength_m": -1e-6}, {"fire_time_s": np.inf}]
)
def test_import_of_row_with_invalid_column_value_is_refused(tmp_path, plan, alines, said):
    """A row may be whole by its checksum and nonsense all the same."""
    create_scan_file(tmp_path / "own.h5", plan)
    with ScanFileWriter(tmp_path / "own.h5") as store:
        store.append([*alines[:5], replace(alines[5], **said)])
    (name,) = said
    row = int(plan.visit[5])
    with pytest.raises(InvalidInput, match=rf"alines/{name}\[{row}\]"):
        import_scan(tmp_path / "own.h5", tmp_path / "scan.h5")


def test_a_sample_too_large_to_use_is_refused(tmp_path, plan, alines):
    """Finite in float32, whole by its checksum, and its square is infinite."""
    create_scan_file(tmp_path / "own.h5", plan, sample_kind=schema.EXACT_SAMPLES)
    with ScanFileWriter(tmp_path / "own.h5") as store:
        store.append([replace(alines[0], samples=np.full(plan.samples, 2.5e38, np.float32), scale=1.0)])
    with pytest.raises(InvalidInput, match="finite numbers, at most 1e"):
        import_scan(tmp_path / "own.h5", tmp_path / "scan.h5")


def test_all_that_was_measured_comes_back_and_can_be_continued(tmp_path, own, plan, alines):
    """A-lines, columns, plan, provenance and what a resumed scan needs are those of the file."""
    new = tmp_path / "new.h5"
    import_scan(own, new)
    then, now = read_scan(own), read_scan(new)
    for name in ("traces", "scale", "positions", "weights"):
        np.testing.assert_array_equal(getattr(now, name), getattr(then, name))
    for name in ("sampling_interval", "sound_speed", "aperture", "time_zero", "depth", "planned", "provenance"):
        assert getattr(now, name) == getattr(then, name)
    assert read_stored_plan(new).plan.id == plan.id
    assert verify_scan_file(new).is_consistent
    with h5py.File(own) as old, h5py.File(new) as made:
        assert made.attrs["created"] == old.attrs["created"]
    with ScanFileWriter(own) as old, ScanFileWriter(new) as made:
        assert (made.fired, made.reference(), made.stored) == (27, (3, 1.55e-6, 0.2, 0.7), 20)
        np.testing.assert_array_equal(made.last_upload().rows, np.arange(5, 30))
        assert (made.last_upload().tag, made.last_upload().laser_shots) == (77, 1234)
        for name in schema.COLUMNS:
            np.testing.assert_array_equal(made.column(name), old.column(name))
        made.append(alines[20:])
    assert len(read_scan(new).traces) == len(alines)


def test_import_keeps_bias_wavelengths_of_file(tmp_path, plan, alines):
    """Whatever this program would choose."""
    best = np.linspace(1.549e-6, 1.551e-6, plan.mask.count)
    create_scan_file(tmp_path / "own.h5", plan.replace(wavelengths=best, max_sensitivity_loss=0.2))
    with ScanFileWriter(tmp_path / "own.h5") as store:
        store.append(alines[:20])
    with h5py.File(tmp_path / "own.h5", "r+") as file:
        was = file["plan/bias"][...] = file["plan/bias"][()] + 3e-12
        file.attrs["geometry_crc32c"] = geometry_checksum(file)
    import_scan(tmp_path / "own.h5", tmp_path / "new.h5")
    assert verify_scan_file(tmp_path / "new.h5").is_consistent
    with h5py.File(tmp_path / "new.h5") as file:
        np.testing.assert_array_equal(ScanProgram.of_file(file).wavelengths, was)
        np.testing.assert_array_equal(file["plan/wavelengths"], best)


@pytest.mark.parametrize("bias", [np.full(5, 1.55e-6), np.nan, -1.55e-6, b"x"])
def test_import_with_invalid_bias_wavelengths_is_refused(tmp_path, own, plan, bias):
    with h5py.File(own, "r+") as file:
        file["plan/wavelengths"] = np.full(plan.mask.count, 1.55e-6)
        file["plan/bias"] = np.full(plan.mask.count, bias) if np.ndim(bias) == 0 else bias
        del file.attrs["geometry_crc32c"]
    with pytest.raises((DamagedFile, InvalidInput), match="plan/bias"):
        import_scan(own, tmp_path / "scan.h5")


def test_a_file_of_several_pieces_comes_whole(tmp_path, own, monkeypatch):
    """Pieces far smaller than the file: every A-line arrives in its row."""
    monkeypatch.setattr("steradian.scans.importing.scan_writer._PIECE", 1 << 11)
    import_scan(own, tmp_path / "new.h5")
    np.testing.assert_array_equal(read_scan(tmp_path / "new.h5").traces, read_scan(own).traces)


def test_columns_in_chunks_come_out_in_their_places(tmp_path, own, alines):
    """A file that another program rewrote in compressed chunks is a scan that can be continued once it is imported."""
    with h5py.File(own) as old, h5py.File(tmp_path / "packed.h5", "w") as packed:
        old.copy("mask", packed), old.copy("plan", packed), old.copy("run", packed), old.copy("fired", packed)
        packed.attrs.update(old.attrs)
        for name, column in old["alines"].items():
            rows = tuple(min(side, 16) for side in column.shape)
            packed.create_dataset(f"alines/{name}", data=column[()], chunks=rows, compression="gzip")
    import_scan(tmp_path / "packed.h5", tmp_path / "scan.h5")
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        store.append(alines[20:])
    assert verify_scan_file(tmp_path / "scan.h5").intact == len(alines)


def test_import_of_mask_with_offset_keeps_mask_id(tmp_path):
    """The offset of the point of interest is part of what a mask is."""
    plan = ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60, offset=(1e-3, -2e-3)), samples=64)
    create_scan_file(tmp_path / "own.h5", plan)
    import_scan(tmp_path / "own.h5", tmp_path / "scan.h5")
    assert read_stored_plan(tmp_path / "scan.h5").plan.mask.id == plan.mask.id


def test_import_strips_control_characters_from_scanner_name(tmp_path, own):
    """A scanner's name is shown in terminals and pages."""
    with h5py.File(own, "r+") as file:
        file.attrs["scanner"] = "SIM\x1b[2J-1\n"
    import_scan(own, tmp_path / "scan.h5")
    assert read_scan(tmp_path / "scan.h5").provenance["scanner"] == "SIM[2J-1"
