"""Between two jobs a worker hardly waits; without work it looks at the queue now and then."""

import threading

import pytest

from steradian.jobs.worker.queue_polling import BUSY_POLL, FAST_POLL, adaptive_wait


class Runner:
    def __init__(self, *, is_hurried):
        self.is_hurried, self.ended, self.idle = is_hurried, threading.Event(), threading.Event()
        self.idle.set()


class Changes:
    """Tells of a change at the given looks."""

    def __init__(self, *told):
        self.told = list(told)

    def has_changed(self):
        return self.told.pop(0)


class Event:
    """An event that notes how long it was waited for."""

    def __init__(self):
        self.waits = []

    def wait(self, timeout=None):
        self.waits.append(timeout)
        return False

    def is_set(self):
        return False


def test_after_a_job_the_next_look_comes_at_once():
    event = Event()
    assert adaptive_wait(event, Runner(is_hurried=True), Changes(), 0.1)(0.1) is False
    assert event.waits == [FAST_POLL]


@pytest.mark.parametrize("timeout", [None, 1.0, 5.0])
def test_other_waits_of_the_engine_are_left_alone(timeout):
    event = Event()
    adaptive_wait(event, Runner(is_hurried=True), Changes(), 0.1)(timeout)
    assert event.waits == [timeout]


def test_a_wait_under_way_ends_with_the_job():
    runner, event = Runner(is_hurried=False), Event()
    runner.ended.set()
    assert adaptive_wait(event, runner, Changes(), 30.0)(30.0) is False, "it does not take thirty seconds"
    assert not runner.ended.is_set()
    assert event.waits == []


def test_idle_worker_polls_queue_after_database_change():
    runner, changes = Runner(is_hurried=False), Changes(False, False, True, False)
    assert adaptive_wait(Event(), runner, changes, 0.001)(0.001) is False
    assert changes.told == [False], "two looks at the file's number, and at the queue after the third"


def test_a_wait_in_which_nothing_is_written_ends_when_the_engine_ends():
    event = threading.Event()
    event.set()
    assert adaptive_wait(event, Runner(is_hurried=False), Changes(), 0.001)(0.001) is True


class Busy:
    """Is not idle; notes for how long that was waited for."""

    def __init__(self):
        self.waits = []

    def is_set(self):
        return False

    def wait(self, timeout=None):
        self.waits.append(timeout)
        return False


def test_while_a_job_is_at_work_its_end_is_waited_for_and_the_queue_is_left_alone():
    runner, event = Runner(is_hurried=False), Event()
    runner.idle = Busy()
    for _ in range(2):  # the queue of jobs and the engine's own; both are woken by what stays set
        assert adaptive_wait(event, runner, Changes(), 0.1)(0.1) is False
    assert runner.idle.waits == [BUSY_POLL] * 2
    assert event.waits == []


@pytest.mark.parametrize("timeout", [None, 1.0])
def test_other_waits_of_the_engine_are_left_alone_while_a_job_is_at_work(timeout):
    runner, event = Runner(is_hurried=False), Event()
    runner.idle = Busy()
    adaptive_wait(event, runner, Changes(), 0.1)(timeout)
    assert event.waits == [timeout]
