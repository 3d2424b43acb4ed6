"""The image built and run without a daemon: buildah builds, podman runs by runc, both in a store of their own."""

import json
import shutil
import subprocess
import time
from pathlib import Path

import httpx
import yaml

from support.services import Service
from support.waiting import until

ROOT = Path(__file__).parents[2]
BASE = "docker.io/library/python:3.13-slim"
IMAGE = "localhost/steradian"
DEBIAN = "trixie"
"""The Debian that the base image is made of, whose Python is the same."""
PROGRAMS = ("buildah", "podman", "runc", "debootstrap")
LIMITS = ("--ulimit", "nofile=1024:4096", "--ulimit", "nproc=1000:2000")
"""Below what a machine may allow: podman asks for more than root of a virtual machine has."""
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")


def run(*command, **how):
    """Run a program that has to succeed; returns what it printed."""
    ran = subprocess.run(list(map(str, command)), capture_output=True, text=True, stdin=subprocess.DEVNULL, **how)
    assert ran.returncode == 0, f"{' '.join(map(str, command))}\n{ran.stdout[-2000:]}{ran.stderr[-4000:]}"
    return ran.stdout.strip()


class Engine:
    """Builds the image, and runs what the compose file says with it."""

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        store = ("--root", folder / "store", "--runroot", folder / "run", "--storage-driver", "overlay")
        self._buildah = ("buildah", *store)
        self._podman = (
            *("podman", *store, "--tmpdir", folder / "tmp", "--cgroup-manager", "cgroupfs"),
            *("--events-backend", "file", "--runtime", shutil.which("runc", path="/usr/sbin:/usr/bin")),
        )
        self.compose = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
        self._made = []

    def buildah(self, *command):
        return run(*self._buildah, *command)

    def podman(self, *command):
        return run(*self._podman, *command)

    def build(self):
        """Build the image as an engine would; the base is made here where nobody has fetched it."""
        if BASE not in self.buildah("images", "--format", "{{.Name}}:{{.Tag}}").splitlines():
            self._make_base()
        how = ("--isolation", "chroot", "--format", "docker", "--pull-never")
        self.buildah("bud", *how, "-t", IMAGE, "-f", ROOT / "Dockerfile", ROOT)

    def _make_base(self):
        """Stand in for the Python image: the same Debian with its own Python, and the certificates of this machine."""
        container = self.buildah("from", "scratch")
        root = Path(self.buildah("mount", container))
        run("debootstrap", "--variant=minbase", "--include=ca-certificates,python3,python3-venv", DEBIAN, root)
        for left_out in ("var/cache/apt", "usr/share/doc", "usr/share/man", "usr/share/info", "usr/share/locale"):
            shutil.rmtree(root / left_out, ignore_errors=True)  # as "slim" says
        shutil.copy(CERTIFICATES, root / str(CERTIFICATES).lstrip("/"))
        (root / "usr/local/bin/python3").symlink_to("/usr/bin/python3")
        for compiled in [*root.glob("usr/lib/python3*/**/__pycache__")]:  # as the Python image comes, too
            shutil.rmtree(compiled)
        self.buildah("umount", container)
        told = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8"}
        told |= {"SSL_CERT_FILE": CERTIFICATES, "PIP_CERT": CERTIFICATES}
        environment = [each for name, value in told.items() for each in ("--env", f"{name}={value}")]
        self.buildah("config", *environment, container)
        self.buildah("commit", "--rm", container, BASE)

    def layers(self):
        """Return the bytes of each layer as it is sent over a network, the base first."""
        there = self.folder / "pushed"
        shutil.rmtree(there, ignore_errors=True)
        self.buildah("push", IMAGE, f"oci:{there}:latest")
        index = json.loads((there / "index.json").read_text())
        manifest = there / "blobs" / index["manifests"][0]["digest"].replace(":", "/")
        sizes = [layer["size"] for layer in json.loads(manifest.read_text())["layers"]]
        shutil.rmtree(there)
        return sizes

    def up(self, name, network, volume, **environment):
        """Start a service of the compose file, on a port and with a volume of the test's own; returns its container."""
        said = self.compose[name]
        container = f"{network}-{len(self._made)}"
        self._made.append(container)
        given = said.get("environment", {}) | environment
        flags = [
            *(f"--env={key}={value}" for key, value in given.items()),
            *(f"--publish=127.0.0.1::{port.rpartition(':')[2]}" for port in said.get("ports", ())),
            *(f"--volume={volume}:{each.rpartition(':')[2]}" for each in said.get("volumes", ())),
            *(f"--tmpfs={each}" for each in said["tmpfs"]),
            *(f"--cap-drop={each}" for each in said["cap_drop"]),
            *(f"--security-opt={each.removesuffix(':true')}" for each in said["security_opt"]),
            *(["--read-only", "--read-only-tmpfs=false"] if said["read_only"] else []),
            *(f"--name={container}", f"--network={network}", f"--network-alias={name}"),
        ]
        how = ("--detach", "--pull=never", "--no-healthcheck", *LIMITS, *flags)
        self.podman("run", *how, IMAGE, *said.get("command", ()))
        return container

    def inside(self, container, *command):
        return self.podman("exec", container, *command)

    def end(self, container):
        """Ask a container to end, as an engine does; returns its exit code."""
        self.podman("stop", "--time", "10", container)
        return int(self.podman("inspect", container, "--format", "{{.State.ExitCode}}"))

    def close(self, network, volume):
        for container in self._made:
            self.podman("rm", "--force", container)
        self._made.clear()
        self.podman("network", "rm", "--force", network)
        self.podman("volume", "rm", "--force", volume)


class InContainer(Service):
    """The service of the compose file in a container, and a client of its API."""

    def __init__(self, engine, network, volume):
        self.engine, self._where = engine, (network, volume)
        self.container = self.process = self.http = None

    def start(self, **environment):
        """Start the container, again if it has ended, and wait until it is healthy; returns the seconds that took."""
        self.close()
        begun = time.monotonic()
        self.container = self.engine.up("service", *self._where, **environment)
        address = self.engine.podman("port", self.container, "8000/tcp")
        self.http = httpx.Client(base_url=f"http://{address}/api/v1", timeout=250)
        until(self._is_healthy, tell=lambda: self.engine.podman("logs", self.container)[-4000:])
        took = time.monotonic() - begun
        key = self.engine.inside(self.container, "cat", "/data/admin.key").strip()
        self.http.headers["Authorization"] = f"Bearer {key}"
        return took

    def _is_healthy(self):
        try:
            return self.http.get(self.http.base_url.copy_with(path="/healthz")).status_code == 200
        except httpx.TransportError:
            return False

    def inside(self, *command):
        return self.engine.inside(self.container, *command)

    def kernels(self):
        """Name the kernels that were compiled in this container or an earlier one."""
        return self.inside("find", "/data/cache", "-name", "*.nbc").split()

    def end(self):
        """End it; returns its exit code."""
        code = self.engine.end(self.container)
        self.close()
        return code

    def close(self):
        if self.http is not None:
            self.http.close()
