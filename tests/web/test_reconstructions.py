"""The queue, its form made from the API's schema, results side by side, and names that are markup."""

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from playwright.sync_api import expect

import steradian
from steradian_client import Client
from support.page_modules import modules_of
from support.recordings import INTERVAL, SOUND_SPEED, ball
from support.waiting import until

MARKUP = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script>"


@pytest.fixture(scope="module")
def client(service):
    with Client(service.url) as client:
        yield client


@pytest.fixture(scope="module")
def scan(client):
    """A ball's recording, whose label is markup."""
    traces, positions = ball()
    given = {"sampling_interval": INTERVAL, "sound_speed": SOUND_SPEED}
    return client.imports.import_arrays(traces, positions, labels={"phantom": MARKUP[:60], MARKUP[:50]: "x"}, **given)


@pytest.fixture(scope="module")
def made(client, scan):
    """Two results of it that differ in one parameter."""
    jobs = [client.reconstructions.create(scan.id, modes=24, sound_speed=speed) for speed in (1500.0, 1520.0)]
    return [client.reconstructions.wait(job) for job in jobs]


def test_rerun_form_marks_and_submits_changed_parameters(open_page, service, client, made):
    """The form has the values of the origin in the units a person gives, marks a change, and asks for exactly that."""
    page = open_page(service, f"/reconstructions?again={made[0].id}")
    page.wait_for_selector("[data-field='sound_speed']")
    assert page.input_value("#field-sound_speed") == "1500"
    assert page.locator(".is-changed").count() == 0
    page.fill("#field-sound_speed", "1510")
    page.fill("[data-field='depth_range'] input >> nth=1", "3,5")
    assert "was 1500 m/s" in page.inner_text("[data-field='sound_speed']")
    assert page.locator(".is-changed").count() == 2
    assert "mm" in page.inner_text("[data-field='depth_range']")
    before = {one.id for one in client.reconstructions.list()}
    page.click("#asking button.primary")
    page.wait_for_function("() => document.querySelector('#asking').hidden")
    (again,) = [one for one in client.reconstructions.list() if one.id not in before]
    assert again.parameters["sound_speed"] == 1510
    assert again.parameters["depth_range"] == [None, pytest.approx(3.5e-3)]
    assert again.parameters["modes"] == 24
    page.wait_for_selector(f"[data-row='{again.id}'][data-state='succeeded']")


def test_layers_and_spot_are_asked_for_and_told_with_noise_gain_and_the_command_that_repeats_them(
    open_page, service, client, scan, made, tmp_path
):
    page = open_page(service, f"/reconstructions?again={made[0].id}")
    page.wait_for_selector("[data-field='medium']", state="attached")
    for group in ("More", "Spot"):
        page.locator(f"details[data-group='{group}'] summary").first.click()
    for given in (("1480", "1.5", "", "0.00217", "2"), ("1520", "-2", "", "0.75", "1.5")):
        page.click("[data-field='medium'] button:has-text('Add a layer')")
        for cell, text in zip(
            page.locator("[data-field='medium'] tbody tr").last.locator("input").all(), given, strict=True
        ):
            cell.fill(text)
    page.fill("#field-sound_speed", "")
    page.fill("#field-film-spot-diameter", "0.05")
    page.provoked("status of 422")  # the last layer has a thickness below 0
    page.click("#asking button.primary")
    fault = page.locator("[data-field='medium'] .fault")
    expect(fault).to_contain_text("thickness")
    page.locator("[data-field='medium'] tbody tr").last.locator("[data-part='thickness']").fill("")
    before = {one.id for one in client.reconstructions.list()}
    page.click("#asking button.primary")
    page.wait_for_function("() => document.querySelector('#asking').hidden")
    (again,) = [one for one in client.reconstructions.list() if one.id not in before]
    water, tissue = again.parameters["medium"]
    assert water["thickness"] == pytest.approx(1.5e-3)
    assert tissue == {
        "sound_speed": 1520.0, "thickness": None, "density": None, "attenuation": {"coefficient": 0.75, "power": 1.5}
    }  # fmt: skip
    assert again.parameters["film"]["spot"]["diameter"] == pytest.approx(50e-6)
    page.wait_for_selector(f"[data-row='{again.id}'][data-state='succeeded']")
    page = open_page(service, f"/volumes/{again.id}")
    page.click("[data-tab='Made']")
    expect(page.locator(".noise-gain canvas")).to_have_attribute(
        "aria-label", "noise gain against depth (mm): noise gain"
    )
    command = page.inner_text("[data-command='shell']")
    subprocess.run(
        ["bash", "-e", "-c", command.replace("steradian reconstruct", f"{sys.executable} -m steradian reconstruct")],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        timeout=300,
    )
    repeated, first = steradian.open(tmp_path / again.id), client.reconstructions.volume(again.id)
    np.testing.assert_allclose(repeated.values, first.values, rtol=1e-4, atol=1e-5 * np.abs(first.values).max())


def test_a_frame_is_chosen_of_a_scan_that_has_several(open_page, service, client, scan):
    """By number and excitation wavelength; none is asked for of a scan that has one, and the origin's is kept."""
    plan = service.plan(count=60, pulse_rate=1000, frames=2, excitation=[750e-9, 850e-9])
    several = service.start_scan(plan)["id"]
    until(lambda: service.get(f"/scans/{several}").json()["state"] == "complete")
    page = open_page(service, f"/reconstructions?scan={several}")
    expect(page.locator("#of-frame option")).to_have_text(
        [
            "all 4, as a series",
            "means at each wavelength, as a series",
            "1 of 4, 750 nm",
            "2 of 4, 750 nm",
            "3 of 4, 850 nm",
            "4 of 4, 850 nm",
            "mean of 2 at 750 nm",
            "mean of 2 at 850 nm",
        ]
    )
    page.select_option("#of-scan", scan.id)
    expect(page.locator("#of-frame")).to_be_hidden()
    page.select_option("#of-scan", several)
    expect(page.locator("#of-frame")).to_be_visible()
    page.select_option("#of-frame", label="3 of 4, 850 nm")
    page.fill("#field-modes", "24")
    page.click("#asking button.primary")
    page.wait_for_function("() => document.querySelector('#asking').hidden")
    (made,) = client.reconstructions.list(scan_id=several)
    assert made.frame == 2
    page.goto(f"{service.url}/reconstructions?again={made.id}")
    expect(page.locator("#of-frame option:checked")).to_have_text("3 of 4, 850 nm")
    page.select_option("#of-frame", label="mean of 2 at 850 nm")
    page.click("#asking button.primary")
    page.wait_for_function("() => document.querySelector('#asking').hidden")
    (mean,) = [one for one in client.reconstructions.list(scan_id=several) if one.id != made.id]
    assert (mean.frame, mean.wavelength, mean.average) == (None, pytest.approx(850e-9), True)
    page.goto(f"{service.url}/reconstructions?again={mean.id}")
    expect(page.locator("#of-frame option:checked")).to_have_text("mean of 2 at 850 nm")


def test_every_field_explains_itself(open_page, service, made):
    """Each field has a label, an explanation that is seen with the focus, and its default; advanced ones are folded."""
    page = open_page(service, f"/reconstructions?again={made[0].id}")
    page.wait_for_selector("[data-field='method']")
    assert not page.is_visible("[data-field='conditioning.rim']")
    for summary in page.query_selector_all(".parameters summary"):
        summary.click()
    fields = page.query_selector_all(".field[data-field]")
    assert len(fields) > 35
    for field in fields:
        text = field.query_selector(".explained").text_content()
        assert len(text) > 25, field.get_attribute("data-field")
        assert "Default:" in text
    assert "metres" not in page.inner_text(".help")
    page.focus("#field-conditioning-rim")
    assert "metres" in page.inner_text(".help")


def test_validation_error_is_shown_at_its_field_with_focus(open_page, service, made):
    """What the API finds wrong is told at the field, which has the focus; nothing is queued."""
    page = open_page(service, f"/reconstructions?again={made[0].id}")
    page.wait_for_selector("[data-field='modes']")
    page.fill("#field-modes", "99999")
    page.click("#asking button.primary")
    page.wait_for_selector("#field-modes-fault:not([hidden])")
    assert "at most 4096" in page.inner_text("#field-modes-fault")
    assert page.evaluate("() => document.activeElement.id") == "field-modes"
    refusals = [fault for fault in page.faults if "status of 422" in fault]
    assert len(refusals) == 1, "the browser itself notes what was refused"
    page.provoked("status of 422")


def test_the_queue_can_be_moved_and_cancelled(open_page, service, client, scan):
    """Of jobs that wait behind a long one, one is made to come sooner and one is cancelled, by keyboard."""
    long = client.reconstructions.create(scan.id, modes=600, method="iterative", priority=5)
    waiting = [client.reconstructions.create(scan.id, modes=24 + n, priority=100) for n in (1, 2)]
    page = open_page(service, "/reconstructions")
    try:
        page.wait_for_selector(f"[data-row='{long.id}'][data-state='running']")
        sooner = page.get_by_label(f"Raise the priority: {waiting[1].id}")
        sooner.focus()
        page.keyboard.press("Enter")
        until(lambda: client.reconstructions.get(waiting[1].id).priority == 90)
        page.wait_for_function(
            "(id) => document.querySelector(`[data-row='${id}']`).innerText.includes('90')", arg=waiting[1].id
        )
        rows = page.eval_on_selector_all("[data-row]", "(rows) => rows.map((row) => row.dataset.row)")
        assert rows.index(long.id) < rows.index(waiting[1].id) < rows.index(waiting[0].id)
    finally:
        for one in waiting:
            client.jobs.cancel(one.id)
        page.locator(f"[data-row='{long.id}'] >> text=Cancel").click()
    page.wait_for_selector(f"[data-row='{long.id}'][data-state='cancelled']")


def test_queued_reconstruction_is_listed_despite_newer_ones(open_page, service, made):
    """The newest hundred are not all: here the service answers as if this one were not among them."""
    page = open_page(service, "/healthz")
    old = service.get(f"/reconstructions/{made[0].id}").json() | {"state": "queued", "created": "2026-01-01T00:00:00Z"}

    def answer(route):
        found = route.fetch().json()
        found["items"] = [one for one in found["items"] if one["id"] != old["id"]]
        if "state=queued" in route.request.url:
            found["items"].append(old)
        route.fulfill(json=found)

    page.route("**/api/v1/reconstructions?*", answer)
    page.route(f"**/api/v1/reconstructions/{old['id']}", lambda route: route.fulfill(json=old))
    page.goto(f"{service.url}/reconstructions")
    expect(page.locator(f"[data-row='{old['id']}']")).to_have_attribute("data-state", "queued")


def test_an_image_is_asked_for_again_of_a_scan_that_is_no_longer_listed(open_page, service, scan, made):
    page = open_page(service, "/healthz")
    page.route("**/api/v1/scans?*", lambda route: route.fulfill(json={"items": []}))
    page.goto(f"{service.url}/reconstructions?again={made[0].id}")
    expect(page.locator("#of-scan")).to_have_value(scan.id)


def test_double_click_on_export_sends_one_request(open_page, service, made):
    page = open_page(service, f"/volumes/{made[0].id}")
    asked = []
    page.on("request", lambda one: asked.append(one.url) if one.method == "POST" else None)
    page.get_by_role("tab", name="Files").click()
    page.locator("[data-format='nrrd']").get_by_role("button", name="Create").dblclick()
    expect(page.locator("[data-format='nrrd'] a")).to_have_text("Download", timeout=120_000)
    assert len(asked) == 1


@pytest.fixture
def queue(client, scan):
    """Jobs that wait behind a long one, of equal priority, oldest first; and the long one."""
    long = client.reconstructions.create(scan.id, modes=600, method="iterative", priority=5).id
    waiting = [client.reconstructions.create(scan.id, modes=24 + n).id for n in range(3)]
    until(lambda: client.reconstructions.get(long).state == "running")
    yield long, waiting
    for one in (*waiting, long):
        client.jobs.cancel(one)


def positions(service, waiting):
    """Where the service has jobs in its queue, from 1."""
    return [service.get(f"/jobs/{one}").json()["queue"]["position"] for one in waiting]


def take(page, moved, over):
    """Take a row by its handle and hold it above another one's upper edge."""
    page.get_by_label(f"Move: {moved}").hover()
    page.mouse.down()
    expect(page.locator(f"[data-row='{moved}']")).to_have_class("is-moving")  # from here on no row is drawn anew
    row = page.locator(f"[data-row='{over}']").bounding_box()
    page.mouse.move(row["x"] + 20, row["y"] + 2, steps=5)


def test_a_row_that_is_dragged_begins_where_it_is_put(open_page, service, queue):
    """By mouse before the first that waits, then by an arrow key one further on: the service's own queue says so."""
    _, waiting = queue
    page = open_page(service, "/reconstructions", reduced_motion="reduce")
    page.get_by_label(f"Move: {waiting[2]}").wait_for()
    take(page, waiting[2], waiting[0])
    expect(page.locator(f"[data-row='{waiting[0]}']")).to_have_class("drop-above")
    page.mouse.up()
    until(lambda: positions(service, waiting) == [2, 3, 1])
    page.get_by_label(f"Move: {waiting[2]}").press("ArrowDown")
    until(lambda: positions(service, waiting) == [1, 3, 2])
    expect(page.get_by_label(f"Move: {waiting[2]}")).to_be_focused()
    expect(page.locator("[data-waits]").nth(1)).to_have_attribute("data-row", waiting[2])


def test_a_move_that_is_refused_is_taken_back(open_page, service, client, queue):
    """A job is cancelled by somebody else while its row is held: where it was put the service says no, and why."""
    _, waiting = queue
    page = open_page(service, "/reconstructions")
    page.get_by_label(f"Move: {waiting[2]}").wait_for()
    take(page, waiting[2], waiting[0])
    client.jobs.cancel(waiting[2])
    until(lambda: client.reconstructions.get(waiting[2]).state == "cancelled")
    page.mouse.up()
    expect(page.locator("#reconstructions [role=alert]")).to_contain_text("cancelled")
    expect(page.locator(f"[data-row='{waiting[2]}']")).to_have_attribute("data-state", "cancelled")
    assert positions(service, waiting[:2]) == [1, 2]
    page.provoked("status of 409")  # what is refused


def test_reconstruction_shows_requesting_principal(open_page, service, queue):
    """The name under which the service knows who asked stands in the queue and with the job."""
    (long, _), who = queue, service.get("/session").json()["principal"]
    page = open_page(service, "/reconstructions")
    expect(page.locator(f"[data-row='{long}'] .by")).to_have_text(who)
    page.goto(f"{service.url}/reconstructions/{long}")
    expect(page.locator("dt:text-is('Submitted by') + dd")).to_have_text(who)


def test_priorities_bring_a_job_to_its_place_and_leave_the_others_in_order(chromium, service):
    """For random queues, the order that Python sorts by priority and age; one change, where a number is free."""
    random = np.random.default_rng(5)
    cases = []
    for _ in range(300):
        count = int(random.integers(1, 8))
        cases.append(
            (random.integers(0, random.choice([2, 5, 1001]), count).tolist(), *random.integers(0, count, 2).tolist())
        )
    script = """return given.cases.map(([priorities, moved, place]) =>
        m.priorityChanges(priorities.map((priority, n) => ({ id: String(n), priority })), String(moved), place));"""
    with modules_of(chromium, service) as modules:
        found = modules.call("reconstructions/queue_order.js", script, cases=cases)
    for (priorities, moved, place), changes in zip(cases, found, strict=True):
        wanted = sorted(range(len(priorities)), key=lambda n: (priorities[n], n))
        wanted.remove(moved)
        wanted.insert(place, moved)
        after = dict(enumerate(priorities)) | {int(one["id"]): one["priority"] for one in changes}
        assert sorted(after, key=lambda n: (after[n], n)) == wanted
        assert all(0 <= one <= 1000 for one in after.values())
        rest = sorted(one for n, one in enumerate(priorities) if n != moved)
        if all(later - one > 1 for one, later in pairwise([-1, *rest, 1001])):
            assert {one["id"] for one in changes} <= {str(moved)}, "between any two of the others a number is free"


def test_side_by_side_view_lists_differing_parameters(open_page, service, made):
    """Two results show the same place, and the table says which parameter is another one."""
    page = open_page(service, f"/reconstructions?side={made[0].id},{made[1].id}")
    page.wait_for_function("() => document.querySelectorAll('.message').length === 2")
    page.wait_for_function("() => [...document.querySelectorAll('.message')].every((one) => one.hidden)")
    table = page.inner_text("[data-changes]")
    assert "speed of sound" in table
    assert "1500 m/s" in table
    assert "1520 m/s" in table
    assert "modes" not in table
    page.locator("[data-view]").first.click(position={"x": 30, "y": 30})
    page.wait_for_function("() => location.hash.includes('at=')")
    failed = service.get(f"/reconstructions/{made[1].id}").json() | {"state": "failed"}
    failed["error"] = {"detail": "no memory"}
    page.route(f"**/reconstructions/{made[1].id}", lambda route: route.fulfill(json=failed))
    page.reload()
    expect(page.locator("[data-unusable] li")).to_contain_text(["failed"])
    expect(page.locator("[data-unusable] li")).to_contain_text(["no memory"])
    expect(page.locator("[data-view]")).to_have_count(1)


def test_volume_without_picture_shows_reason(open_page, service, made):
    """One that is on its way, one that does not come and one with nothing in it are no black squares all."""
    first, second = (one.id for one in made)
    page, held = open_page(service, "/healthz"), []
    nothing = {"body": bytes(12), "headers": {"X-Shape": "3,4"}}
    page.route(f"**/reconstructions/{first}/mip*", lambda route: held.append(route))
    page.route(f"**/reconstructions/{second}/mip*", lambda route: route.fulfill(**nothing))
    page.goto(f"{service.url}/volumes")
    expect(page.locator(f"[data-of='{first}'] + span")).to_have_text("loading …")
    expect(page.locator(f"[data-of='{second}'] + span")).to_have_text("empty: no value above 0")
    until(lambda: page.evaluate("1") and held)
    held[0].abort()
    expect(page.locator(f"[data-of='{first}'] + span")).to_have_text("image unavailable")
    page.provoked("net::ERR_FAILED")  # the picture that did not come


@pytest.mark.parametrize(
    "address", ["/reconstructions", "/reconstructions?scan", "/volumes", "/reconstructions/{id}", "/volumes/{id}"]
)
def test_markup_in_names_is_text(open_page, service, made, address):
    """A label that is markup is shown as it was typed, and runs nothing."""
    page = open_page(service, address.format(id=made[0].id))
    page.wait_for_selector("#main *:has-text('modes')" if "{id}" not in address else "#main *:has-text('scan')")
    if address.startswith("/volumes/"):
        expect(page.locator("[data-sample]")).to_contain_text(MARKUP[:60])
        expect(page.locator(".volume-head")).to_contain_text("24 modes")
        page.click("[data-tab='Made']")
        page.wait_for_function("(text) => document.body.innerText.includes(text)", arg=MARKUP[:50])
    if address.endswith("?scan"):
        page.wait_for_selector("#of-scan")
        assert MARKUP[:50] in page.text_content("#of-scan")
    assert "owned" not in page.title()
    assert page.locator("#main img").count() == 0


@pytest.mark.parametrize(
    "text",
    [
        "#map=<img src=x onerror=alert(1)>",
        "?again=%3Cscript%3E",
        "?side=<b>,../x",
        "?again=x&set={%22modes%22:%22<b>%22}",
    ],
)
def test_markup_in_an_address_is_nothing(open_page, service, made, text):
    """What an address says is looked up or left out; it never becomes part of the page."""
    page = open_page(service, f"/reconstructions{text}" if text.startswith("?") else f"/volumes/{made[0].id}{text}")
    page.wait_for_selector("#main button")
    page.wait_for_load_state("networkidle")
    assert page.locator("#main img, #main b, #main script").count() == 0
    page.provoked("status of 404")
    page.provoked("status of 422")
