"""Files that mean harm, sent to a service: each import fails with the right problem, and the service serves on."""

import json
import re
import sys
import uuid
from pathlib import Path

import h5py
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from poisoned_arrays import ARCHIVES, ARRAYS, MATLAB, poisoned_zip
from poisons import FORMATS, POISONS, Poisoned

from support.services import Service

pytestmark = pytest.mark.timeout(900)
GRID = {"sampling_interval": 1e-8, "sound_speed": 1500.0, "grid": {"interval": [1e-4]}}


def hdf5(poison, kind):
    """A recording of one format, poisoned, and its description."""

    def write(folder):
        make, *names = FORMATS[kind]
        source, description = make(folder)
        with h5py.File(source, "r+") as file:
            poison(Poisoned(file, *names))
        is_text = description is not None and description.suffix == ".json"
        return source.read_bytes(), json.loads(description.read_text()) if is_text else None

    return write


def attacks():
    """Every way to poison a file, HDF5's in one format each, by name: what writes it, and the words of its refusal."""
    for number, (poison, words) in enumerate(POISONS.items()):
        kind = list(FORMATS)[number % len(FORMATS)]
        yield f"{poison.__name__} in {kind}", hdf5(poison, kind), words
    for name, data, words in ARRAYS:
        yield name, lambda _folder, data=data: (data, GRID), words
    for number, (data, words) in enumerate(ARCHIVES):
        make = lambda folder, data=data: (poisoned_zip(folder / "a.npz", "p", data).read_bytes(), None)  # noqa: E731
        yield f"archive {number}", make, words
    for number, (write, words) in enumerate(MATLAB):
        yield f"MATLAB {number}", lambda folder, write=write: (write(folder / "a.mat").read_bytes(), None), words


ATTACKS = {name: more for name, *more in attacks()}


def over(service, name):
    """The job of an attack, once it is over."""
    job = {"state": "queued"}
    while job["state"] in {"queued", "running"}:
        job = service.get(f"/jobs/{service.jobs[name]}", headers={"Prefer": "wait=100"}).json()
    return job


@pytest.fixture(scope="module")
def service(request, tmp_path_factory):
    """A service that has got all that are tried."""
    tried = [item.callspec.params["name"] for item in request.session.items if item.path == request.path]
    service = Service(tmp_path_factory.mktemp("service"), workers=2).start()
    try:
        service.jobs = {}
        for number, name in enumerate(tried):
            data, description = ATTACKS[name][0](tmp_path_factory.mktemp(f"attack-{number}"))
            upload = service.http.post("/uploads", content=data).json()["id"]
            told = {} if description is None else {"description": description}
            body = {"kind": "import", "upload_id": upload, **told}
            sent = {"Idempotency-Key": uuid.uuid4().hex}
            service.jobs[name] = service.http.post("/jobs", json=body, headers=sent).json()["id"]
        yield service
        for name in tried:
            over(service, name)
        assert not list((service.folder / "scans").iterdir()), "nothing of any of them is left"
    finally:
        service.close()
    assert "Traceback" not in service.log.read_text()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly if number % 6 else pytest.mark.long)
        for number, name in enumerate(ATTACKS)
    ],
)
def test_a_file_that_means_harm_is_refused_by_its_import(service, name):
    job = over(service, name)
    assert job["state"] == "failed", "it is no scan"
    assert job["error"]["code"] in {"damaged-file", "invalid-input"}, job["error"]
    assert re.search(ATTACKS[name][1], job["error"]["detail"]), job["error"]
    assert str(service.folder) not in json.dumps(job), "the error names no place on the server"
    assert not list((service.folder / "scans").glob("*.h5"))
    assert service.get("/scans").json()["items"] == []
