"""The whole way of a first user, with nothing but the page: from a ball under the scanner to its width and a NIfTI."""

import math
import re

import nibabel
import numpy as np
import pytest
from playwright.sync_api import expect

from fabry_perot.simulator import launch
from steradian.quality.resolution import direct_fwhm
from steradian_client import Client
from support.services import Service
from support.views import VIEWS, brightest_pixel, crosshair, drag, drawn, figure, pixel_of, spacing
from support.waiting import until

PLACE = (0.3, -0.15, 1.2)
"""Of the ball that the scanner sees, in mm."""
SIGMA = 0.2
FWHM = 2 * math.sqrt(2 * math.log(2)) * SIGMA
DESIGN = {"aperture": 9.6, "count": 1400, "depth": 2, "pulse_rate": 6, "samples": 640}
"""What is typed into the form, in the units beside its fields."""


@pytest.fixture
def service(tmp_path):
    """An empty service on a scanner under which the ball lies; 20 times faster than real."""
    phantom = tmp_path / "ball.npz"
    np.savez(phantom, centres=1e-3 * np.array([PLACE]), sigmas=[1e-3 * SIGMA], amplitudes=[1.0])
    with launch(tcp="127.0.0.1:0", phantom=str(phantom), speed=20, noise_db=40) as scanner:
        service = Service(tmp_path / "data", log=tmp_path / "log", scanner=scanner.url).start()
        yield service
        service.close()


def test_from_an_empty_service_to_the_width_of_a_ball_and_a_nifti(service, open_page, tmp_path):
    page = open_page(service, "/")
    scan = design(page, service)
    live = watch(page, service, scan)
    reconstruction = reconstruct(page, service)
    with Client(service.url) as client:
        volume = client.reconstructions.volume(reconstruction)
    look(page, volume)
    measure(page, volume)
    download(page, volume, tmp_path / "volume.nii.gz")
    assert live != reconstruction
    page.context.close()


def design(page, service):
    """Say what is scanned; returns the scan."""
    expect(page).to_have_url(re.compile("/design"))
    for name, value in DESIGN.items():
        page.locator(f"#field-{name}").fill(str(value))
    page.get_by_label("Name of the sample").fill("ball")
    button = page.get_by_role("button", name="Scan this")
    expect(button).to_be_enabled()
    assert service.get("/masks").json()["items"] == [], "nothing is stored before one asks"
    button.click()
    expect(page).to_have_url(re.compile("/scans/s"))
    (scan,) = service.get("/scans").json()["items"]
    return scan["id"]


def watch(page, service, scan):
    """Hold the scan, see what there is of its image, and let it end; returns the image's reconstruction."""
    expect(page.locator(".label", has_text="sample: ball")).to_be_visible()
    until(lambda: service.get(f"/scans/{scan}").json()["progress"]["done"] >= 200)
    page.get_by_role("button", name="Pause").click()
    canvas = page.locator("section.image canvas")
    expect(canvas).to_be_visible()
    (live,) = service.get(f"/reconstructions?kind=live&scan_id={scan}").json()["items"]
    grown = service.get(f"/reconstructions/{live['id']}/revision").json()
    assert not grown["final"]
    assert 0 < grown["coverage"]["points"] < 1
    assert brightest_pixel(canvas) is not None
    page.get_by_role("button", name="Resume").click()
    expect(page.get_by_role("button", name="Reconstruct", exact=True)).to_be_visible()
    seen = service.get(f"/scans/{scan}/coverage").json()
    assert (seen["stored"], seen["missing"]) == (seen["points"], 0)
    expect(page.locator("[data-filter=stored]")).to_have_text(f"stored {seen['stored']:,}")
    expect(page.locator("section.image").get_by_role("link", name="Open the volume")).to_be_visible()
    raw = {"Accept": "application/octet-stream"}
    told = service.get(f"/reconstructions/{live['id']}/mip?axis=z&dtype=float32", headers=raw).headers
    shape, step = ([float(one) for one in told[name].split(",")] for name in ("X-Shape", "X-Spacing"))
    extent = [1e3 * count * one for count, one in zip(shape, step, strict=True)]
    shown = brightest_pixel(canvas)
    place = (extent[0] * (shown["x"] / shown["width"] - 0.5), extent[1] * (0.5 - shown["y"] / shown["height"]))
    assert place == pytest.approx(PLACE[:2], abs=0.15)
    return live["id"]


def reconstruct(page, service):
    """Ask for the image with the defaults and go to its volume; returns its identifier."""
    page.get_by_role("button", name="Reconstruct", exact=True).click()
    expect(page).to_have_url(re.compile("/reconstructions/r"))
    page.get_by_role("link", name="Open the volume").click()
    expect(page).to_have_url(re.compile("/volumes/r"))
    drawn(page)
    return page.evaluate("location.pathname.split('/').pop()")


def look(page, volume):
    """Crosshair and brightest pixels of all three views are at the ball."""
    assert crosshair(page) == pytest.approx(PLACE, abs=0.06)
    for view in VIEWS:
        seen = brightest_pixel(page.locator(f"[data-image='{view}']"))
        assert (seen["x"], seen["y"]) == pytest.approx(pixel_of(page, volume, view, PLACE), abs=5)


def measure(page, volume):
    """The profile tool's full width is the ball's within 15 %, and the library's of the same voxels within 3 %."""
    page.get_by_role("button", name="Slices").click()
    page.keyboard.press("2")
    drag(page, "x–y", *(pixel_of(page, volume, "x–y", (PLACE[0] + side, *PLACE[1:])) for side in (-1.5, 1.5)))
    page.wait_for_selector("[data-figure='fwhm']")
    width = figure(page, "fwhm")
    assert width == pytest.approx(FWHM, rel=0.15)
    _, j, k = np.unravel_index(volume.values.argmax(), volume.values.shape)
    assert width == pytest.approx(1e3 * direct_fwhm(volume.x, volume.values[:, j, k]), rel=0.03)


def download(page, volume, path):
    """What is downloaded opens in nibabel, with the spacing in mm, the values and the ball in its place."""
    page.click("[data-tab='Files']")
    row = page.locator("[data-format='nifti']")
    assert re.search(r"[0-9.]+\s.?B", row.inner_text()), "no size before the click"
    row.get_by_role("button", name="Create").click()
    with page.expect_download() as download:
        row.get_by_role("link", name="Download").click()
    download.value.save_as(path)
    image = nibabel.load(path)
    assert image.header.get_zooms() == pytest.approx(spacing(volume), rel=1e-5)
    values = np.asarray(image.dataobj)
    assert values.max() == pytest.approx(volume.values.max(), rel=1e-6)
    brightest = (*np.unravel_index(values.argmax(), values.shape), 1)
    assert (image.affine @ brightest)[:3] == pytest.approx(PLACE, abs=0.06)
