"""Log lines about a scanner that is not heard."""

import logging

import pytest

from fabry_perot.host.silence_log import LOOK, QUIET, TOLD_AFTER, SilenceLog

SECOND = 1_000_000


@pytest.fixture
def said(caplog):
    caplog.set_level(logging.INFO, "fabry_perot")
    return lambda: [record.getMessage() for record in caplog.records]


def silent(log, begin, seconds, step=20_000):
    """A line on which nothing is heard for so long and then something, looked at in steps; returns when it ended."""
    end = begin + int(seconds * SECOND)
    for now in range(begin + step, end, step):
        log.note(now, begin, 400_000)
    log.note(end, end, 400_000)
    return end


def test_silence_log_of_suspended_program_logs_no_silence(said):
    """Held up for seconds between two looks, a program has heard nothing because it did not listen."""
    log, now = SilenceLog(), 0
    for _ in range(18):
        log.note(now, now, 400_000)
        log.note(now + 3 * SECOND, now, 400_000)
        now += 3 * SECOND + LOOK
    assert said() == []


def test_silence_log_of_silent_scanner_logs_start_and_end(said):
    silent(SilenceLog(), 0, 2)
    first, last = said()
    assert first.startswith("the scanner is silent: nothing was received from it for 1.0")
    assert last == "the scanner is received again after 2.0 s"


def test_silence_log_of_short_silences_logs_no_message(said):
    log, now = SilenceLog(), 0
    for _ in range(20):
        now = silent(log, now, 0.9 * TOLD_AFTER / SECOND)
    assert said() == []


def test_silence_log_of_repeated_silences_logs_first_and_counts_rest(said):
    log, now = SilenceLog(), 0
    for _ in range(18):
        now = silent(log, now, 2)
    assert len(said()) == 2
    log.note(now + QUIET, now + QUIET, 400_000)
    silent(log, now + QUIET, 2)
    assert len(said()) == 4
    assert said()[2].endswith("17 times before, up to 2.0 s")
