"""What is expensive keeps nobody else waiting: it is worked out in processes beside the API."""

import asyncio
import json
import os
import signal
import socket
import threading
import time
from pathlib import Path

import httpx
import numpy as np
import pytest

from steradian.api.background.process_pool import ComputationLimitExceeded, ProcessPool
from steradian.api.errors.catalog import PROBLEM_TYPES
from steradian.api.services import ServiceContainer
from support.processes import are_gone, children_of, processor_seconds, runs
from support.waiting import until

from .conftest import api_of

pytestmark = pytest.mark.timeout(400)  # what is worked out beside the API has what others leave of the processors


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = api_of(tmp_path_factory.mktemp("api"), max_upload_bytes=64 * 2**20, max_mask_points=200_000)
    server.wait()
    yield server
    server.close()


@pytest.fixture
def worst_beside(server):
    """Runs something and returns its answer with how long /healthz took at worst meanwhile, in s."""

    def run(ask):
        answer, worst = [], 0.0
        thread = threading.Thread(target=lambda: answer.append(ask()))
        with httpx.Client(timeout=300) as client:
            client.get(f"{server.url}/healthz")
            thread.start()
            while thread.is_alive():
                begun = time.monotonic()
                client.get(f"{server.url}/healthz")
                worst = max(worst, time.monotonic() - begun)
                time.sleep(0.01)
        thread.join()
        return answer[0], worst

    return run


@pytest.mark.long
def test_a_mask_of_many_positions_is_made_beside_the_api(server, worst_beside):
    positions = np.random.default_rng(1).uniform(-5e-3, 5e-3, (100_000, 2))
    body = json.dumps({"arrangement": "points", "aperture": 0.01, "positions": positions.tolist()})
    post = lambda: httpx.post(  # noqa: E731
        f"{server.url}/api/v1/masks", content=body, headers={"Content-Type": "application/json"}, timeout=300
    )
    before = resident(server)
    answer, worst = worst_beside(post)
    assert answer.status_code == 201, answer.text
    points = httpx.get(f"{server.url}{answer.json()['links']['points']}", headers={"Accept": "text/csv"}, timeout=300)
    found = np.loadtxt(points.text.splitlines()[1:], delimiter=",")[:, :2]
    assert np.array_equal(np.sort(found, axis=0), np.sort(positions, axis=0))
    assert post().json()["id"] == answer.json()["id"], "the same body, the same mask"
    print(f"/healthz at worst {1e3 * worst:.0f} ms, {before:.0f} to {resident(server):.0f} MiB")


@pytest.mark.parametrize(
    ("positions", "pointer"),
    [
        ('"a", ' * 20_000 + '"b"', "#/positions"),
        ("[1, 2], " * 20_000 + "[1]", "#/positions"),
        ('[0, "x"], ' * 20_000 + "[1, 2]", "#/positions"),
    ],
    ids=["texts", "ragged", "mixed"],
)
def test_a_large_body_of_nonsense_is_refused_in_one_sentence(server, positions, pointer):
    body = '{"arrangement": "points", "aperture": 0.01, "positions": [' + positions + "]}"
    headers = {"Content-Type": "application/json"}
    answer = httpx.post(f"{server.url}/api/v1/masks", content=body, headers=headers, timeout=300)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == pointer
    assert len(answer.text) < 2000


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("masks", '{"arrangement": "points", "aperture": 0.01, "positions": [' + "[1, 2], " * 20_000 + "[1]]}"),
        ("masks", '{"arrangement": "grid", "aperture": 0.01, "count": 60, "interval": 1e-5}'),
        ("masks/preview", '{"arrangement": "grid", "aperture": 0.01, "count": 5, "interval": 1e-4}'),
    ],
    ids=["parsed", "made", "previewed"],
)
def test_hung_worker_processes_return_503_and_health_stays_available(server, path, body):
    ask = lambda: httpx.post(  # noqa: E731
        f"{server.url}/api/v1/{path}", content=body, headers={"Content-Type": "application/json"}, timeout=300
    )
    assert ask().status_code in {200, 201, 422}  # now there is such a process
    beside, answers = children_of(server.process.pid), []
    asking = threading.Thread(target=lambda: answers.append(ask()))
    for pid in beside:
        os.kill(pid, signal.SIGSTOP)
    try:
        asking.start()
        for _ in range(20):
            assert httpx.get(f"{server.url}/healthz", timeout=300).status_code == 200
    finally:
        for pid in beside:
            os.kill(pid, signal.SIGKILL)
    asking.join()
    assert (answers[0].status_code, answers[0].json().get("code")) == (503, "too-expensive"), answers[0].text[:500]


@pytest.mark.parametrize("path", ["jobs", "scans", "reconstructions", "batches", "plans", "masks"])
def test_request_body_over_limit_returns_413(server, path):
    address = server.url.removeprefix("http://").split(":")
    with socket.create_connection((address[0], int(address[1])), timeout=250) as connection:
        stated = f"Content-Type: application/json\r\nContent-Length: {60 * 2**20}\r\n\r\n"
        connection.sendall(f"POST /api/v1/{path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{stated}".encode())
        assert connection.recv(100).startswith(b"HTTP/1.1 413")


@pytest.mark.long
def test_a_picture_is_drawn_beside_the_api(server):
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
    mask = httpx.post(f"{server.url}/api/v1/masks", json=equi, timeout=300).json()
    picture = httpx.get(f"{server.url}{mask['links']['picture']}", timeout=300)
    assert picture.content.startswith(b"\x89PNG")
    assert "matplotlib" not in Path(f"/proc/{server.process.pid}/maps").read_text()


@pytest.mark.long
def test_an_order_that_is_searched_for_is_found_beside_the_api(server):
    api = f"{server.url}/api/v1"
    equi = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
    mask = httpx.post(f"{api}/masks", json=equi, timeout=300).json()
    wanted = {"mask_id": mask["id"], "order": "progressive"}
    preview = httpx.post(f"{api}/plans/preview", json=wanted, timeout=300)
    assert preview.status_code == 200, preview.text
    plan = httpx.post(f"{api}/plans", json=wanted, timeout=300).json()
    assert plan["preview"] == preview.json()
    loaded = Path(f"/proc/{server.process.pid}/maps").read_text()
    assert "llvmlite" not in loaded, "the API's own process has compiled code for the search, so it searched"


@pytest.mark.long
def test_a_budget_ends_with_the_connection_of_its_caller(server):
    """The process that computes is stopped meanwhile, so that it neither finishes nor reaches its processor time."""
    asked = {"arrangement": "grid", "duration": 900, "aperture": 13.56e-3, "depth": 2.5e-3, "vessel": 1.5e-4}
    body = json.dumps(asked | {"noise": 10}).encode()
    head = "POST /api/v1/designs/budget HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    pool = lambda: [pid for pid in children_of(server.process.pid) if runs(pid, "core.child_process")]  # noqa: E731
    before = {pid: processor_seconds(pid) for pid in pool()}
    host, port = server.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=250) as connection:
        connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        pid = until(
            lambda: next((each for each in pool() if processor_seconds(each) > before.get(each, 0) + 0.1), None)
        )
        os.kill(pid, signal.SIGSTOP)
    try:
        until(lambda: are_gone([pid]))
    finally:
        if not are_gone([pid]):
            os.kill(pid, signal.SIGKILL)
    small = {"duration": 20, "aperture": 5e-3, "averages": [16], "noise": 20}
    answer = httpx.post(f"{server.url}/api/v1/designs/budget", json=asked | small, timeout=300)
    assert answer.status_code == 200, "the next caller waits for nobody"


async def double(pool, value):
    return await pool.submit(np.multiply, value, 2)


def test_a_workshop_outlives_the_death_of_its_processes():
    async def run():
        pool = ProcessPool()
        try:
            assert await double(pool, 21) == 42
            with pytest.raises(ComputationLimitExceeded):
                await pool.submit(signal.raise_signal, signal.SIGKILL)
            assert PROBLEM_TYPES[ComputationLimitExceeded.code].status == 503, (
                "its code is told, and no failure of the service's"
            )
            assert await double(pool, 4) == 8
            with pytest.raises(ZeroDivisionError):
                await pool.submit(divmod, 1, 0)
        finally:
            pool.close()

    asyncio.run(run())


@pytest.mark.long
def test_process_pool_limits_cpu_time_not_waiting_time():
    """A limit in seconds of a processor: on a busy machine the same things are worked out as on an idle one."""

    async def run():
        pool = ProcessPool(max_work=1)
        try:
            assert await pool.submit(time.sleep, 1.5) is None
            with pytest.raises(ComputationLimitExceeded, match="longer than it may"):
                await pool.submit(sum, range(10**12))
            for value in range(1, 4):  # each has its own time, in the same process
                assert await pool.submit(sum, range(10**7)) == 49999995000000
                assert await double(pool, value) == 2 * value
        finally:
            pool.close()

    asyncio.run(run())


def test_process_pool_close_cancels_running_computation():
    async def run():
        pool = ProcessPool()
        long = asyncio.create_task(pool.submit(time.sleep, 100))
        await double(pool, 21)  # on the other bench; now the first one has its child
        pool.close()
        with pytest.raises(ComputationLimitExceeded):
            await asyncio.wait_for(long, 60)

    asyncio.run(run())


def test_a_cancelled_call_ends_its_process_and_no_other():
    async def run():
        pool = ProcessPool()
        try:
            other = await pool.submit(os.getpid)
            long = asyncio.create_task(pool.submit(time.sleep, 1000))
            await asyncio.to_thread(until, lambda: pool._busy)
            (child,) = pool._busy
            long.cancel()
            with pytest.raises(asyncio.CancelledError):
                await long
            await asyncio.to_thread(child._process.wait, 250)
            assert child._process.pid == other, "the idle process took the call"
            assert await pool.submit(os.getpid) != other
        finally:
            pool.close()

    asyncio.run(run())


def test_closed_process_pool_submit_raises_limit_exceeded():
    """Such as clients that wait for their turn when the service ends: it has not failed."""
    pool = ProcessPool()
    pool.close()
    with pytest.raises(ComputationLimitExceeded):
        asyncio.run(pool.submit(os.getpid))


def test_the_processes_of_a_service_without_work_end(server, monkeypatch):
    from steradian.api.background import process_pool as pool

    monkeypatch.setattr(pool, "IDLE", 0.0)
    services = ServiceContainer(server.settings)
    services.open()
    try:
        child = pool._PoolProcess()
        services.process_pool._idle.append(child)
        child._process.wait(250)
    finally:
        services.close()


def test_service_close_waits_for_background_reconciliation(server, monkeypatch):
    """Else that opens connections anew which nothing closes."""
    services, begun, ended = ServiceContainer(server.settings), threading.Event(), threading.Event()

    def reconcile(_):
        begun.set()
        services._over.wait(250)
        time.sleep(0.3)
        services.ledger.unfinished()
        ended.set()

    monkeypatch.setattr("steradian.jobs.queue.queue_client.JobQueue.reconcile", reconcile)
    services.open()
    assert begun.wait(250)
    services.close()
    assert ended.is_set()


def resident(server):
    """Memory of the API's process in MiB."""
    return int(Path(f"/proc/{server.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
