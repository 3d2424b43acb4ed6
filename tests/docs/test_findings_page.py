"""The page of the findings has all that the code can say, and nothing that it does not."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import steradian.jobs
from steradian import ScanPlan, equi_steradian_mask
from steradian.api.schemas.reports import ReportView, SoundSpeedView
from steradian.api.schemas.resources import MaskPreviewView
from steradian.imaging.iterative.base import StopReason
from steradian.plans import Link, ScannerLimits, preview, validation
from steradian.reconstructions.pipeline.run import SHRINKAGE_NOTE
from steradian.reconstructions.shot_normalisation import FLAG_BITS
from steradian.scans.acquisition.resume_checks import Tolerance

ROOT = Path(__file__).parents[2]
MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 100)
JOBS = Path(steradian.jobs.__file__).parent


def tables(page):
    """The page's tables by the heading above them: rows of cells, without the marks of code."""
    found, heading = {}, ""
    for line in (ROOT / "docs" / page).read_text("utf-8").splitlines():
        if line.startswith("#"):
            heading = line.strip("# ")
        elif line.startswith("|") and not line.startswith("|--"):
            cells = line.replace("`", "").strip("| ").split(" | ")
            found.setdefault(heading, []).append([cell.strip() for cell in cells])
    return found


PAGE = tables("findings.md")
REFUSED = {
    "error mask.positions": ({"scanner": ScannerLimits(x=(-5e-3, 8e-3))}, {}),
    "error pulse_rate": ({"scanner": ScannerLimits(pulse_rate=(1, 40))}, {}),
    "error pulse_rate, the link": ({"samples": 2048, "link": Link.serial(921_600)}, {}),
    "error averages": ({"scanner": ScannerLimits(averages=(1, 10)), "averages": 11}, {}),
    "error samples": ({"scanner": ScannerLimits(samples=(16, 512))}, {}),
    "error samples, deeper": ({"samples": 256}, {}),
    "warning samples": ({"samples": 600}, {}),
    "error sampling_interval": ({"scanner": ScannerLimits(sampling_interval=(1e-9, 5e-9))}, {}),
    "error wavelengths": ({"wavelengths": np.full(MASK.count, 1.4e-6)}, {}),
    "warning mask": ({}, {"resolution": 200e-6}),
    "error disk": ({}, {"free_bytes": 1000}),
    "warning disk": ({}, {"free_bytes": 1.1}),
}
"""A plan and a wish that have each finding, and free bytes as a share of the need where that is little."""


def found_in(plan, wish):
    made = ScanPlan.create(mask=MASK, **plan)
    if 1 < wish.get("free_bytes", 0) < 2:
        wish = {"free_bytes": int(wish["free_bytes"] * (preview(made).bytes + 40 * MASK.count))}
    (finding,) = preview(made, **wish).findings
    return finding


@pytest.mark.parametrize("name", REFUSED)
def test_findings_page_lists_plan_finding(name):
    finding = found_in(*REFUSED[name])
    assert name.split(",")[0] == f"{finding.severity} {finding.field}"
    rows = [row for row in PAGE["Plans"] if row[:2] == [finding.severity, finding.field]]
    said = set(re.findall(r"[a-z]{4,}", finding.message))
    alike = [len(said & set(re.findall(r"[a-z]{4,}", row[2]))) for row in rows]
    assert max(alike) >= 2, finding.message


def test_the_page_names_no_other_findings_of_a_plan():
    told = sorted(" ".join(row[:2]) for row in PAGE["Plans"][1:])
    assert told == sorted(name.split(",")[0] for name in REFUSED)
    source = Path(validation.__file__).read_text("utf-8")
    assert source.count("PlanIssue(") == 8, "one that is new has a row on the page, and a plan here"


def test_figures_of_a_mask_and_of_a_report_are_called_so():
    names = {name for row in PAGE["Masks"][1:] for name in row[0].split(", ")}
    assert names <= set(MaskPreviewView.model_fields)
    reported = {row[0].split(".")[0] for row in PAGE["Volumes"][1:] if "(sound speed)" not in row[0]}
    assert reported - {"band"} <= set(ReportView.model_fields)
    speeds = {row[0].partition(" ")[0] for row in PAGE["Volumes"][1:] if "(sound speed)" in row[0]}
    assert speeds <= set(SoundSpeedView.model_fields)


def test_each_end_of_a_fit_and_each_note_of_an_image_is_on_the_page():
    rows = PAGE["Volumes"][1:]
    assert {row[1].partition(":")[0] for row in rows if row[0] == "fit.stopped"} == set(get_args(StopReason))
    notes = [row[1] for row in rows if row[0] == "notes"]
    folder, plan = JOBS.parent / "reconstructions" / "pipeline", JOBS.parent / "imaging" / "plan.py"
    source = "".join(path.read_text("utf-8") for path in (folder / "run.py", folder / "report_notes.py", plan))
    assert source.count("notes.append(") + source.count("yield ") == len(notes)
    assert any(note in SHRINKAGE_NOTE for note in notes)
    assert any(note.startswith("the weights sum to") for note in notes)
    assert "the weights sum to" in source


def test_findings_page_aline_flags_match_scanner_flags():
    flags = [row[0] for row in PAGE["Scans"][1:] if len(row) == 4]
    assert flags == [*FLAG_BITS, "dark"]


def test_a_resumed_scan_is_compared_by_the_figures_that_the_page_has():
    compared = {row[0]: row[1] for row in PAGE["Scans"] if len(row) == 3}
    allowed = Tolerance()
    source = (JOBS.parent / "scans" / "acquisition" / "resume_checks.py").read_text("utf-8")
    said = re.findall(r"""[(f]"(the [A-Za-z' -]+?)(?: at point|", )""", source)
    assert set(said) == set(compared) - {"compared"}
    assert f"±{1e9 * allowed.bias:g} nm" in compared["the bias wavelength"]
    assert f"{1 / allowed.sensitivity:g} to {allowed.sensitivity:g} times" in compared["the film's sensitivity"]
    again = compared["the reference A-line"]
    assert f"at least {allowed.correlation:g}, {1 / allowed.gain:.3f} to {allowed.gain:g} times" in again


def test_why_jobs_fail_is_on_the_page():
    source = "".join(path.read_text("utf-8") for path in JOBS.rglob("*.py"))
    codes = re.findall(r'Failed\("([a-z-]+)"|"code": "([a-z-]+)"|_fail\(row, worker, "([a-z-]+)"', source)
    codes += re.findall(r'_fail\(session, row, worker, "([a-z-]+)"()()', source)
    told = [row[0] for row in PAGE["Failed jobs"][1:]]
    assert set(told) == {code for each in codes for code in each if code}


def test_data_folder_page_inconsistency_kinds_match_code():
    service = JOBS.parent
    source = "".join((service / name).read_text("utf-8") for name in ("runtime/fsck.py", "cli/check.py"))
    told = {row[0] for row in tables("data-folder.md")["A damaged folder"][1:]}
    assert told == set(re.findall(r'Inconsistency\(\s*"([a-z-]+)"', source))
