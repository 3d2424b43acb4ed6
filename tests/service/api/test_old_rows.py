"""What an earlier version noted is shown by this one, as far as it goes, and never as a failure."""

import httpx
import pytest
from sqlalchemy import update

from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.storage.db.tables import JobRow, PlanRow, ScanRow

EARLIER = {
    "reconstruction": {
        "files": ["volume.h5"],
        "sensors": 60,
        "fit": {"iterations": 4},
        "missing": [1, 2],
        "shots": "ok",
    },
    "sound-speed": {"best": 1502.0, "sharpness": [1, 2], "edge": False},
    "quality": {"correlation": 0.5},
    "export": {},
    "import": {"scan_id": "s1"},
}
"""Results with less, other and differently written members than today's."""


@pytest.mark.parametrize("kind", EARLIER)
def test_a_job_that_ended_under_an_earlier_version_is_shown(server, http, scan_with_alines, kind):
    job, ledger = scan_with_alines["reconstruction"]["id"], JobLedger(server.database)
    ledger.start_attempt(job, "w")
    ledger.finish_attempt(job, 1, Succeeded({"shape": [1, 2, 3]}), "w")
    earlier = EARLIER[kind] | {"odd": {"er": [1]}}
    attempt = {"number": 1, "worker": "w", "started": "2025-01-01T00:00:00+00:00"}
    change = {"state": "succeeded", "at": "2025-01-01T00:00:00+00:00"}
    with server.database.write() as session:
        about = {"kind": kind, "result": earlier, "attempts": [attempt], "history": [change]}
        session.execute(update(JobRow).where(JobRow.id == job).values(**about))
    shown = http.get(f"/jobs/{job}")
    assert shown.status_code == 200, shown.text
    assert shown.json()["result"]["odd"] == {"er": [1]}, "what is not known is passed on"
    for name in ("best", "sensors", "scan_id"):
        assert shown.json()["result"].get(name) == earlier.get(name)
    assert shown.json()["history"][0]["state"] == "succeeded"
    assert http.get(f"/jobs/{job}/attempts").json()["items"][0]["outcome"] is None
    assert job in [one["id"] for one in http.get("/jobs").json()["items"]]
    assert job in [one["id"] for one in http.get("/reconstructions").json()["items"]]
    assert http.get(f"/reconstructions/{job}").status_code == 200


@pytest.mark.parametrize(
    "attempts",
    [
        [],
        [{"number": 1, "worker": "w", "started": "2025-01-01T00:00:00+00:00"}],
        [{"number": 1, "worker": "w", "started": "2025-01-01T00:00:00+00:00", "ended": None}],
    ],
    ids=["none", "without its end", "not ended"],
)
def test_queue_and_metrics_tolerate_jobs_without_recorded_time(server, http, scan_with_alines, attempts):
    job, ledger = scan_with_alines["reconstruction"]["id"], JobLedger(server.database)
    ledger.start_attempt(job, "w")
    ledger.finish_attempt(job, 1, Succeeded({"shape": [1, 2, 3]}), "w")
    with server.database.write() as session:
        session.execute(update(JobRow).where(JobRow.id == job).values(attempts=attempts))
    about = {"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 40}}
    waiting = http.post("/reconstructions", json=about).json()["id"]
    shown = http.get(f"/jobs/{waiting}")
    assert shown.status_code == 200, shown.text
    assert shown.json()["queue"]["position"] >= 1
    figures = httpx.get(f"{server.url}/metrics", timeout=250)
    assert figures.status_code == 200, figures.text
    assert "steradian_jobs_waiting_oldest_seconds" in figures.text


def test_plans_and_scans_of_an_earlier_version_are_shown(server, http, mask, scan):
    plan = http.post("/plans", json={"mask_id": mask["id"], "samples": 263}).json()  # read by nobody before
    old = {"seconds": {"laser": 1.5}, "laser_seconds": 1.5, "limiting": "camera", "findings": ["slow"]}
    with server.database.write() as session:
        session.execute(update(PlanRow).where(PlanRow.id == plan["id"]).values(preview=old))
        session.execute(update(ScanRow).where(ScanRow.id == scan["id"]).values(summary={"points": "many", "ok": 3}))
    shown = http.get(f"/plans/{plan['id']}").json()["preview"]
    assert (shown["seconds"], shown["limiting"], shown["bytes"]) == ({"laser": 1.5}, None, None)
    assert http.get(f"/scans/{scan['id']}").json()["summary"]["ok"] == 3
    for noun in ("plans", "scans"):
        assert http.get(f"/{noun}").status_code == 200
    with server.database.write() as session:
        session.execute(update(PlanRow).where(PlanRow.id == plan["id"]).values(preview=plan["preview"]))
