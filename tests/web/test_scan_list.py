"""List of scans and counts of one: a survey is no complete scan, what is unknown is left out, dots are seen."""

import re

import pytest
from playwright.sync_api import expect

from support.waiting import until

LUMINANCE = """(name) => {
  const probe = document.createElement("i");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const [r, g, b] = getComputedStyle(probe).color.match(/[0-9.]+/g).map((one) => one / 255).map(
    (one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}"""


@pytest.fixture(scope="module")
def scan(service):
    """A complete scan, of the API."""
    scan = service.start_scan(service.plan(count=150))["id"]
    until(lambda: service.get(f"/scans/{scan}").json()["state"] == "complete")
    return service.get(f"/scans/{scan}").json()


def show(page, service, scans, excitation=()):
    """Show a list of these scans, whose plans have wavelengths in m."""

    def plan(route):
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"excitation": list(excitation)})

    page.route("**/api/v1/scans?limit=100", lambda route: route.fulfill(json={"items": scans}))
    page.route("**/api/v1/plans/*", plan)
    page.goto(f"{service.url}/scans")


@pytest.mark.parametrize(
    ("state", "stages", "text"),
    [
        ("complete", None, "complete"),
        ("partial", ["made", "proposed"], "stopped, survey only"),
        ("aborted", ["made", "planned"], "aborted, survey only"),
        ("complete", ["made", "made"], "complete"),
    ],
)
def test_survey_without_focus_is_no_complete_scan(service, open_page, scan, state, stages, text):
    first = {"number": 1, "points": 150, "decision": None, "points_of_interest": [], "proposals": [], "decided_by": ""}
    made = stages and [first | {"number": n, "state": one} for n, one in enumerate(stages)]
    page = open_page(service, "/data")
    show(page, service, [scan | {"state": state, "stages": made, "simulated": False}])
    expect(page.locator("tbody tr td").nth(2)).to_have_text(text)
    depth = page.locator("tbody tr td").nth(4)
    expect(depth).to_have_text("none" if "survey" in text else re.compile(r"mm$"))


def test_wavelengths_have_column_only_where_plan_has_any(service, open_page, scan):
    page = open_page(service, "/data")
    show(page, service, [scan])
    expect(page.locator("tbody tr")).to_contain_text("mm")
    assert page.get_by_role("columnheader", name="Wavelengths").count() == 0
    page.unroute_all(behavior="wait")
    show(page, service, [scan], excitation=(750e-9, 850e-9))
    expect(page.get_by_role("columnheader", name="Wavelengths")).to_be_visible()
    expect(page.locator("tbody tr")).to_contain_text(re.compile(r"750, 850\snm"))


def test_counts_of_zero_are_not_shown(service, open_page, scan):
    page = open_page(service, f"/scans/{scan['id']}")
    expect(page.locator("[data-filter=stored]")).to_have_text(f"stored {scan['summary']['stored']}")
    expect(page.locator("[data-filter=missing]")).to_be_hidden()


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_points_to_come_have_contrast(service, open_page, theme):
    """At least 3:1 against the panel and the button on which they are (WCAG 2.2, 1.4.11)."""
    page = open_page(service, "/data", color_scheme=theme)
    missing, *grounds = (page.evaluate(LUMINANCE, name) for name in ("--missing", "--panel", "--raised"))
    for ground in grounds:
        high, low = sorted((missing, ground), reverse=True)
        assert (high + 0.05) / (low + 0.05) >= 3
