"""``steradian serve`` as a person starts it: real processes, a real port, a data folder."""

import json
import re
import signal
import subprocess
import sys
import uuid

import httpx

from steradian.core.settings import Settings
from support import warmed

WAIT = {"Prefer": "wait=100"}
EQUI = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 60}
"""A mask of 53 points."""


class Service:
    """A running service on a simulated scanner, and a client of its API."""

    command = (sys.executable, "-m", "steradian", "serve")

    def __init__(self, folder, log=None, **settings):
        # on a busy machine a scan's process may be held up for seconds, which few tests are about
        self.settings = Settings.create(data=folder, port=0, **{"resume_within": 10.0} | settings)
        self.folder, self.log = folder, log or folder / "service.log"
        self.process = self.http = None

    def start(self):
        """Start it, again if it has ended; returns it once it has told its address."""
        self._let_go()
        with self.log.open("ab") as log:
            self.process = warmed.start(
                self.command,
                env=self.settings.environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        self.said = next((line for line in iter(self.process.stdout.readline, "") if " at http" in line), None)
        assert self.said, f"the service did not start: {self.log.read_text()[-4000:]}"
        self.url = re.search(r"http://[^/ ]+", self.said)[0]
        self.http = httpx.Client(base_url=f"{self.url}/api/v1", timeout=250)
        return self

    def make(self, path, **body):
        """Ask for something and return it, once it is there or after a while."""
        answer = self.http.post(path, json=body, headers=WAIT | {"Idempotency-Key": uuid.uuid4().hex})
        assert answer.status_code in (200, 201, 202), answer.text
        return answer.json()

    def done(self, path, **body):
        """Ask for work and wait for its success."""
        made = self.make(path, **body)
        while made["state"] in {"queued", "running"}:
            made = self.get(made["links"]["self"], headers=WAIT).json()
        assert made["state"] == "succeeded", made["error"]
        return made

    def get(self, path, **how):
        return self.http.get(path.removeprefix("/api/v1"), **how).raise_for_status()

    def plan(self, count=EQUI["count"], **more):
        """Make a mask and a plan of 256 samples; returns the plan's identifier."""
        mask = self.make("/masks", **EQUI | {"count": count})
        return self.make("/plans", mask_id=mask["id"], samples=256, **more)["id"]

    def start_scan(self, plan_id):
        """Ask for a scan and return it at once."""
        answer = self.http.post("/scans", json={"plan_id": plan_id}, headers={"Idempotency-Key": uuid.uuid4().hex})
        assert answer.status_code == 201, answer.text
        return answer.json()

    def pid_of(self, name):
        """A process of it by the name of its sign of life."""
        return json.loads((self.folder / "run" / f"{name}.json").read_text())["pid"]

    def end(self, number=signal.SIGTERM):
        """Send it a signal; returns its exit status."""
        self.process.send_signal(number)
        code = self.process.wait(250)
        self.close()
        return code

    def close(self):
        """End it, if it was started and has not ended."""
        if self.process is not None:
            self.process.terminate()
            try:
                self.process.wait(250)
            finally:
                self.process.kill()
                self.process.wait()
        self._let_go()

    def _let_go(self):
        """Close the connections to one that has ended."""
        if self.http is not None:
            self.http.close()
        if self.process is not None:
            self.process.stdout.close()
