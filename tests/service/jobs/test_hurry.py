"""Between two jobs a worker hardly waits; without work it looks at the queue now and then."""

import threading

import pytest

from steradian.jobs.hurrying import HURRIED_POLL, hurried


class Runner:
    def __init__(self, *, is_hurried):
        self.is_hurried, self.ended = is_hurried, threading.Event()


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
    assert hurried(event, Runner(is_hurried=True), 0.1)(0.1) is False
    assert event.waits == [HURRIED_POLL]


@pytest.mark.parametrize("timeout", [None, 1.0, 5.0])
def test_other_waits_of_the_engine_are_left_alone(timeout):
    event = Event()
    hurried(event, Runner(is_hurried=True), 0.1)(timeout)
    assert event.waits == [timeout]


def test_a_wait_under_way_ends_with_the_job():
    runner, event = Runner(is_hurried=False), Event()
    runner.ended.set()
    assert hurried(event, runner, 30.0)(30.0) is False, "it does not take thirty seconds"
    assert not runner.ended.is_set()
    assert event.waits == []
