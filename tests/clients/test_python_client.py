"""The Python client against a real service."""

import itertools
import sys
import tempfile

import anyio
import h5py
import matplotlib.image
import numpy as np
import pytest

from steradian_client import (
    AsyncClient,
    Client,
    Conflict,
    ConnectionFailed,
    HasDependents,
    InvalidInput,
    JobFailed,
    NotFound,
)


@pytest.fixture(scope="module")
def service(url):
    with Client(url) as client:
        yield client


@pytest.fixture(scope="module")
def done(service):
    """A scan of 60 points and a reconstruction of it."""
    mask = service.masks.equi_steradian(aperture=13.56e-3, depth=3.6e-3, count=60)
    plan = service.plans.create(mask.id, samples=256)
    scanned, reconstructed = [], []
    scan = service.scans.create(plan.id, labels={"of": "the walk"})
    scan = service.scans.wait(scan, progress=lambda *seen: scanned.append(seen), timeout=250)
    job = service.reconstructions.create(scan.id, modes=32)
    job = service.reconstructions.wait(job, progress=lambda *seen: reconstructed.append(seen), timeout=250)
    assert scanned[-1] == ("A-lines", mask.count, mask.count)
    assert reconstructed
    return mask, plan, scan, job


@pytest.mark.walk
def test_the_whole_walk(service, done, tmp_path):
    """Mask, plan, scan, reconstruction, projection and volume, with progress on the way."""
    mask, _plan, scan, job = done
    assert scan.state == "complete"
    assert scan.simulated
    assert service.scans.coverage(scan.id).stored == mask.count
    assert matplotlib.image.imread(service.reconstructions.download_mip(job.id, tmp_path / "mip.png")).ndim == 3
    volume = np.load(service.reconstructions.download_volume(job.id, tmp_path / "volume.npy"))
    assert volume.shape == (32, 32, 256)
    assert job.id in {made.id for made in service.reconstructions.list()}
    assert "reconstruct" in service.jobs.log(job.id) or service.jobs.attempts(job.id)
    with h5py.File(service.scans.save_file(scan.id, tmp_path / "scan.h5")) as file:
        np.testing.assert_array_equal(service.scans.alines(scan.id, "3:9,::2"), file["alines/samples"][3:9, ::2])
        told = service.scans.shots(scan.id)
        np.testing.assert_array_equal(service.scans.latest_aline(scan.id), file["alines/samples"][told.newest])
    assert service.scans.shots(scan.id, since=told.next).points == []


def test_volumes_come_with_their_axes(service, done, tmp_path, monkeypatch):
    """A slice has the places of its own voxels; without NumPy the values are a view of the same shape."""
    *_, job = done
    whole = service.reconstructions.volume(job.id)
    assert whole.values.shape == (len(whole.x), len(whole.y), len(whole.z)) == (32, 32, 256)
    np.testing.assert_array_equal(
        np.load(service.reconstructions.download_volume(job.id, tmp_path / "v.npy")), whole.values
    )
    part = service.reconstructions.volume(job.id, "4:10:2, 5")
    np.testing.assert_array_equal(part.values, whole.values[4:10:2, 5])
    assert (part.x, part.y, part.z) == (whole.x[4:10:2], whole.y[5:6], whole.z)
    assert np.diff(whole.x) == pytest.approx(13.56e-3 / 32)
    monkeypatch.setitem(sys.modules, "numpy", None)
    bare = service.reconstructions.volume(job.id, "4:10:2, 5").values
    monkeypatch.undo()
    assert isinstance(bare, memoryview)
    assert bare[2, 100] == whole.values[8, 5, 100]


@pytest.mark.long
def test_arrays_become_a_scan(service):
    """Own traces and positions in, and a scan of just these values comes out, told of byte by byte and A-line."""
    random = np.random.default_rng(0)
    traces = random.normal(size=(25, 64)).astype(np.float32)
    positions = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij"), -1).reshape(-1, 2) * 1e-4
    said = []
    scan = service.imports.import_arrays(
        traces,
        positions,
        sampling_interval=16e-9,
        sound_speed=1500.0,
        labels={"from": "arrays"},
        progress=lambda *seen: said.append(seen),
        timeout=250,
    )
    assert scan.labels["from"] == "arrays"
    np.testing.assert_array_equal(service.scans.alines(scan.id), traces)
    assert said[0][0] == "bytes"
    with pytest.raises(JobFailed, match="holds no numbers"):
        service.imports.wait(service.imports.create(uploaded(service, b"a,b")), timeout=250)


@pytest.mark.long
def test_sgl_goes_in_and_comes_out_with_the_same_bytes(service, tmp_path):
    """Also what only its name says arrives: the file is sent without it."""
    samples = np.random.default_rng(0).normal(size=(64, 5 * 4))
    numbers = np.concatenate([[5, 4, 64, 100, 120, 16], samples.ravel(), [1, 8, 1, 20, 750, 21.5, 3, -2]])
    source = tmp_path / "palm@750nm_t0[-7]_dx[100µm]_avg8_2D_raw.SGL"
    source.write_bytes(numbers.astype(">f4").tobytes())
    scan = service.imports.import_file(source, timeout=250)
    with h5py.File(service.scans.save_file(scan.id, tmp_path / "scan.h5")) as file:
        assert file["plan"].attrs["time_zero_s"] == pytest.approx(-7 * 16e-9)
    (made,) = service.exports.export_and_download("sgl", tmp_path / "new", scan_id=scan.id, timeout=250)
    assert made.suffix == ".sgl"
    assert made.read_bytes() == source.read_bytes()


def uploaded(service, content):
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        upload = service.uploads.create(file.name)
    assert service.uploads.get(upload.id).bytes == len(content)
    return upload


@pytest.mark.long
def test_exports_and_comparisons_are_jobs_with_files(service, done, tmp_path):
    *_, job = done
    (path,) = service.exports.export_and_download("nrrd", tmp_path / "new", reconstruction_id=job.id, timeout=250)
    assert path.read_bytes()[:4] == b"NRRD"
    service.jobs.wait(service.reconstructions.compare(job.id, job.id), timeout=250)
    (quality,) = service.reconstructions.quality(job.id)
    assert quality.figures["volume_correlation"] == pytest.approx(1.0)
    assert {found.kind for found in service.jobs.list(kind="export")} == {"export"}


@pytest.mark.long
def test_a_batch_is_waited_for_as_one(service, done):
    _, _, scan, _ = done
    said = []
    batch = service.batches.create(scan.id, {"sound_speed": [1490, 1510]}, modes=16)
    batch = service.batches.wait(batch, progress=lambda *seen: said.append(seen), timeout=110)
    assert [job.varied["sound_speed"] for job in batch.jobs] == [1490, 1510]
    assert said[-1] == ("jobs", 2, 2)
    service.batches.delete(batch, dependents=True)
    with pytest.raises(NotFound):
        service.batches.get(batch.id)


def test_async_client_returns_same_results_as_blocking_client(url, done):
    """The asynchronous client reads, follows events and waits, several at a time, as the blocking one does."""
    mask, plan, _, _ = done

    async def walk():
        async with AsyncClient(url) as service:
            assert await service.masks.get(mask.id) == mask
            seen = []

            async def follow(scan, started):
                async for event in service.events.follow(scan_id=scan, last_event_id=started):
                    seen.append(event)
                    if event.data.get("state") == "complete":
                        return

            first = await anext(service.events.follow())
            assert first.kind == "ready"
            scans = [await service.scans.create(plan.id) for _ in range(2)]
            async with anyio.create_task_group() as group:
                group.start_soon(follow, scans[1].id, first.id)
                over = [await service.scans.wait(scan, timeout=250) for scan in scans]
            assert [scan.state for scan in over] == ["complete", "complete"]
            states = [event.data["state"] for event in seen if event.kind == "scan" and "state" in event.data]
            assert states == ["queued", "arming", "running", "completing", "complete"]
            async with service.scanners.lease("Ada") as lease:
                assert (await service.scanners.get()).lease == lease
            await service.scans.delete(over[0])
            with pytest.raises(NotFound):
                await service.scans.get(over[0].id)

    anyio.run(walk)


def test_a_repeated_request_makes_one_scan(service):
    """A request sent twice with one idempotency key, as after a lost answer, runs the plan once."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=3, interval=1e-3).id)
    first, again = (service.scans.create(plan.id, idempotency_key="a") for _ in range(2))
    assert first.id == again.id
    assert service.scans.create(plan.id).id != service.scans.create(plan.id).id


def test_a_refusal_carries_the_services_words(service, done, tmp_path):
    """A wrong parameter and an unknown scan are exceptions with code, detail and request id; no file is left."""
    with pytest.raises(InvalidInput, match="depth") as refused:
        service.masks.equi_steradian(aperture=0.01, depth=-1, count=60)
    assert refused.value.status == 422
    assert refused.value.request_id
    assert refused.value.errors
    with pytest.raises(NotFound) as missing:
        service.scans.save_file("s-none", tmp_path / "scan.h5")
    assert (missing.value.status, missing.value.code) == (404, "not-found")
    assert not list(tmp_path.iterdir())
    with pytest.raises(HasDependents) as needed:
        service.masks.delete(done[0])
    assert any(done[1].id in name for name in needed.value.dependents)


def test_only_the_holder_of_a_lease_makes_the_laser_fire(service, done):
    """While somebody holds the scanner, scans need the lease's number; a lost one is given back by the block's end."""
    with service.scanners.lease("Ada", seconds=120, note="phantoms") as lease:
        with pytest.raises(Conflict):
            service.scanners.take_lease("Bob")
        with pytest.raises(Conflict):
            service.scans.create(done[1].id)
        scan = service.scans.create(done[1].id, lease=lease)
        assert service.scanners.take_lease("Ada", lease=lease).fence == lease.fence
    assert service.scanners.get().lease is None
    assert service.scans.wait(scan, timeout=250).fence == lease.fence


def test_the_emergency_stop_aborts_and_holds_until_it_is_released(service):
    """A stop that somebody else pressed since is not lifted by releasing an earlier one."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=30, interval=3e-4).id, pulse_rate=1)
    scan = service.scans.create(plan.id)
    first = service.scanners.emergency_stop("smoke")
    try:
        with pytest.raises(JobFailed, match="aborted"):
            service.scans.wait(scan.id, timeout=250)
        with pytest.raises(Conflict, match="emergency stop"):
            service.scans.create(plan.id)
        second = service.scanners.emergency_stop("more smoke")
        with pytest.raises(Conflict):
            service.scanners.release_emergency_stop(first)
        assert service.scanners.release_emergency_stop(second).emergency_stop is None
    finally:
        service.scanners.release_emergency_stop()


def test_a_scan_that_is_aborted_is_a_failure_to_wait_for(service):
    """Waiting for a scan that somebody aborts raises, naming its state."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=30, interval=3e-4).id, pulse_rate=1)
    scan = service.scans.create(plan.id)
    assert service.scans.set_labels(scan.id, {"phantom": "yarn"}).labels == {"phantom": "yarn"}
    with pytest.raises(TimeoutError, match=scan.id):
        service.scans.wait(scan, timeout=0.5)
    service.scans.abort(scan.id, "enough")
    with pytest.raises(JobFailed, match="aborted"):
        service.scans.wait(scan, timeout=250)


def test_lists_are_read_page_by_page(service, monkeypatch):
    """What does not fit a page is on the next, each thing once."""
    made = [service.masks.grid(aperture=0.01, count=2, interval=1e-3 * (1 + step / 10)).id for step in range(5)]
    monkeypatch.setattr("steradian_client.request_session.PAGE", 2)
    found = [mask.id for mask in service.masks.list(limit=5)]
    assert sorted(found) == sorted(made)


def test_filters_hold_on_every_page(service, monkeypatch):
    """Several values of one filter are all sent, also where the next page is asked for; a misspelt one is refused."""
    plan = service.plans.create(service.masks.grid(aperture=0.01, count=2, interval=1e-3).id, pulse_rate=100)
    made = [service.scans.create(plan.id, labels={"page": "a=b", "number": str(one)}) for one in range(3)]
    ended = [service.scans.wait(scan, timeout=250).state for scan in made]
    monkeypatch.setattr("steradian_client.request_session.PAGE", 1)
    found = service.scans.list(limit=10, state=["queued", *set(ended)], label=["page=a=b", "number"], plan_id=plan.id)
    assert [scan.id for scan in found] == [scan.id for scan in reversed(made)]
    assert service.scans.list(label="page=c") == []
    with pytest.raises(InvalidInput, match="'running'"):
        service.scans.list(state="runing")
    with pytest.raises(InvalidInput, match="colour"):
        service.jobs.list(colour="red")


def test_client_service_status_methods_return_service_state(service):
    assert service.health().status == "ok"
    assert service.service_info().mode == "simulated"
    assert set(service.readiness().checks) >= {"database", "disk", "queue"}
    assert service.storage().used_bytes["database_and_rest"] > 0
    assert "# HELP" in service.metrics()


@pytest.mark.long
def test_plan_and_mask_preview_stores_nothing(service, done):
    before = [plan.id for plan in service.plans.list()]
    assert service.plans.preview(done[0].id, pulse_rate=7).laser_seconds == pytest.approx(done[0].count / 7)
    assert [plan.id for plan in service.plans.list()] == before
    seen = service.masks.preview("grid", aperture=0.01, count=7, interval=1e-3)
    assert (seen.count, seen.finest) == (49, pytest.approx(1e-3))
    with pytest.raises(NotFound):
        service.masks.get(seen.id)
    assert len(service.masks.points(done[0].id).positions) == done[0].count


def test_client_unreachable_service_raises_connection_failed(tmp_path):
    """An address where nothing answers is an Unreachable at once, which names it."""
    with Client("http://127.0.0.1:9") as client:
        with pytest.raises(ConnectionFailed, match=r"127\.0\.0\.1:9"):
            client.masks.list()
        with pytest.raises(ConnectionFailed, match=r"127\.0\.0\.1:9"):
            next(itertools.islice(client.events.follow(), 1))
        with pytest.raises(ConnectionFailed):
            client.scans.save_file("s", tmp_path / "scan.h5")
