"""Each kind of job does what it is asked, in the program that workers start, on real files and a real database."""

import json
import os
import zipfile

import h5py
import numpy as np
import pytest

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.worker.child import run_job
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.alines import Aline

SPEED, SIDE, SAMPLES = 1500.0, 8, 64


class Place:
    """A data directory with one complete scan of an 8 × 8 grid that saw a small ball 1.2 mm deep."""

    def __init__(self, folder):
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        self.mask = grid_mask(2e-3, SIDE, 0.25e-3)
        self.sparse = grid_mask(2e-3, SIDE // 2, 0.5e-3)
        self.plan = ScanPlan.create(mask=self.mask, samples=SAMPLES, sampling_interval=25e-9, sound_speed=SPEED)
        for mask in (self.mask, self.sparse):
            MaskRepository(self.database).put(mask)
        row, _ = PlanRepository(self.database).put(self.plan)
        self.scans = ScanRepository(self.database)
        self.scan = self.scans.queue(row, simulated=True).id
        self.measure(self.data.scan_file(self.scan), self.plan)
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            self.scans.transition(self.scan, state, why="test", summary={"points": 64, "stored": 64, "fired": 64})
        self.done = 0

    def measure(self, path, plan):
        create_scan_file(path, plan, scan_id=path.stem, simulated=True)
        times = np.arange(SAMPLES) * plan.sampling_interval
        with ScanFileWriter(path) as store:
            store.append(
                Aline(point, self._wave(plan.mask.positions[index], times), point + 1)
                for point, index in enumerate(plan.visit)
            )
            store.record_shot_count(plan.mask.count)

    def _wave(self, position, times):
        distance = np.hypot(np.hypot(*position), 1.2e-3)
        ahead = distance - SPEED * times
        wave = ahead / distance * np.exp(-(ahead**2) / (2 * 60e-6**2))
        return np.round(2e4 * wave / np.abs(wave).max()).astype(np.int16)

    def do(self, kind, *, name=None, **request):
        """Run a job; returns its identifier and its report."""
        self.done += 1
        name = name or f"j{self.done}"
        about = {"kind": kind, "request": request, "principal": "ada", "start": 1}
        where = {"job": str(self.data.job(name).root), "data": str(self.data.root.absolute())}
        return name, run_job(about | where, lambda *_: None, kept=[])

    def reconstruct(self, **parameters):
        return self.do("reconstruction", scan_id=self.scan, parameters={"modes": 16} | parameters)

    def upload(self, content, name="u1"):
        self.data.upload(name).write_bytes(content)
        return name


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STERADIAN_DATA", str(folder))
        place = Place(folder)
        yield place
        place.database.close()


def test_a_reconstruction_leaves_volume_projections_and_report(place):
    name, report = place.reconstruct()
    folder = place.data.job(name).root
    assert {"volume.h5", "mip-x.png", "mip-y.png", "mip-z.png", "report.json"} <= {p.name for p in folder.iterdir()}
    volume = read_volume(folder / "volume.h5")
    assert volume.values.shape == tuple(report["shape"]) == (16, 16, SAMPLES)
    brightest = np.unravel_index(volume.values.argmax(), volume.values.shape)
    found = [volume.coordinates(axis)[place] for axis, place in zip("xyz", brightest, strict=True)]
    np.testing.assert_allclose(found, [0, 0, 1.2e-3], atol=0.13e-3)
    with h5py.File(folder / "volume.h5") as file:
        for axis in "xyz":
            np.testing.assert_array_equal(file[f"mip_{axis}"], volume.mip(axis))


def test_subset_comparison_job_writes_volume_and_correlation(place):
    through = {"mask_id": place.sparse.id, "points": "exact"}
    name, report = place.do("what-if", scan_id=place.scan, through=through, parameters={"modes": 16})
    assert report["sensors"] == place.sparse.count
    assert report["what_if"]["used"] == place.sparse.count
    assert 0 < report["what_if"]["quality"]["volume_correlation"] < 1
    assert read_volume(place.data.job(name).volume).values.shape == (16, 16, SAMPLES)
    assert "what-if.json" in report["files"]


@pytest.mark.long
def test_a_sweep_of_masks_costs_one_reconstruction_more_than_it_has_masks(place, monkeypatch):
    from steradian.reconstructions.pipeline import run as job
    from steradian.reconstructions.studies import what_if

    prepare, sensors = job.prepare, []

    def counted(recording, *args, **how):
        sensors.append(len(recording.positions))
        return prepare(recording, *args, **how)

    monkeypatch.setattr(job, "prepare", counted)
    old = place.data.reference("of-another-scan")  # on a worker's host, where no service looks through the folder
    old.write_bytes(b"image")
    os.utime(old, (0, 0))
    parameters, reports = {"modes": 12}, []
    for mask in (place.sparse, place.mask, place.sparse):
        through = {"mask_id": mask.id, "points": "exact"}
        reports.append(place.do("what-if", scan_id=place.scan, through=through, parameters=parameters)[1])
    assert sorted(sensors) == [16, 16, 64, 64], "each mask once, and all A-lines once"
    assert not old.exists()
    chosen = ReconstructionParameters.create(**parameters)
    alone = what_if.compare_subset(place.data.scan_file(place.scan), place.sparse, place.data.root / "alone", chosen)
    for report in reports[::2]:
        for name, value in alone.quality.items():
            assert report["what_if"]["quality"][name] == pytest.approx(value, abs=1e-5), name
    assert reports[1]["what_if"]["quality"]["volume_correlation"] == pytest.approx(1)


def test_layers_of_one_speed_in_a_job_give_the_image_of_that_speed(place):
    layers = [{"sound_speed": SPEED, "thickness": 0.7e-3}, {"sound_speed": SPEED}]
    (one, _), (other, report) = place.reconstruct(), place.reconstruct(medium=layers)
    assert [layer["thickness"] for layer in report["parameters"]["medium"]] == [0.7e-3, None]
    values, expected = (read_volume(place.data.job(name).root / "volume.h5").values for name in (other, one))
    assert values.argmax() == expected.argmax()
    assert np.abs(values - expected).max() < 0.03 * np.abs(expected).max()  # the record's end folds back elsewhere


def test_subset_job_has_layers_and_notes_their_critical_angle(place):
    through, layers = {"mask_id": place.sparse.id, "points": "exact"}, [{"sound_speed": 1700, "thickness": 4e-4}, {}]
    _, report = place.do("what-if", scan_id=place.scan, through=through, parameters={"modes": 16, "medium": layers})
    assert report["parameters"]["medium"][1]["sound_speed"] == SPEED
    assert any("does not reach the film" in note for note in report["notes"])


def test_quality_of_an_image_against_itself_is_perfect_and_against_a_worse_one_is_not(place):
    (one, _), (other, _) = place.reconstruct(), place.reconstruct(sound_speed=1350.0)
    _, same = place.do("quality", reconstruction_id=one, reference_id=one, diameter=None, threshold=0.04)
    assert same["figures"]["volume_correlation"] == pytest.approx(1)
    assert same["figures"]["volume_error"] == pytest.approx(0, abs=1e-6)
    with pytest.raises(InvalidInput, match="reference"):
        place.do("quality", reconstruction_id=one, reference_id=other, diameter=None, threshold=0.04)


@pytest.mark.parametrize(
    ("format", "begins"), [("hdf5", b"\x89HDF"), ("nrrd", b"NRRD"), ("png", b"PK\x03\x04"), ("vtkhdf", b"\x89HDF")]
)
def test_a_volume_is_exported_as_one_file(place, format, begins):
    one, _ = place.reconstruct()
    name, report = place.do("export", reconstruction_id=one, format=format)
    (left,) = report["files"]
    path = place.data.job(name).root / left
    assert path.read_bytes().startswith(begins)
    assert path.stat().st_size == report["bytes"]
    if begins == b"PK\x03\x04":
        with zipfile.ZipFile(path) as archive:
            assert sum(member.endswith(".png") for member in archive.namelist()) == 3


@pytest.mark.long
def test_a_scan_that_was_exported_comes_back_by_import_with_the_same_alines(place):
    name, report = place.do("export", scan_id=place.scan, format="ipasc")
    upload = place.upload((place.data.job(name).root / report["files"][0]).read_bytes())
    for _ in range(2):  # a job may be started again after it had all but finished
        _, found = place.do("import", name="jimported", upload_id=upload, labels={"from": "ipasc"})
    assert found["scan_id"] == "simported"
    row = place.scans.get("simported")
    assert (row.state, row.labels, row.simulated) == (ScanState.COMPLETE, {"from": "ipasc"}, True)
    assert row.history[0]["who"] == "ada"
    assert (found["points"], found["stored"]) == (64, 64)
    assert PlanRepository(place.database).get(row.plan_id).parameters["samples"] == SAMPLES
    assert not place.data.upload(upload).exists()
    with h5py.File(place.data.scan_file("simported")) as made, h5py.File(place.data.scan_file(place.scan)) as own:
        counts = [file["alines/samples"][:] * file["alines/scale"][:][:, None] for file in (made, own)]
        np.testing.assert_allclose(np.sort(counts[0], axis=0), np.sort(counts[1], axis=0), rtol=1e-6)


@pytest.mark.long
def test_text_is_imported_with_a_description_and_a_file_of_positions(place):
    rows = "\n".join(",".join(str(int(v)) for v in place._wave(p, np.arange(64) * 25e-9)) for p in place.mask.positions)
    upload = place.upload(rows.encode(), "u2")
    points = "\n".join(f"{x},{y}" for x, y in place.mask.positions)
    beside = place.upload(f"x,y\n{points}\n".encode(), "u3")
    said = {"sampling_interval": 25e-9, "sound_speed": 1500, "aperture": 2e-3}
    _, found = place.do("import", name="jtext", upload_id=upload, companion_id=beside, description=said)
    assert found["points"] == 64
    assert place.scans.get("stext").state is ScanState.COMPLETE


def test_an_upload_that_is_no_recording_is_refused_and_leaves_no_scan(place):
    upload = place.upload(b"\x89HDF\r\n\x1a\n" + b"\0" * 100, "u4")
    with pytest.raises(DamagedFile):
        place.do("import", name="jbad", upload_id=upload)
    assert not place.data.scan_file("sbad").exists()


def test_a_description_cannot_name_a_file_of_the_service(place):
    with pytest.raises(InvalidInput, match=r"description\.positions"):
        place.do("import", upload_id="u5", description={"positions": "../../../../etc/passwd"})


@pytest.mark.long
def test_the_speed_of_sound_is_found_again(place):
    asked = {"scan_id": place.scan, "first": 1350.0, "last": 1650.0, "steps": 7, "parameters": {"modes": 16}}
    _, report = place.do("sound-speed", **asked)
    assert report["best"] == pytest.approx(SPEED, rel=0.05)
    assert len(report["sound_speeds"]) == len(report["sharpness"]) >= 7
    assert {"sound-speed.json", "sound-speed.png"} <= set(report["files"])


@pytest.mark.long
def test_sound_speed_job_of_a_medium_reports_each_parameter(place):
    layers = [{"sound_speed": 1480, "thickness": 1e-3}, {"sound_speed": 1520}]
    asked = {"search": ["layer2.sound_speed"], "span": 0.05, "parameters": {"modes": 16, "medium": layers}}
    _, report = place.do("sound-speed", scan_id=place.scan, **asked)
    (found,) = report["parameters"]
    assert found["name"] == "layer2.sound_speed"
    np.testing.assert_allclose([found["low"], found["high"]], [1444, 1596])
    assert report["medium"]["layers"][1]["sound_speed"] == found["value"]
    assert {"sound-speed.json", "sound-speed.png"} <= set(report["files"])


def test_following_a_scan_that_is_over_is_its_full_reconstruction(place):
    one, _ = place.reconstruct()
    name, _ = place.do("live", scan_id=place.scan, follow=True, parameters={"modes": 16}, interval=0.2)
    whole, live = (read_volume(place.data.job(job).volume).values for job in (one, name))
    np.testing.assert_array_equal(live, whole)
    assert json.loads(place.data.job(name).revision.read_text())["final"] is True


@pytest.mark.parametrize("kind", JOB_TYPES)
def test_unknown_job_parameter_is_refused(place, kind):
    with pytest.raises(InvalidInput):
        place.do(kind, nonsense=1)


def test_unknown_job_kind_is_refused_with_known_kinds(place):
    with pytest.raises(InvalidInput, match="reconstruction, unmixing, live, what-if"):
        place.do("dance")
