"""A real service on the simulated scanner, and a real browser on its page.

No test leaves an error on the console or a request to another host: what every page promises is looked at in each.
"""

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright

from support.services import Service

CHROMIUM = shutil.which("chromium-headless-shell") or shutil.which("chromium")
"""Debian's browser, if possible without windows and tabs, which take half of its processor time."""
ARGUMENTS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    " --disable-component-update --disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
    " --renderer-process-limit=1"  # no spare process for each page
).split()
SIZE = {"width": 1280, "height": 720}
WAIT = 200_000.0
"""Milliseconds for which something may take to appear: the machine may be busy."""
expect.set_options(timeout=WAIT)


@pytest.hookimpl
def pytest_collection_modifyitems(items):
    """Whatever stands here is a test in a browser."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker("browser")


@pytest.fixture(scope="session")
def chromium():
    """Debian's browser."""
    if CHROMIUM is None:
        pytest.skip("no chromium: apt-get install chromium-headless-shell, or chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def service(tmp_path_factory):
    """One service for all tests that do not need an empty one."""
    service = Service(tmp_path_factory.mktemp("page")).start()
    yield service
    service.close()


@pytest.fixture
def open_page(chromium):
    """Open pages of a service and watch each: ``open_page(service, "/design")``.

    What a test provokes it names by a part of the words, whenever they come: ``page.provoked("status of 422")``.
    """
    contexts, faults, provoked = [], [], []

    def open_page(service, address="/", **options):
        context = chromium.new_context(**{"viewport": SIZE, "color_scheme": "dark"} | options)
        context.set_default_timeout(WAIT)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: faults.append(f"{page.url}: {said.text}") if said.type == "error" else None)
        page.on("pageerror", lambda error: faults.append(f"{page.url}: {error}"))
        page.on("request", lambda request: faults.append(f"asked {request.url}") if is_elsewhere(request) else None)
        page.faults, page.provoked = faults, provoked.append
        page.goto(service.url + address)
        return page

    def is_elsewhere(request):
        return not request.url.startswith(("http://127.0.0.1:", "data:", "blob:"))

    yield open_page
    for context in contexts:
        for page in context.pages:  # what is on its way would fail the test that comes next
            page.unroute_all(behavior="ignoreErrors")
        context.close()
    assert [fault for fault in faults if not any(part in fault for part in provoked)] == []
