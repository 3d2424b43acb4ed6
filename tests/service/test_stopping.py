"""An event that signal handlers set, at any moment."""

import signal
import threading
import time

import pytest

from steradian.stopping import StopEvent


def test_it_is_set_once_and_waits_no_longer():
    event = StopEvent()
    assert not event.is_set()
    assert not event.wait(0.001)
    event.set()
    event.set()
    assert event.is_set()
    assert event.wait()
    with pytest.raises(RuntimeError):
        event.clear()


def test_every_thread_that_waits_is_told():
    event, told = StopEvent(), []
    threads = [threading.Thread(target=lambda: told.append(event.wait(30))) for _ in range(3)]
    for thread in threads:
        thread.start()
    event.set()
    for thread in threads:
        thread.join(10)
    assert told == [True] * 3


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs interval timers")
def test_signals_in_a_storm_set_it_without_waiting_for_themselves():
    """Handlers interrupt waits as they begin and each other; a plain event would come to a standstill."""
    before = signal.signal(signal.SIGALRM, lambda *_: event.set())
    try:
        for _ in range(300):
            event = StopEvent()
            signal.setitimer(signal.ITIMER_REAL, 1e-5, 1e-5)
            deadline = time.monotonic() + 30
            while not event.wait(1e-6):
                assert time.monotonic() < deadline
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
