"""A job's program for tests: does what its payload says."""

import os
import signal
import time

from steradian.errors import InvalidInput
from steradian.jobs.process import child_main


def work(job, progress):
    payload = job["request"]
    with open(payload["diary"], "a") as diary:
        diary.write(f"{os.getpid()}\n")
    progress("working", 1, 4)
    match payload["do"]:
        case "succeed":
            time.sleep(payload.get("seconds", 0))
            return {"answer": payload["answer"]}
        case "fail":
            raise InvalidInput("depth", -1, "> 0 (m)")
        case "crash":
            raise ZeroDivisionError("oh")
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "hang":
            while True:
                time.sleep(60)


if __name__ == "__main__":
    child_main(work)
