"""The page beside another program that fires on the scanner's port, and a fault that its interlock latches."""

import os
import re
import sys

import pytest
from playwright.sync_api import expect

from fabry_perot.simulator import launch
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from support import warmed
from support.services import Service
from support.waiting import until

AT_REST = re.compile(r"\b(off|idle)\b")


@pytest.fixture(scope="module")
def scanner():
    with launch() as simulator:
        yield simulator


@pytest.fixture(scope="module")
def lab(scanner, tmp_path_factory):
    lab = Service(tmp_path_factory.mktemp("lab"), scanner=scanner.url, workers=0).start()
    yield lab
    lab.close()


@pytest.fixture
def other(scanner, tmp_path):
    """``steradian scan run`` on the same port, which has begun to fire."""
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=900)
    plan = tmp_path / "plan.json"
    write_json(ScanPlan.create(mask=mask, samples=256, pulse_rate=20.0), plan)
    command = [sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url]
    program = warmed.start([*command, "-o", str(tmp_path / "scan.h5")], env=dict(os.environ), stdout=-3, stderr=-3)
    until(lambda: scanner.send_command("report", fired=False)["shutter"])
    yield program
    program.terminate()
    program.wait(60)


def test_page_shows_other_program_that_fires_and_stops_it(lab, scanner, open_page, other):
    page = open_page(lab, "/data")
    pill = page.locator("#scanner")
    expect(pill).to_contain_text(re.compile(r"in use by .*process \d+"))
    expect(pill).to_contain_text("laser on")
    assert not AT_REST.search(page.locator("header").inner_text())
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#stopped")).to_contain_text("laser off (confirmed by the device")
    assert not scanner.send_command("report", fired=False)["shutter"]
    lab.http.delete("/scanners/scanner-0/emergency-stop")


def test_fault_on_page_is_named_blocks_resume_and_can_be_cleared(lab, scanner, open_page):
    until(lambda: lab.get("/scanners/scanner-0").json()["connection"] == "connected")
    scan = lab.start_scan(lab.plan(300, pulse_rate=20))["id"]
    page = open_page(lab, f"/scans/{scan}")
    expect(page.locator("#scanner")).to_contain_text("laser on")
    scanner.send_command("interlock", closed=False)
    faults = page.locator("#faults")
    expect(faults).to_contain_text(re.compile("interlock", re.IGNORECASE))
    assert "fault 1" not in page.locator("body").inner_text()
    expect(page.locator("section.head")).to_contain_text("interrupted")
    page.get_by_role("button", name="Clear the fault …").click()
    page.get_by_label("Action taken").fill("nothing yet")
    page.get_by_role("button", name="Clear the fault", exact=True).click()
    expect(page.get_by_role("dialog").get_by_role("alert")).to_contain_text("the interlock is open")
    scanner.send_command("interlock", closed=True)
    expect(page.locator("#scanner")).to_contain_text("interlock closed")
    page.get_by_label("Action taken").fill("the enclosure is closed")
    page.get_by_role("button", name="Clear the fault", exact=True).click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(faults).to_be_hidden()
    page.get_by_role("button", name="Resume").click()
    expect(page.locator("section.head")).to_contain_text("running")
    page.provoked("status of 409")  # the fault that stood
    lab.http.post("/emergency-stop")
    lab.http.delete("/scanners/scanner-0/emergency-stop")
