"""The image: what it weighs, that it runs as nobody who can write anything but its data, and what an end leaves."""

import json
import time

import pytest

from support.containers import IMAGE, ROOT, run
from support.services import EQUI
from support.waiting import until

pytestmark = [pytest.mark.container, pytest.mark.timeout(900)]
LARGEST = 300e6
"""Bytes that the image may take on its way."""
INSTALLED = "import importlib.metadata as m; print(*(f'{each.name}={each.version}' for each in m.distributions()))"


def test_others_find_nothing_wrong_with_the_files(tools):
    run(tools / "hadolint", ROOT / "Dockerfile")
    alone = {"scanner", "service"}
    nodes = {"proxy", "first", "second", "acquisition", "worker", "database", "store"}
    for profile, more in {"none": set(), "lab": {"lab"}, "cluster": nodes}.items():
        how = ("--file", ROOT / "compose.yaml", "--profile", profile, "config", "--format", "json")
        assert set(json.loads(run(tools / "docker-compose", *how))["services"]) == alone | more


def test_it_is_small(engine, figures):
    base, *own = (size / 1e6 for size in engine.layers())
    figures["base image, compressed (MB)"], figures["all else, compressed (MB)"] = base, sum(own)
    assert 1e6 * (base + sum(own)) <= LARGEST


def test_its_bill_of_materials_names_all_that_is_installed(service):
    bill = json.loads(service.inside("cat", "/opt/steradian/sbom.cdx.json"))
    named = {(plain(each["name"]), each["version"]) for each in bill["components"]}
    installed = {tuple(each.split("=")) for each in service.inside("python3", "-c", INSTALLED).split()}
    assert named == {(plain(name), version) for name, version in installed}


def plain(name):
    return name.lower().replace("_", "-").replace(".", "-")


def test_container_runs_unprivileged_and_writes_only_data_and_tmp(service):
    lines = service.inside("cat", "/proc/1/status").splitlines()
    status = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    assert status["Uid"].split() == ["10001"] * 4
    assert {status[name] for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {"0" * 16}
    assert status["NoNewPrivs"] == "1"
    writes = "for place in /opt /usr /home /var/tmp /data /tmp; do touch $place/x 2>/dev/null && echo $place; done"
    assert service.inside("sh", "-c", f"{writes}; true").split() == ["/data", "/tmp"]  # noqa: S108


def test_its_health_is_asked_for_at_the_port_it_listens_on(engine, service):
    said = json.loads(engine.podman("image", "inspect", IMAGE))[0]["Healthcheck"]["Test"]
    assert said[0] == "CMD"
    service.inside(*said[1:])
    service.inside("sh", "-c", f"! STERADIAN_PORT=9 {' '.join(said[1:])} 2>/dev/null")


def test_jobs_of_every_kind_find_their_kernels_compiled(service, figures):
    plan = service.plan(count=400)
    scan = service.make("/scans", plan_id=plan)
    assert scan["state"] == "complete"
    begun = time.monotonic()
    first = service.done("/reconstructions", scan_id=scan["id"], parameters={"modes": 64})
    figures["first job (s)"] = time.monotonic() - begun
    begun = time.monotonic()
    service.done("/reconstructions", scan_id=scan["id"], parameters={"modes": 64})
    figures["the same again (s)"] = time.monotonic() - begun
    for kind in ("thresholding", "total-variation", "sparsity", "tikhonov"):
        how = {"modes": 32, "method": "iterative", "iterative": {"regularisation": kind, "iterations": 2}}
        service.done("/reconstructions", scan_id=scan["id"], parameters=how)
    few = service.make("/masks", **EQUI)["id"]
    service.done("/reconstructions", scan_id=scan["id"], through={"mask_id": few}, parameters={"modes": 32})
    service.done("/reconstructions", scan_id=scan["id"], follow=True, parameters={"modes": 32})
    service.done("/jobs", kind="sound-speed", scan_id=scan["id"], first=1450, last=1550, steps=5)
    service.done("/jobs", kind="export", reconstruction_id=first["id"], format="nifti")
    assert service.kernels() == []


def test_a_scan_that_an_end_interrupts_goes_on_in_the_next_container(service, figures):
    plan = service.plan(pulse_rate=1, averages=5)
    scan = service.start_scan(plan)["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "running")
    assert service.end() == 0
    figures["healthy after, second start (s)"] = service.start()
    left = service.get(f"/scans/{scan}").json()
    assert left["state"] == "interrupted", "the laser never starts by itself"
    service.http.put(f"/scans/{scan}/desired-state", json={"state": "running"}).raise_for_status()
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "complete")
    assert service.get(f"/scans/{scan}").json()["summary"]["stored"] == 53
