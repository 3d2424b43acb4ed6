"""The lock that says who is alive, and a server that hangs: nobody waits for ever or takes itself for another."""

import contextlib
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from steradian.storage.db import advisory_locks as advisory
from steradian.storage.db.advisory_locks import AdvisoryLock, LockState


@pytest.fixture
def url(postgres):
    return postgres.database()


@pytest.fixture
def lock(url):
    lock = AdvisoryLock(url, "me")
    assert lock.acquire(30) is LockState.HELD
    yield lock
    lock.release()


@pytest.fixture
def stopped(lock):
    """The server's process of the lock's session, stopped; yields what lets it go on."""
    pid = lock._session.info.backend_pid
    os.kill(pid, signal.SIGSTOP)
    yield lambda: os.kill(pid, signal.SIGCONT)
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def in_time(ask):
    """Return what ``ask`` does; a failure when it has not come back after a minute."""
    answers = []
    thread = threading.Thread(target=lambda: answers.append(ask()), daemon=True)
    thread.start()
    thread.join(60)
    assert answers, "it waits for a server that does not answer"
    return answers[0]


@pytest.mark.long
def test_one_holds_a_name_and_the_next_when_its_session_is_gone(url, lock):
    other = AdvisoryLock(url, "me")
    assert other.ensure_held() is LockState.TAKEN
    with lock.try_briefly("another") as free:
        assert free
    lock.release()
    assert other.acquire(30) is LockState.HELD
    assert lock.ensure_held() is LockState.TAKEN
    other.release()


def test_advisory_lock_borrowed_briefly_is_still_acquired(url, monkeypatch):
    """After a restart of the database: who is back first looks whether the others are."""
    lock, other, asked = AdvisoryLock(url, "me"), AdvisoryLock(url, "other"), threading.Event()
    assert other.acquire(30) is LockState.HELD
    renew = lock.ensure_held

    def seen():
        hold = renew()
        if hold is LockState.TAKEN:
            asked.set()
        return hold

    monkeypatch.setattr(lock, "ensure_held", seen)
    with ThreadPoolExecutor(1) as pool:
        with other.try_briefly("me") as free:
            assert free
            kept = pool.submit(lock.hold, 60)
            assert asked.wait(60)
        assert kept.result() is LockState.HELD
    other.release()
    lock.release()


def test_a_server_that_hangs_is_not_waited_for(lock, stopped, monkeypatch):
    monkeypatch.setattr(advisory, "QUERY_TIMEOUT", 0.5)
    assert in_time(lock.ensure_held) is LockState.UNREACHABLE


def test_advisory_lock_with_lost_session_is_unreachable_not_taken(lock, stopped, monkeypatch):
    """The server still holds the lock for the session that was cut: it has not heard that yet."""
    monkeypatch.setattr(advisory, "QUERY_TIMEOUT", 0.5)
    assert in_time(lock.ensure_held) is LockState.UNREACHABLE
    monkeypatch.undo()
    assert lock.ensure_held() is LockState.UNREACHABLE
    stopped()
    assert lock.acquire(30) is LockState.HELD


def test_shared_advisory_lock_excludes_exclusive_holder(url):
    nodes, alone = [AdvisoryLock(url, "shared", shared=True) for _ in range(2)], AdvisoryLock(url, "shared")
    assert [node.acquire(30) for node in nodes] == [LockState.HELD, LockState.HELD]
    assert alone.ensure_held() is LockState.TAKEN
    nodes[0].release()
    assert (alone.ensure_held(), nodes[1].ensure_held()) == (LockState.TAKEN, LockState.HELD)
    nodes[1].release()
    assert alone.acquire(30) is LockState.HELD
    assert nodes[0].ensure_held() is LockState.TAKEN
    alone.release()
