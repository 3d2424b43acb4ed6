"""An event that signal handlers set, at any moment."""

import signal
import sys
import threading

import pytest

from steradian.core.signal_safe_event import SignalSafeEvent


def test_it_is_set_once_and_waits_no_longer():
    event = SignalSafeEvent()
    assert not event.is_set()
    assert not event.wait(0.001)
    event.set()
    event.set()
    assert event.is_set()
    assert event.wait()
    with pytest.raises(RuntimeError):
        event.clear()


def test_event_set_wakes_every_waiting_thread():
    event, told = SignalSafeEvent(), []
    threads = [threading.Thread(target=lambda: told.append(event.wait(250))) for _ in range(3)]
    for thread in threads:
        thread.start()
    event.set()
    for thread in threads:
        thread.join(10)
    assert told == [True] * 3


@pytest.fixture
def event():
    """An event that SIGUSR1 sets."""
    event = SignalSafeEvent()
    before = signal.signal(signal.SIGUSR1, lambda *_: event.set())
    yield event
    signal.signal(signal.SIGUSR1, before)


@pytest.mark.parametrize("line", range(20))
@pytest.mark.parametrize("interrupted", ["wait", "set"])
def test_a_signal_at_any_line_sets_it_without_waiting_for_whom_it_interrupts(event, interrupted, line):
    """A plain event comes to a standstill where the interrupted wait, or another handler's set, holds its lock."""
    seen = 0

    def trace(*_):
        nonlocal seen
        if seen == line:
            signal.raise_signal(signal.SIGUSR1)
        seen += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        event.wait(0.001) if interrupted == "wait" else event.set()
    finally:
        sys.settrace(before)
    assert event.is_set() is (seen > line or interrupted == "set")


def test_a_signal_ends_a_wait_that_sleeps(event):
    sender = threading.Timer(0.05, signal.pthread_kill, (threading.main_thread().ident, signal.SIGUSR1))
    sender.start()
    assert event.wait(250)
    sender.join()
