import io
import logging

import pytest

from steradian.runtime import logs
from steradian.settings import Settings


@pytest.fixture
def written(tmp_path, monkeypatch):
    """What this process's log writes, set up as a process of the service does."""
    root, text = logging.getLogger(), io.StringIO()
    before = root.handlers[:], root.level
    monkeypatch.setattr("sys.stderr", text)
    logs.configure_logging(Settings.create(data=tmp_path), "api")
    yield text
    root.handlers, root.level = before


def test_a_thousand_lines_of_a_kind_become_a_few_and_others_are_written_meanwhile(written, monkeypatch):
    log = logging.getLogger("steradian.test")
    for number in range(1000):
        log.warning("connection %d is refused", number)
    log.warning("something else")
    assert written.getvalue().count("is refused") == logs.BURST
    assert "something else" in written.getvalue()
    monkeypatch.setattr(logs, "WINDOW", 0.0)
    log.warning("connection %d is refused", 1001)
    last = written.getvalue().splitlines()[-1]
    assert last.endswith(f"connection 1001 is refused [{1000 - logs.BURST} such lines were left out before]")
