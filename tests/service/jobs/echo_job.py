"""A job's program for tests: does what its payload says."""

import errno
import os
import signal
import time
from pathlib import Path

from steradian.core.exceptions import InvalidInput, NotFound
from steradian.jobs.worker.process import child_main
from steradian.storage.data_dir.job_directory import JobDirectory


def work(job, progress):
    payload = job["request"]
    with open(payload["diary"], "a") as diary:
        diary.write(f"{os.getpid()}\n")
    progress("working", 1, 4)
    match payload["do"]:
        case "succeed":
            time.sleep(payload.get("seconds", 0))
            return {"answer": payload["answer"]}
        case "wait":
            while not Path(payload["until"]).exists():
                time.sleep(0.05)
            return {"answer": payload["answer"]}
        case "follow":
            for _ in range(15):
                time.sleep(0.2)
                progress("following", 1, 4)
            return {"answer": payload["answer"]}
        case "fail":
            raise InvalidInput("depth", -1, "> 0 (m)")
        case "crash":
            raise ZeroDivisionError("oh")
        case "garble":
            raise InvalidInput("dataset", "a\0b\ud800", "a name")
        case "lose":
            raise PermissionError(13, "Permission denied", f"{job['data']}/uploads/u1")
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "lock":
            with JobDirectory(Path(job["job"])).hold_running_lock(timeout=0.5):
                return {"answer": payload["answer"]}
        case "fill":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        case "stale":
            if job["start"] == 1:
                raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
            return {"answer": payload["answer"]}
        case "away":
            from sqlalchemy import create_engine

            if job["start"] == 1:
                create_engine(f"sqlite:///{job['data']}/away/steradian.sqlite").connect()
            return {"answer": payload["answer"]}
        case "read":
            scan = Path(job["data"]) / "scans" / "s1.h5"
            while payload["until_lost"] and job["start"] == 1 and scan.exists():
                time.sleep(0.05)
            if not scan.exists():
                raise NotFound("scan", "s1")
            return {"answer": payload["answer"]}
        case "tell":
            time.sleep(payload.get("seconds", 0))
            return {"start": job["start"]}
        case "count threads":
            from steradian.imaging.compute.thread_pool import available_threads

            return {"threads": available_threads()}
        case "hang":
            while True:
                time.sleep(60)


if __name__ == "__main__":
    child_main(work)
