"""What today's version leaves for the versions to come: ``python tests/service/upgrade/leave.py`` adds an archive.

A folder with a complete scan, two volumes, an upload, a scan that was cut off, and a waiting job of every kind. The
test beside it opens what is kept so, for good; run this once a release, and change no archive that is there.
"""

import json
import os
import shutil
import signal
import sqlite3
import sys
import tarfile
import tempfile
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from steradian.jobs.registry import JOB_TYPES
from steradian.storage.db.database import known_revisions
from support.processes import tree_of
from support.services import Service
from support.waiting import until

DATA = Path(__file__).parent / "data"
MASK = {"arrangement": "equi-steradian", "aperture": 13.56e-3, "depth": 3.6e-3, "count": 16}
MODES = {"modes": 8, "depth_range": [2e-3, 3e-3]}


def leave(folder):
    """Have a service make everything and leave it; returns what it said."""
    service, said = Service(folder / "data", log=folder / "log", simulator_speed=2.0).start(), {}
    masks = [service.make("/masks", **MASK | {"count": count})["id"] for count in (16, 12)]
    plans = [service.make("/plans", mask_id=masks[0], samples=512, **more)["id"] for more in ({}, {"pulse_rate": 1.0})]
    said["whole"] = service.make("/scans", plan_id=plans[0])["id"]
    until(lambda: service.get(f"/scans/{said['whole']}").json()["state"] == "complete")
    made = [
        service.done("/reconstructions", scan_id=said["whole"], parameters=MODES | more)["id"]
        for more in ({}, {"weights": "uniform"})
    ]
    said["volume"] = made[0]
    upload = service.http.post("/uploads", content=(folder / "data" / "scans" / f"{said['whole']}.h5").read_bytes())
    said["upload"], said["upload_bytes"] = upload.json()["id"], upload.json()["bytes"]
    said["running"] = service.start_scan(plans[1])["id"]
    said["stored"] = until(lambda: service.get(f"/scans/{said['running']}").json()["progress"]["done"])
    service.process.send_signal(signal.SIGSTOP)  # or it would start again what is killed
    for pid in [*tree_of(service.process.pid), service.process.pid]:
        os.kill(pid, signal.SIGKILL)
    service.process.wait()
    service = Service(folder / "data", log=folder / "log", workers=0).start()
    asked = {
        "reconstruction": {"scan_id": said["whole"], "parameters": MODES},
        "live": {"scan_id": said["running"], "follow": True, "parameters": MODES},
        "what-if": {"scan_id": said["whole"], "through": {"mask_id": masks[1]}, "parameters": MODES},
        "sound-speed": {"scan_id": said["whole"], "first": 1450, "last": 1550, "steps": 3, "parameters": MODES},
        "quality": {"reconstruction_id": made[0], "reference_id": made[1]},
        "width": {
            "scan_id": said["whole"],
            "reconstruction_id": made[0],
            "start": [-5e-3, 0, 2.7e-3],
            "end": [5e-3, 0, 2.7e-3],
        },
        "export": {"reconstruction_id": made[0], "format": "hdf5"},
        "import": {"upload_id": said["upload"]},
    }
    assert set(asked) == set(JOB_TYPES), "a waiting job of every kind"
    said["jobs"] = {}
    for kind, body in asked.items():
        path = "/reconstructions" if kind in {"reconstruction", "live", "what-if"} else "/jobs"
        answer = service.http.post(path, json=body if path == "/reconstructions" else body | {"kind": kind})
        assert answer.status_code == 202, answer.text
        said["jobs"][kind] = answer.json()["id"]
        assert service.get(f"/jobs/{answer.json()['id']}").json()["kind"] == kind
    said["queued"] = said["jobs"]["reconstruction"]
    service.close()
    return said


def pack(folder, said, name):
    """Write the archive: the data folder without database and pictures, the rows as text, and what was said."""
    data = folder / "data"
    with closing(sqlite3.connect(data / "steradian.sqlite")) as connection:
        (folder / "rows.sql").write_text("\n".join(connection.iterdump()))
    for path in [*data.glob("*.sqlite*"), data / "lock", *data.glob("jobs/*/mip-*"), *data.glob("jobs/*/projections*")]:
        path.unlink()
    for path in ("run", "pictures", "references", "cache"):
        shutil.rmtree(data / path, ignore_errors=True)
    (folder / "said.json").write_text(json.dumps(said, indent=1))
    with tarfile.open(DATA / f"{name}.tar.xz", "x:xz", preset=9) as archive:
        for path in ("data", "rows.sql", "said.json"):
            archive.add(folder / path, path, filter=_of_nobody)


def _of_nobody(about):
    about.uid = about.gid = 0
    about.uname = about.gname = ""
    about.mtime = 0
    return about


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        pack(Path(place), leave(Path(place)), f"{version('steradian')}-{known_revisions()[0]}-embedded")
