"""Signals of a scan on its page: figures, marks on the map, keys, and what is read again while the scan runs.

The answers are made here, with bad A-lines at known places, so that what is shown has a truth of its own.
"""

import pytest
from playwright.sync_api import expect

from support.waiting import until

KINDS = {3: "dead", 17: "saturated", 29: "dead", 40: "inverted"}
MENDS = {"dead": "leave-out", "saturated": "leave-out", "inverted": "sign"}
MARKED = """window.marks = []; const fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y) { if ('×□▽'.includes(text))
  window.marks.push([text, x, y]); return fill.call(this, text, x, y); };"""


@pytest.fixture
def scan(service):
    """A scan that is complete, and where its sensors are in metres."""
    made = service.start_scan(service.plan(pulse_rate=50))
    until(lambda: service.get(f"/scans/{made['id']}").json()["state"] == "complete")
    return made["id"], service.get(f"/masks/{made['mask_id']}/points").json()["positions"]


def signals(places, kinds=KINDS, **more):
    """An answer of the service about a scan with these bad A-lines."""
    x, y = [place[0] for place in places], [place[1] for place in places]
    flat = [1.0] * len(places)
    bad = [
        {"aline": n, "x": x[n], "y": y[n], "kind": kind, "detail": "as made", "mend": MENDS[kind]}
        for n, kind in kinds.items()
    ]
    return {
        "alines": len(places),
        "samples": 256,
        "sampling_interval": 8e-9,
        "looked_at": len(places),
        "complete": True,
        "histogram": {
            "kind": "codes",
            "edges": [-128, -64, 0, 64, 128],
            "counts": [10, 5000, 6000, 30],
            "clipped_low": 0,
            "clipped_high": 12,
            "missing_codes": 4,
            "mid_scale_offset": -0.4,
        },
        "spectrum": {"frequencies": [0.0, 1e6, 2e6], "mean": [1.0, 4.0, 2.0], "median": [1.0, 3.0, 2.0]},
        "maps": {"x": x, "y": y, "power": [float(n) for n in range(len(x))], "baseline_mean": flat}
        | {"baseline_variance": flat, "arrival": [None, *[1.5e-6] * (len(x) - 1)]},
        "beams": [{"beam": 0, "alines": len(places), "power": 2.5, "baseline": -0.25}],
        "frames": [{"frame": 0, "alines": len(places), "power": 2.5, "baseline": -0.25}],
        "bad": bad,
    } | more


def shown(open_page, service, scan, answer, **options):
    """The page of a scan with its signals open."""
    page = open_page(service, "/scans", **options)
    page.add_init_script(MARKED)
    page.route("**/signals", lambda route: route.fulfill(json=answer() if callable(answer) else answer))
    page.goto(f"{service.url}/scans/{scan}")
    page.locator("section.signals summary").first.press("Enter")
    return page


def test_signals_figures_equal_the_answers(service, open_page, scan):
    identifier, places = scan
    page = shown(open_page, service, identifier, signals(places))
    part = page.locator("section.signals")
    expect(part.locator("[data-total]")).to_contain_text(
        f"4 of {len(places)} A-lines are bad: 2 dead, 1 saturated, 1 inverted. No A-line is excluded"
    )
    for kind, numbers in {"dead": ["3", "29"], "saturated": ["17"], "inverted": ["40"]}.items():
        group = part.locator(f"details[data-kind={kind}]")
        group.locator("summary").press("Enter")
        expect(group.locator("button")).to_have_text(numbers)
    expect(part.locator("[data-facts]")).to_contain_text("12 at the high end; 4 digitiser codes missing")
    expect(part.locator("rect.clipped")).to_have_count(1)
    expect(part.locator("[data-table=beam] tbody td")).to_have_text(["0", str(len(places)), "2.5", "−0.25"])
    expect(part.locator(".chart")).to_have_attribute(
        "aria-label",
        "Noise against frequency, mean and median of the A-lines, up to 2 MHz; the mean is greatest at 1 MHz",
    )
    part.get_by_label("Map", exact=True).select_option("Arrival")
    expect(part.locator(".field-map .legend")).to_contain_text("µs")


def test_signals_marks_are_at_the_bad_alines_places(service, open_page, scan):
    """Distances between marks have the ratio of the distances between the sensors, x to the right and y up."""
    identifier, places = scan
    page = shown(open_page, service, identifier, signals(places))
    expect(page.locator("section.signals [data-mark]")).to_have_count(3)
    until(lambda: page.evaluate("window.marks.length") >= len(KINDS))
    marks = page.evaluate(f"window.marks.slice(-{len(KINDS)})")
    assert [mark[0] for mark in marks] == ["×", "□", "×", "▽"]
    first, second = marks[0], marks[3]
    scale = (second[1] - first[1]) / (places[40][0] - places[3][0])
    for (_, across, down), number in zip(marks, KINDS, strict=True):
        assert across - first[1] == pytest.approx(scale * (places[number][0] - places[3][0]), abs=0.5)
        assert first[2] - down == pytest.approx(scale * (places[number][1] - places[3][1]), abs=0.5)


def test_signals_map_keys_tell_and_show_bad_alines(service, open_page, scan):
    identifier, places = scan
    page = shown(open_page, service, identifier, signals(places))
    canvas = page.locator("section.signals canvas[role=application]")
    canvas.focus()
    page.keyboard.press("ArrowRight")
    said = page.locator("section.signals output")
    expect(said).to_contain_text("A-line 3 at x")
    page.keyboard.press("ArrowRight")
    expect(said).to_contain_text("saturated; as made; can be excluded")
    page.keyboard.press("Enter")
    expect(page.locator("section.trace")).to_contain_text("Selected, point 17")
    page.keyboard.press("Escape")
    expect(said).not_to_contain_text("A-line")


def test_signals_of_a_running_scan_are_read_again_while_open(service, open_page):
    made = service.start_scan(service.plan(pulse_rate=1, averages=24))
    until(lambda: service.get(f"/scans/{made['id']}").json()["progress"]["done"] >= 2)
    places = service.get(f"/masks/{made['mask_id']}/points").json()["positions"]
    asked = []

    def answer():
        asked.append(1)
        return signals(places, dict(list(KINDS.items())[: len(asked)]), looked_at=10 * len(asked), complete=False)

    page = shown(open_page, service, made["id"], answer)
    said = page.locator("section.signals [data-total]")
    expect(said).to_contain_text(f"1 of 10 of {len(places)} A-lines so far is bad: 1 dead.")
    expect(said).to_contain_text(f"2 of 20 of {len(places)} A-lines so far are bad: 1 dead, 1 saturated.")
    page.locator("section.signals summary").first.click()
    service.http.put(f"/scans/{made['id']}/desired-state", json={"state": "stopped"}).raise_for_status()
    until(lambda: service.get(f"/scans/{made['id']}").json()["state"] == "partial")
    expect(page.get_by_role("button", name="Reconstruct", exact=True)).to_be_visible()
    assert len(asked) == 2, "what is closed asks nothing"


def test_signals_that_are_refused_say_why_and_are_tried_again(service, open_page, scan):
    identifier, places = scan
    page = open_page(service, "/scans")
    problem = {"title": "Not there", "detail": "there is no A-line yet", "code": "missing"}
    page.route("**/signals", lambda route: route.fulfill(status=404, json=problem))
    page.goto(f"{service.url}/scans/{identifier}")
    page.locator("section.signals summary").first.click()
    expect(page.locator("section.signals .failed")).to_contain_text("there is no A-line yet")
    page.unroute_all()
    page.route("**/signals", lambda route: route.fulfill(json=signals(places, {})))
    page.get_by_role("button", name="Try again").click()
    expect(page.locator("section.signals [data-total]")).to_contain_text(f"0 of {len(places)} A-lines")
    page.provoked("status of 404")


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_signals_fit_the_width_of_a_telephone(service, open_page, scan, theme):
    identifier, places = scan
    size = {"width": 390, "height": 844}
    page = shown(open_page, service, identifier, signals(places), viewport=size, color_scheme=theme)
    expect(page.locator("section.signals [data-facts]")).to_be_visible()
    expect(page.locator("section.signals .plot")).to_be_visible()
    assert page.evaluate("document.querySelector('main').scrollWidth") <= 390


def test_signals_answered_by_the_service_are_shown(service, open_page, scan):
    """Nothing is answered here: the page shows what the inspection of the simulated scan says."""
    identifier, places = scan
    answer = service.get(f"/scans/{identifier}/signals").json()
    page = open_page(service, f"/scans/{identifier}")
    page.locator("section.signals summary").first.press("Enter")
    part = page.locator("section.signals")
    bad = sum(answer["bad_counts"].values())
    expect(part.locator("[data-total]")).to_contain_text(f"{bad} of {len(places)} A-lines")
    undecided = " Inverted and shifted A-lines cannot be detected" in part.locator("[data-total]").inner_text()
    assert undecided is not answer["decidable"]
    clipped = answer["histogram"]["clipped_high"]
    expect(part.locator("[data-facts]")).to_contain_text(f"{clipped} at the high end")
    expect(part.locator("[data-table=beam] tbody tr")).to_have_count(len(answer["beams"]))
    expect(part.locator("[data-table=frame] tbody td").nth(1)).to_have_text(str(len(places)))
    for kind, number in answer["bad_counts"].items():
        expect(part.locator(f"details[data-kind={kind}] summary")).to_contain_text(str(number))
