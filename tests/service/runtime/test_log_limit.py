import fcntl
import logging
import os
import re
import threading
import time
from datetime import UTC, datetime, timedelta

import pytest

from steradian.core import logging_config as logs
from steradian.core.settings import Settings
from support.waiting import until


@pytest.fixture
def log_to(tmp_path, monkeypatch):
    """Sets this process's log up as a process of the service does, on a stream as standard error."""
    root = logging.getLogger()
    before = root.handlers[:], root.level

    def set_up(stream, **settings):
        monkeypatch.setattr("sys.stderr", stream)
        logs.configure_logging(Settings.create(data=tmp_path, **settings), "api")
        return root.handlers[0]

    yield set_up
    root.handlers, root.level = before


@pytest.fixture
def written(tmp_path, log_to):
    """Returns the lines that are written."""
    with (tmp_path / "log").open("w") as stream:
        handler = log_to(stream)

        def lines():
            handler.flush()
            return (tmp_path / "log").read_text("utf-8").split("\n")[:-1]

        yield lines


def test_a_thousand_lines_of_a_kind_become_a_few_and_others_are_written_meanwhile(written, monkeypatch):
    log = logging.getLogger("steradian.test")
    for number in range(1000):
        log.warning("connection %d is refused", number)
    log.warning("something else")
    assert sum("is refused" in line for line in written()) == logs.MAX_BURST
    assert written()[-1].endswith("something else")
    monkeypatch.setattr(logs, "WINDOW", 0.0)
    log.warning("connection %d is refused", 1001)
    last = written()[-1]
    assert last.endswith(f"connection 1001 is refused [{1000 - logs.MAX_BURST} similar lines were omitted before]")


def test_log_message_with_control_characters_is_escaped_to_one_line(written):
    """A reason, a name or a path may hold line ends and the codes by which a terminal is made to hide what it shows."""
    reason = "smoke\n2026-01-01 00:00:00,000 INFO api all is well\r\x1b[2K\u2028\u202eend, Überdruck 5 \u00b5m"
    logging.getLogger("steradian.test").warning("scan s1 is wished aborted: %s", reason)
    (line,) = written()
    assert line.endswith(r"smoke\n2026-01-01 00:00:00,000 INFO api all is well\r\x1b[2K\u2028\u202eend, Überdruck 5 µm")


def test_text_log_begins_each_line_with_local_time_and_its_offset_from_utc(written, monkeypatch):
    monkeypatch.setenv("TZ", "Asia/Kathmandu")
    time.tzset()
    try:
        logging.getLogger("steradian.test").warning("something")
        (line,) = written()
    finally:
        monkeypatch.undo()
        time.tzset()
    at = datetime.fromisoformat(line.split(" ")[0])
    assert at.utcoffset() == timedelta(hours=5, minutes=45)
    assert abs(datetime.now(UTC) - at) < timedelta(hours=1)


def test_log_with_blocked_reader_never_blocks_and_reports_lost_lines(log_to, monkeypatch):
    """Written at once, the line that fills the pipe would wait for ever."""
    monkeypatch.setattr(logs, "MAX_QUEUED", 100)
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    with open(reader, encoding="utf-8") as read, open(writer, "w") as stream:
        handler = log_to(stream, log_level="DEBUG")
        log, over = logging.getLogger("steradian.test"), threading.Event()

        def tell():
            for number in range(1000):
                log.info("line %d", number)
            over.set()

        threading.Thread(target=tell, daemon=True).start()
        assert over.wait(100)
        told = []
        threading.Thread(target=lambda: [told.append(line) for line in read], daemon=True).start()
        until(lambda: handler._lines.empty())
        log.info("the last")
        until(lambda: told and told[-1].endswith("the last\n"))
    lost = sum(int(found[1]) for line in told if (found := re.search(r" (\d+) lines are lost", line)))
    assert 0 < lost == 1000 - sum(" INFO api line " in line for line in told)
