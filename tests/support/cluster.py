"""A service that is several nodes: real processes in folders of their own that share a database and a store only."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

from steradian.core.settings import Settings
from support import warmed
from support.processes import tree_of
from support.seaweed import free_ports
from support.services import Service
from support.waiting import until

SECRET = "-".join(["nodes", "of", "tests", "know", "this", "and", "no", "log", "does"])


class Node(Service):
    """A node of a role; it comes back at the same address."""

    def __init__(self, folder, role, **settings):
        folder.mkdir(exist_ok=True)
        super().__init__(folder, node_secret=SECRET, **settings)
        self.settings = self.settings.model_copy(update={"port": free_ports(1)[0]})
        self.command = (sys.executable, "-m", "steradian", role)

    def kill(self):
        """End all of its processes as a power cut does."""
        for pid in (self.process.pid, *tree_of(self.process.pid)):
            with suppress(ProcessLookupError):  # it may just have ended
                os.kill(pid, signal.SIGKILL)
        self.process.wait()


class Worker:
    """A worker of another host, with a folder of its own."""

    def __init__(self, folder, name, **shared):
        folder.mkdir(exist_ok=True)
        self.folder, self.name, self.log = folder, name, folder / "worker.log"
        self.settings, self.process = Settings.create(data=folder, **shared), None

    def start(self):
        with self.log.open("ab") as log:
            command = [sys.executable, "-m", "steradian", "worker", "--name", self.name]
            about = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
            self.process = warmed.start(command, env=self.settings.environment(), **about)
        return self

    kill = Node.kill

    def close(self):
        if self.process is not None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(250)


class Cluster:
    """Two API nodes, a node for each scanner, and workers.

    Parameters
    ----------
    scanners
        Name of each, and its port.
    followers
        Workers of each scanner's node.
    """

    def __init__(self, folder, postgres, seaweed, scanners, workers=0, followers=0, **settings):
        self.shared = {"database_url": postgres.database(), "store": seaweed.bucket()}
        self.shared |= {"store_endpoint": seaweed.endpoint} | settings
        self.first, self.second = (Node(folder / name, "api", **self.shared) for name in ("first", "second"))
        self.scanners = {
            name: Node(folder / name, "acquisition", scanner_id=name, scanner=port, workers=followers, **self.shared)
            for name, port in scanners.items()
        }
        self.workers = [Worker(folder / f"far-{n}", f"far-{n}", **self.shared) for n in range(workers)]

    @property
    def nodes(self):
        return [*self.scanners.values(), self.first, self.second]

    def __enter__(self):
        try:
            for each in (*self.nodes, *self.workers):
                each.start()
            for node in (self.first, self.second):  # addresses of scanners are looked at every second
                until(lambda node=node: len(node.get("/scanners").json()["items"]) == len(self.scanners))
            for node in self.nodes:
                until(lambda node=node: node.http.get(f"{node.url}/readyz").is_success, tell=self.said)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for each in (*self.workers, self.second, self.first, *self.scanners.values()):
            each.close()

    def said(self):
        """All that its processes wrote."""
        return "".join(each.log.read_text() for each in (*self.nodes, *self.workers))
