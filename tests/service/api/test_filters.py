"""A filtered list is the whole list without what does not fit, whatever the page; what is no filter is refused."""

import itertools
import random
from typing import get_args

import numpy as np
import pytest

from steradian.jobs.job import Failed, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import JOB_TYPES
from steradian.masks import Arrangement
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.alines import Aline

from .conftest import EQUI, make_scan

S = ScanState
ENDS = [(S.ARMING,), (S.ARMING, S.RUNNING), (S.ARMING, S.RUNNING, S.STOPPING, S.PARTIAL), (S.ABORTED,), ()]
ODD = ["phantom", 'a"b', "a.b", "$", "[0]", "naïve", "x" * 60, "a&b=c", "%", "' OR 1=1 --"]


def whole(http, path, **params):
    """Every item of a list, page by page."""
    found, url, sent = [], path, {"limit": 3} | params
    while url:
        answer = http.get(url, params=sent)
        assert answer.status_code == 200, answer.text
        found += answer.json()["items"]
        url, sent = answer.links.get("next", {}).get("url"), None
        url = url and url.removeprefix("/api/v1")
    return found


def ids(items):
    return [item["id"] for item in items]


@pytest.fixture(scope="module")
def things(server, http):
    """Masks, plans, scans in every sort of state, and what is made of them."""
    masks = [http.post("/masks", json=EQUI | {"count": count}).json() for count in (50, 55)]
    masks.append(
        http.post("/masks", json={"arrangement": "grid", "aperture": 13.56e-3, "count": 3, "interval": 1e-3}).json()
    )
    plans = [http.post("/plans", json={"mask_id": mask["id"], "samples": 200}).json() for mask in masks[:2]]
    scans, ledger, made = ScanRepository(server.database), JobLedger(server.database), []
    for number, (plan, states) in enumerate(itertools.product(plans, ENDS)):
        scan = make_scan(http, plan["id"]).json()
        labels = {ODD[number]: "yes", "all": str(number % 3), ODD[0]: 'a"b\\'}
        assert http.patch(f"/scans/{scan['id']}", json={"labels": labels}).status_code == 200
        path, measured = server.data.scan_file(scan["id"]), PlanRepository(server.database).load(plan["id"])
        create_scan_file(path, measured, scan_id=scan["id"])
        with ScanFileWriter(path) as store:
            store.append(Aline(at, np.ones(measured.samples, np.int16), at + 1, 0.5) for at in range(5))
        for state in states:
            scans.transition(scan["id"], state, why="test", summary={"stored": 5})
        made.append(scan["id"])
    chosen = random.Random(3)
    usable = [scan["id"] for scan in whole(http, "/scans") if scan["state"] == "partial" and scan["id"] in made]
    for scan_id in usable:
        http.post("/reconstructions", json={"scan_id": scan_id, "parameters": {"modes": 4}})
        through = {"scan_id": scan_id, "parameters": {"modes": 4}, "through": {"mask_id": masks[2]["id"]}}
        assert http.post("/reconstructions", json=through).status_code == 202
        http.post("/jobs", json={"kind": "sound-speed", "scan_id": scan_id, "first": 1450, "last": 1550, "steps": 5})
        for _ in range(8):
            batch = http.post("/batches", json={"scan_id": scan_id, "vary": {"modes": [4, 8, 12]}}).json()
            for job in batch["jobs"][: chosen.randrange(4)]:
                if chosen.random() < 0.3:
                    http.put(f"/jobs/{job['id']}/desired-state", json={"state": "cancelled"})
                    continue
                ledger.start_attempt(job["id"], "w")
                if chosen.random() < 0.8:
                    end = Succeeded({"shape": [4]}) if chosen.random() < 0.6 else Failed("bad", "no")
                    ledger.finish_attempt(job["id"], 1, end, "w")
    return {"masks": masks, "plans": plans, "scans": made, "usable": usable}


def test_scans_are_filtered_by_state_plan_mask_and_label(http, things):
    every = whole(http, "/scans")
    for states in (["partial"], ["aborted", "running"], ["complete"]):
        assert ids(whole(http, "/scans", state=states)) == ids(s for s in every if s["state"] in states)
    plan, mask = things["plans"][0]["id"], things["masks"][1]["id"]
    assert ids(whole(http, "/scans", plan_id=plan)) == ids(s for s in every if s["plan_id"] == plan)
    found = whole(http, "/scans", mask_id=mask, state="queued")
    assert ids(found) == ids(s for s in every if (s["mask_id"], s["state"]) == (mask, "queued"))
    assert found
    assert whole(http, "/scans", mask_id="m1") == []
    assert ids(whole(http, "/scans", label="all")) == ids(s for s in every if "all" in s["labels"])
    two = whole(http, "/scans", label=["all=1", 'phantom=a"b\\'])
    assert ids(two) == ids(s for s in every if s["labels"].get("all") == "1" and s["labels"].get("phantom") == 'a"b\\')
    assert two


@pytest.mark.parametrize("name", ODD[1:])
def test_labels_may_be_called_anything(http, things, name):
    if "=" in name:  # a name ends at the first one
        assert whole(http, "/scans", label=f"{name}=yes") == []
        return
    found = whole(http, "/scans", label=f"{name}=yes")
    assert [scan["labels"][name] for scan in found] == ["yes"]
    assert whole(http, "/scans", label=f"{name}=no") == []


def test_jobs_are_filtered_by_kind_state_scan_and_batch(http, things):
    every = whole(http, "/jobs", limit=100)
    for scan in things["usable"]:
        expected = [job for job in every if job["asked"].get("scan_id") == scan]
        assert ids(whole(http, "/jobs", scan_id=scan)) == ids(expected)
        for state, kind in itertools.product(
            ("queued", "running", "succeeded", "failed", "cancelled"), ("what-if", None)
        ):
            sent = {"scan_id": scan, "state": state} | ({"kind": kind} if kind else {})
            fits = [job for job in expected if job["state"] == state and kind in (None, job["kind"])]
            assert ids(whole(http, "/jobs", **sent)) == ids(fits)
    batch = http.get("/batches", params={"scan_id": things["usable"][0], "limit": 1}).json()["items"][0]
    assert sorted(ids(whole(http, "/jobs", batch_id=batch["id"]))) == sorted(ids(batch["jobs"]))


def test_reconstructions_are_filtered_by_state_kind_scan_batch_and_mask(http, things):
    every = whole(http, "/reconstructions", limit=100)
    of_scan = {scan["id"]: scan["mask_id"] for scan in whole(http, "/scans", limit=100)}
    for mask in things["masks"]:
        fits = [one for one in every if mask["id"] in (one["mask_id"], of_scan[one["scan_id"]])]
        assert ids(whole(http, "/reconstructions", mask_id=mask["id"])) == ids(fits)
        assert fits
    for scan in things["usable"]:
        for state in ("queued", "succeeded"):
            fits = [one for one in every if (one["scan_id"], one["state"]) == (scan, state)]
            assert ids(whole(http, "/reconstructions", scan_id=scan, state=state)) == ids(fits)
            assert fits
        fits = [one for one in every if (one["scan_id"], one["kind"]) == (scan, "what-if")]
        assert ids(whole(http, "/reconstructions", scan_id=scan, kind="what-if")) == ids(fits)
        batch = http.get("/batches", params={"scan_id": scan, "limit": 1}).json()["items"][0]
        assert sorted(ids(whole(http, "/reconstructions", batch_id=batch["id"]))) == sorted(ids(batch["jobs"]))


def test_batches_are_filtered_by_the_state_that_they_show(http, things):
    every, seen = whole(http, "/batches"), set()
    for state in ("queued", "running", "succeeded", "failed", "cancelled", "forgotten"):
        fits = [batch for batch in every if batch["state"] == state]
        assert ids(whole(http, "/batches", state=state)) == ids(fits), state
        seen |= {state} if fits else set()
    assert {"queued", "running", "failed", "cancelled"} <= seen
    both = [batch for batch in every if batch["state"] in ("queued", "failed")]
    assert ids(whole(http, "/batches", state=["queued", "failed"])) == ids(both)


def test_masks_and_plans_are_filtered(http, things):
    grids = [mask for mask in whole(http, "/masks") if mask["arrangement"]["arrangement"] == "grid"]
    assert ids(whole(http, "/masks", arrangement="grid")) == ids(grids) != []
    mask = things["masks"][0]["id"]
    fits = [plan for plan in whole(http, "/plans") if plan["mask_id"] == mask]
    assert ids(whole(http, "/plans", mask_id=mask)) == ids(fits) != []


@pytest.mark.parametrize("path", ["masks", "plans", "scans", "reconstructions", "batches", "jobs", "scanners"])
def test_unknown_filter_returns_422_with_allowed_filters(http, path):
    answer = http.get(f"/{path}", params={"colour": "red"})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, "invalid-input")
    assert (problem["errors"][0]["place"], problem["errors"][0]["pointer"]) == ("query", "colour")
    assert "colour" in problem["detail"]
    for known in ["limit", "before"] if path != "scanners" else []:
        assert known in problem["errors"][0]["allowed"]


@pytest.mark.parametrize(
    ("path", "query", "pointer", "words"),
    [
        ("scans", {"state": "runing"}, "state", "'running'"),
        ("scans", {"state": ["running", "x"]}, "state", "'paused'"),
        ("jobs", {"state": "complete"}, "state", "'succeeded'"),
        ("jobs", {"kind": "exprot"}, "kind", "'export'"),
        ("reconstructions", {"kind": "export"}, "kind", "'what-if'"),
        ("batches", {"state": "done"}, "state", "'forgotten'"),
        ("masks", {"arrangement": "spiral"}, "arrangement", "'equi-steradian'"),
        ("scans", {"label": "=a"}, "label", "pattern"),
        ("scans", {"plan_id": "p" * 65}, "plan_id", "at most 64"),
    ],
)
def test_filter_invalid_value_returns_422_with_allowed_values(http, path, query, pointer, words):
    answer = http.get(f"/{path}", params=query)
    assert answer.status_code == 422, answer.text
    finding = answer.json()["errors"][0]
    assert (finding["place"], finding["pointer"]) == ("query", pointer)
    assert words in finding["allowed"]


def test_misspelt_parameters_are_refused_everywhere(http, mask, scan):
    """Not a whole volume for who wrote slise=0, and not a deletion alone for who wrote dependants=true."""
    assert http.get(f"/scans/{scan['id']}/alines", params={"slise": "0"}).status_code == 422
    assert http.delete(f"/masks/{mask['id']}", params={"dependants": "true"}).status_code == 422
    assert http.get("/events", params={"kinds": "scan"}).status_code == 422


def test_filter_accepts_every_existing_kind(http):
    arrangements = [kind.model_fields["arrangement"].default for kind in get_args(get_args(Arrangement)[0])]
    for path, name, values in (("masks", "arrangement", arrangements), ("jobs", "kind", JOB_TYPES)):
        for value in values:
            assert http.get(f"/{path}", params={name: value, "limit": 1}).status_code == 200
        allowed = http.get(f"/{path}", params={name: "none"}).json()["errors"][0]["allowed"]
        assert allowed.count("'") == 2 * len(values), allowed
