"""A child that is still being started when its job is no longer wanted, and one that takes as long as a scan."""

import asyncio
import os
import sys
from pathlib import Path

from steradian.jobs.job import Succeeded
from steradian.jobs.worker.process import JobProcess

ECHO = str(Path(__file__).with_name("echo_job.py"))


async def _nothing(*_):
    pass


def test_a_job_that_is_given_up_while_its_process_starts_leaves_none_behind(tmp_path, monkeypatch):
    started, start, there = [], asyncio.create_subprocess_exec, asyncio.Event()

    async def slowly(*command, **how):
        started.append(await start(*command, **how))
        there.set()
        await asyncio.sleep(0.2)
        return started[-1]

    async def give_up():
        process = JobProcess([sys.executable, ECHO], {})
        payload = {"request": {"do": "hang", "diary": str(tmp_path / "diary")}}
        job = asyncio.ensure_future(process.run(payload, log=tmp_path / "log.txt", report=_nothing, timeout=250))
        await there.wait()
        job.cancel()
        await asyncio.wait({job}, timeout=250)
        assert job.cancelled()
        assert started[0].returncode is not None, "it has been killed and waited for"

    monkeypatch.setattr(asyncio, "create_subprocess_exec", slowly)
    asyncio.run(give_up())
    assert len(started) == 1


def test_the_time_of_a_scan_that_is_followed_is_not_the_jobs(tmp_path):
    async def run(do, follows):
        process = JobProcess([sys.executable, ECHO], dict(os.environ))
        payload = {"request": {"do": do, "answer": 1, "diary": str(tmp_path / "diary")}}
        how = {"log": tmp_path / "log.txt", "report": _nothing, "timeout": 2.9, "follows": follows}
        try:
            await process.run({"request": payload["request"] | {"do": "succeed"}}, **how | {"timeout": 120})
            return await process.run(payload, **how)
        finally:
            await process.end()

    assert asyncio.run(run("follow", "following")) == Succeeded({"answer": 1})
    assert asyncio.run(run("follow", None)).code == "timeout"
    assert asyncio.run(run("hang", "following")).code == "timeout"


def test_an_error_that_clients_read_names_no_place_on_the_server(tmp_path):
    """What a system says holds whole paths; the log keeps them."""
    request = {"do": "lose", "diary": str(tmp_path / "diary")}
    run = JobProcess([sys.executable, ECHO], {}).run(
        {"request": request, "data": str(tmp_path)}, log=tmp_path / "log.txt", report=_nothing, timeout=250
    )
    outcome = asyncio.run(run)
    assert outcome.message == "PermissionError: [Errno 13] Permission denied: 'uploads/u1'"
    assert str(tmp_path) in (tmp_path / "log.txt").read_text()


def test_error_message_with_invalid_characters_is_sanitized(tmp_path):
    """A worker tries to note a job's end until the database takes it."""
    request = {"do": "garble", "diary": str(tmp_path / "diary")}
    run = JobProcess([sys.executable, ECHO], {}).run(
        {"request": request, "data": str(tmp_path)}, log=tmp_path / "log.txt", report=_nothing, timeout=250
    )
    message = asyncio.run(run).message
    assert message.encode()
    assert "\0" not in message
    assert "a\N{REPLACEMENT CHARACTER}b\N{REPLACEMENT CHARACTER}" in message


def test_job_process_runs_at_lower_priority(tmp_path):
    async def run():
        process = JobProcess([sys.executable, ECHO], dict(os.environ))
        payload = {"request": {"do": "succeed", "answer": 1, "diary": str(tmp_path / "diary")}}
        try:
            await process.run(payload, log=tmp_path / "log.txt", report=_nothing, timeout=120)
            return os.getpriority(os.PRIO_PROCESS, process._child.pid)
        finally:
            await process.end()

    assert asyncio.run(run()) > os.getpriority(os.PRIO_PROCESS, 0)
