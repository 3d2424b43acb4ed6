"""Where arrays live: a folder and an object store keep the same promises."""

import os

import pytest

from steradian.core.exceptions import NotFound
from steradian.storage.blobs.interface import BlobInfo, FolderBlobStore, result_name, scan_name, upload_name
from steradian.storage.data_dir.layout import DataDirectory

MIB = 1 << 20
SIZES = {"nothing": 0, "a little": 1000, "several parts": 33 * MIB + 17}


@pytest.fixture(params=["folder", pytest.param("store", marks=pytest.mark.long)])
def place(request, tmp_path):
    """Arrays and their database, on a data folder of their own."""
    data = DataDirectory(tmp_path / "data")
    data.create()
    if request.param == "store":
        yield request.getfixturevalue("make_store")(data.root), request.getfixturevalue("rows"), data
    else:
        yield FolderBlobStore(data), request.getfixturevalue("database"), data


def file_of(folder, content, name="whole.h5"):
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_put_blob_reads_equal_whole_and_in_ranges(place, tmp_path, size):
    arrays, _, _ = place
    content = os.urandom(size)
    arrays.put_and_commit(scan_name("s1"), file := file_of(tmp_path, content))
    assert not file.exists(), "it is the seam's now"
    assert arrays.open("scans/s1.h5").read_bytes() == content
    for first, count in [(0, 10), (size // 2, 100), (max(0, size - 5), 100), (size + 3, 5), (7, 0)]:
        assert arrays.range("scans/s1.h5", first, count) == content[first : first + count]
    found = arrays.stat("scans/s1.h5")
    assert isinstance(found, BlobInfo)
    assert found.size == size


def test_put_blobs_are_listed_and_readable_after_commit(place, tmp_path):
    arrays, database, data = place
    data.job("j1").root.mkdir()
    names = [result_name("j1", name) for name in ("volume.h5", "report.json")]
    stored = [arrays.put(name, file_of(tmp_path, name.encode(), name.rpartition("/")[2])) for name in names]
    with database.write() as session:
        arrays.commit(session, *stored)
    assert list(arrays.list_names(result_name("j1"))) == sorted(names)
    assert [arrays.open(name).read_bytes() for name in names] == [name.encode() for name in names]


def test_read_of_missing_blob_raises_not_found(place):
    arrays, _, _ = place
    assert arrays.stat("scans/s9.h5") is None
    for read in (lambda: arrays.open("scans/s9.h5"), lambda: arrays.range("scans/s9.h5", 0, 1)):
        with pytest.raises(NotFound):
            read()
    assert list(arrays.list_names("jobs/j9/")) == []


def test_deleting_takes_one_thing_or_all_of_a_job_and_may_be_repeated(place, tmp_path):
    arrays, _, data = place
    for job in ("j1", "j10"):
        data.job(job).root.mkdir()
        for name in ("a.json", "b.json"):
            arrays.put_and_commit(result_name(job, name), file_of(tmp_path, b"{}"))
    arrays.put_and_commit(upload_name("u1"), file_of(tmp_path, b"upload", "u1.part"))
    for _ in range(2):
        arrays.delete(upload_name("u1"))
        arrays.delete(result_name("j1"))
    assert [*arrays.list_names("uploads/"), *arrays.list_names("jobs/j1/")] == []
    assert list(arrays.list_names("jobs/j10/")) == ["jobs/j10/a.json", "jobs/j10/b.json"]


def test_open_of_local_scan_file_returns_its_local_path(place):
    arrays, _, data = place
    data.scan_file("s1").write_bytes(b"A-lines so far")
    assert arrays.open(scan_name("s1")) == data.scan_file("s1")
    assert arrays.stat(scan_name("s1")).size == 14
    assert arrays.url(scan_name("s1"), 60) is None
    assert arrays.is_available()
