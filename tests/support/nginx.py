"""Debian's nginx, with a configuration of its own, as a user's process."""

import re
import shutil
import socket
import ssl
import subprocess
from pathlib import Path

import httpx
import pytest

from support.waiting import until

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
DEPLOY = Path(__file__).parents[2] / "docs" / "deploy.md"
AROUND = """daemon off; pid {folder}/pid; error_log {folder}/error.log; events {{ }}
http {{
access_log {folder}/access.log; client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
fastcgi_temp_path {folder}/fastcgi; uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
{servers}
}}
"""
DEFAULTS = "server {{ listen 127.0.0.1:{port}; location / {{ proxy_pass {url}; {more} }} }}"
"""A proxy as nginx's own manual begins: HTTP/1.0 to the service, the service's own address as Host, no other header."""


def needed():
    """Skip the test where there is no nginx."""
    if NGINX is None:
        pytest.skip("no nginx: apt-get install nginx-light")


def free_port():
    """A port of the loopback that nothing listens on just now."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


class Nginx:
    """A running nginx; ``servers`` are the blocks within ``http``."""

    def __init__(self, folder, servers, port):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.port = folder, port
        configuration = folder / "nginx.conf"
        configuration.write_text(AROUND.format(folder=folder, servers=servers))
        self._said = (folder / "said").open("wb")
        self._process = subprocess.Popen(
            [NGINX, "-p", folder, "-e", folder / "error.log", "-c", configuration],
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=self._said,
        )
        until(self._listens, tell=lambda: f"nginx does not listen: {(folder / 'said').read_text()}")

    def _listens(self):
        assert self._process.poll() is None, (self.folder / "said").read_text()
        try:
            socket.create_connection(("127.0.0.1", self.port), 10).close()
        except OSError:
            return False
        return True

    @property
    def statuses(self):
        """The status of each request that it has answered."""
        return [int(line.split('" ')[1].split()[0]) for line in (self.folder / "access.log").read_text().splitlines()]

    def close(self):
        """End it."""
        self._process.terminate()
        self._process.wait(60)
        self._said.close()

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.close()


def by_default(folder, url, more=""):
    """An nginx with its defaults in front of a service."""
    port = free_port()
    return Nginx(folder, DEFAULTS.format(port=port, url=url, more=more), port)


def documented():
    """The configuration that ``docs/deploy.md`` shows."""
    (block,) = re.findall(r"```nginx\n(.*?)```", DEPLOY.read_text(encoding="utf-8"), re.DOTALL)
    return block


class Laboratory:
    """nginx as ``docs/deploy.md`` shows it, with TLS and the service below a path, but at free ports.

    Parameters
    ----------
    folder
        For its files.
    url
        Of the service.
    changed
        Words of the configuration, and others in their places.

    Attributes
    ----------
    url
        Of the service: ``https://localhost:PORT/steradian``.
    certificate
        File of the certificate, which signs itself.
    """

    def __init__(self, folder, url, **changed):
        folder.mkdir(parents=True, exist_ok=True)
        self.certificate = folder / "steradian.crt"
        make_certificate(folder)
        port, plain = free_port(), free_port()
        text = documented()
        replaced = changed | {
            "127.0.0.1:8000": url.removeprefix("http://"),
            "listen 443 ssl": f"listen 127.0.0.1:{port} ssl",
            "listen 80": f"listen 127.0.0.1:{plain}",
            "/etc/ssl/laboratory": str(folder / "steradian"),
        }
        for old, new in replaced.items():
            assert old in text, old
            text = text.replace(old, new)
        self.nginx = Nginx(folder / "nginx", text, port)
        self.port, self.plain = port, plain
        self.url = f"https://localhost:{port}/steradian"

    @property
    def trust(self):
        """TLS that knows the certificate."""
        return ssl.create_default_context(cafile=self.certificate)

    def client(self, **options):
        """A plain client of the API."""
        return httpx.Client(base_url=f"{self.url}/api/v1", verify=self.trust, timeout=250, **options)

    def close(self):
        """End it."""
        self.nginx.close()


def make_certificate(folder):
    """Have openssl make a key and a certificate for ``localhost`` that signs itself."""
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    files = ["-keyout", folder / "steradian.key", "-out", folder / "steradian.crt"]
    kind = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    subprocess.run(["openssl", "req", "-x509", *kind, *subject, *files], check=True, capture_output=True)
