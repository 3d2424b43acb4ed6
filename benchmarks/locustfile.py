"""Load test of a running service with locust: readers, submitters, event listeners and misbehaving clients.

Start ``steradian serve`` on a folder that may be thrown away, then for instance
``locust -f benchmarks/locustfile.py --headless -H http://127.0.0.1:8000 -u 210 -r 50 -t 60s --csv load``
(``pip install locust``). Of 210 users 150 read, 50 listen to events, 6 submit reconstructions and 4 misbehave.
STERADIAN_API_KEY is sent as the key.
"""

import os
import random
import socket
import time
from urllib.parse import urlsplit

import requests
from locust import FastHttpUser, HttpUser, between, constant, events, task
from locust.env import Environment

V1 = "/api/v1"
EQUI_STERADIAN = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3}
HEADERS = {"Authorization": f"Bearer {key}"} if (key := os.environ.get("STERADIAN_API_KEY")) else {}
OVERSIZED_BODY = b'{"reason": "' + b"x" * 2**23 + b'"}'
HALF_REQUEST = b"POST /api/v1/masks HTTP/1.1\r\nHost: half\r\nContent-Length: 999\r\n\r\n{"
created: dict[str, list[str]] = {"masks": [], "plans": [], "scans": [], "jobs": []}


@events.test_start.add_listener
def create_resources(environment: Environment, **_: object) -> None:
    """Create 30 masks and plans, a scan of 200 points, and a scan at 1 kHz that lasts about a minute."""

    def send(method: str, path: str, body: object = None, **headers: str) -> dict:
        url = f"{environment.host}{V1}{path}"
        answer = requests.request(method, url, json=body, headers=HEADERS | headers, timeout=60)
        answer.raise_for_status()
        return answer.json()

    def create(kind: str, body: dict[str, object], **headers: str) -> str:
        created[kind].append(send("POST", f"/{kind}", body, **headers)["id"])
        return created[kind][-1]

    for number in range(30):
        mask = create("masks", EQUI_STERADIAN | {"count": 100 + number})
        create("plans", {"mask_id": mask, "samples": 256})
    for count, frames, awaited in ((200, 1, "complete"), (1605, 38, "running")):
        mask = create("masks", EQUI_STERADIAN | {"count": count})
        plan = create("plans", {"mask_id": mask, "samples": 256, "pulse_rate": 1000, "frames": frames})
        scan = create("scans", {"plan_id": plan}, **{"Idempotency-Key": f"locust-{plan}"})
        while (view := send("GET", f"/scans/{scan}"))["state"] != awaited or not view["progress"]["done"]:
            if view["state"] in {"failed", "aborted", "interrupted", "partial"}:
                raise RuntimeError(f"the scan is {view['state']}: {view['error']}")
            time.sleep(0.1)


class Reader(FastHttpUser):
    """Reader of lists, single resources, previews and files, with a pause of half a second in the mean."""

    weight = 150
    wait_time = between(0, 1)
    default_headers = HEADERS

    def read(self, path: str, name: str) -> None:
        """Request a path and count it under a name."""
        self.client.get(f"{V1}{path}", name=name)

    @task(34)
    def lists(self) -> None:
        """Request one of the lists."""
        kind = random.choice(["masks", "plans", "scans", "reconstructions", "jobs"])  # noqa: S311
        self.read(f"/{kind}", f"light: list of {kind}")

    @task(33)
    def one(self) -> None:
        """Request one mask, plan, scan or job."""
        kind = random.choice([kind for kind, known in created.items() if known])  # noqa: S311
        self.read(f"/{kind}/{random.choice(created[kind])}", f"light: one of {kind}")  # noqa: S311

    @task(10)
    def coverage(self) -> None:
        """Request the coverage of the running scan."""
        self.read(f"/scans/{created['scans'][-1]}/coverage", "light: coverage")

    @task(7)
    def preview(self) -> None:
        """Request the preview of a plan."""
        body = {"mask_id": random.choice(created["masks"]), "samples": 256}  # noqa: S311
        self.client.post(f"{V1}/plans/preview", json=body, name="heavy: preview")

    @task(4)
    def picture(self) -> None:
        """Request the picture of a mask."""
        self.read(f"/masks/{random.choice(created['masks'])}/picture", "heavy: picture")  # noqa: S311

    @task(4)
    def alines(self) -> None:
        """Request A-lines of the finished scan."""
        self.read(f"/scans/{created['scans'][0]}/alines?slice=0:20", "heavy: A-lines")


class Submitter(FastHttpUser):
    """Client that submits a small reconstruction every ten seconds."""

    weight = 6
    wait_time = constant(10)
    default_headers = HEADERS

    @task
    def reconstruct(self) -> None:
        """Submit a reconstruction of the finished scan."""
        body = {"scan_id": created["scans"][0], "parameters": {"modes": 64}}
        answer = self.client.post(f"{V1}/reconstructions", json=body, name="submission")
        if answer.status_code == 202:
            created["jobs"].append(answer.json()["id"])


class Listener(HttpUser):
    """Listener of the event stream for half a minute at a time."""

    weight = 50
    wait_time = constant(1)

    @task
    def listen(self) -> None:
        """Read events until half a minute has passed; heartbeats come more often."""
        end = time.monotonic() + 30
        options = {"headers": HEADERS | {"Accept": "text/event-stream"}, "stream": True, "timeout": 60}
        with self.client.get(f"{V1}/events", name="events", catch_response=True, **options) as answer:
            for _ in answer.iter_lines() if answer.ok else ():
                if time.monotonic() > end:
                    break


class Misbehaving(FastHttpUser):
    """Client that sends 8 MiB where a few bytes belong, and requests that it does not finish."""

    weight = 4
    wait_time = constant(5)
    default_headers = HEADERS

    @task
    def send_oversized_body(self) -> None:
        """Send a body that the service must refuse with status 413."""
        headers, name = {"Content-Type": "application/json"}, "misbehaving: body too large"
        with self.client.post(
            f"{V1}/jobs", data=OVERSIZED_BODY, headers=headers, name=name, catch_response=True
        ) as answer:
            if answer.status_code == 413:
                answer.success()

    @task
    def send_half_request(self) -> None:
        """Send half a request and hold the connection for ten seconds."""
        address = urlsplit(self.host)
        with socket.create_connection((address.hostname, address.port or 80), timeout=10) as connection:
            connection.sendall(HALF_REQUEST)
            time.sleep(10)
