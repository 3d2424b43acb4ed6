"""Stored requests of earlier forms, and of a newer one."""

import json

import pytest

from steradian.core.exceptions import Conflict
from steradian.jobs import request_versions as forms
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.requests import EXAMPLES, ReconstructionRequest, SoundSpeedRequest, to_job_request
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.storage.db.database import Database, metadata_url
from support.services import Service
from support.waiting import until

FORM_0 = json.loads("""{
 "scan_id": "s1", "parameters": {"method": "nedner", "modes": 16, "upsampling": 1, "depth_range": null,
  "weights": "mask", "sound_speed": null, "tolerance": 0.0001, "window": "kaiser-bessel", "time_padding": 1.0,
  "lateral_padding": 1.0, "iterative": {"regularisation": "total-variation", "strength": null, "non_negative": true,
   "iterations": 30, "change": 0.001, "discrepancy": 1.0, "noise": null, "highest_frequency": null},
  "film": {"kind": "ideal", "max_gain": 10.0, "thickness": 3.8e-05, "speeds": [2200.0, 1100.0], "density": 1289.0,
   "backing_speeds": [2180.0, 910.0], "backing_density": 1200.0},
  "conditioning": {"zero_first": 0, "remove_offset": false, "remove_common": null, "rim": 0.0, "band": null,
   "response": null, "delay": 0.0},
  "display": {"gain_db_per_mm": 0.0, "envelope": false, "log_range_db": null, "non_negative": false}}}
""")
"""A request as it was stored while every parameter was, with the defaults of then."""


def test_today_of_a_request_of_form_0_leaves_out_options_of_the_method_iterative():
    request = ReconstructionRequest.create(**forms.today(FORM_0))
    assert request.parameters == ReconstructionParameters(modes=16, lateral_padding=1.0)
    speeds = {"kind": "sound-speed", "first": 1450, "last": 1550} | FORM_0
    assert SoundSpeedRequest.create(**forms.today(speeds)).parameters == request.parameters


def test_form_0_upgrade_keeps_iterative_options():
    parameters = FORM_0["parameters"] | {"method": "iterative"}
    request = ReconstructionRequest.create(**forms.today(FORM_0 | {"parameters": parameters}))
    assert request.parameters.iterative.regularisation == "total-variation"


def test_job_of_stores_the_form_of_its_request_and_today_reads_it():
    wanted = ReconstructionRequest.create(scan_id="s1", parameters={"method": "iterative"})
    kept = json.loads(json.dumps(to_job_request("r1", wanted).payload))
    assert kept["form"] == forms.FORM
    assert ReconstructionRequest.create(**forms.today(kept)) == wanted
    assert "form" not in forms.asked(kept)


@pytest.mark.parametrize("form", [forms.FORM + 1, -1, "1", None])
def test_unknown_request_form_is_refused_with_form_name(form):
    with pytest.raises(Conflict, match=rf"has form {form!r}; this Steradian reads forms 0 to {forms.FORM}"):
        JOB_TYPES["export"].run(None, EXAMPLES["export"] | {"form": form})


@pytest.mark.long
@pytest.mark.timeout(400)
def test_queued_job_with_form_0_request_succeeds(tmp_path):
    service = Service(tmp_path / "data", log=tmp_path / "log", workers=0).start()
    try:
        scan = service.make("/scans", plan_id=service.plan())["id"]
        until(lambda: service.get(f"/scans/{scan}").json()["state"] == "complete")
        wanted = {"scan_id": scan, "parameters": {"modes": 16}}
        job = service.http.post("/reconstructions", json=wanted).raise_for_status().json()["id"]
    finally:
        service.close()
    database = Database(metadata_url(service.settings))
    with database.write() as session:
        JobLedger(database).lock_row(session, job).payload = FORM_0 | {"scan_id": scan}
    database.close()
    service = Service(tmp_path / "data", log=tmp_path / "log").start()
    try:
        until(lambda: service.get(f"/jobs/{job}").json()["state"] in {"succeeded", "failed"})
        assert service.get(f"/jobs/{job}").json()["error"] is None
    finally:
        service.close()
