"""Named measurements over HTTP: values are those of a known volume, kept with it, and bounded."""

import csv
import io
import math

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume, VoxelAxes
from steradian.jobs.job import Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.reconstructions.studies.named_measurements import ProfileMeasurement, RegionMeasurement, measure_named
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.reader import VolumeReader

from .conftest import make_scan_with_alines
from .test_series import settle

SIGMA, PLACE = 1.5e-4, (0.1e-3, -0.05e-3, 2.1e-3)
AXES = VoxelAxes(*(np.arange(40) * 5e-5 - 1e-3,) * 2, np.arange(60) * 5e-5)
X, Y, Z = np.meshgrid(AXES.x, AXES.y, AXES.z, indexing="ij")
NOISE = np.random.default_rng(3).normal(0, 0.01, X.shape)
VALUES = np.exp(-((X - PLACE[0]) ** 2 + (Y - PLACE[1]) ** 2 + (Z - PLACE[2]) ** 2) / (2 * SIGMA**2)) + NOISE
VALUES = VALUES.astype(np.float32)
ABOUT = {"parameters": {}, "provenance": {}}
SLAB = [1e-3, 2.5e-3]
PROFILE = {"kind": "profile", "name": "profile 1", "axis": "z", "slab": SLAB}
PROFILE |= {"start": [-0.8e-3, PLACE[1]], "end": [0.9e-3, PLACE[1]]}


@pytest.fixture
def volume(server, http, plan):
    """A volume with a Gaussian ball, whose measurements a test may change."""

    def write(folder):
        write_volume(folder / "volume.h5", Volume(VALUES, AXES, (5e-5,) * 3), **ABOUT)

    scan = make_scan_with_alines(server, http, plan["id"])["scan"]["id"]
    return settle(server, http, scan, write, {"shape": VALUES.shape})


def put(http, volume, *items, **headers):
    return http.put(f"/reconstructions/{volume}/measurements", json={"items": list(items)}, headers=headers)


def test_measured_values_are_those_of_the_known_volume(http, volume):
    """Width of a Gaussian, NumPy's statistics of the maxima in the slab, and the ball's depth."""
    box = {"axis": "z", "slab": SLAB, "start": [0, -0.2e-3], "end": [0.3e-3, 0.1e-3]}
    beside = {"background_start": [-0.9e-3, 0.5e-3], "background_end": [-0.5e-3, 0.9e-3]}
    items = [
        PROFILE,
        {"kind": "region", "name": "vessel", **box},
        {"kind": "contrast", "name": "to tissue"} | box | beside,
    ]
    items.append({"kind": "point", "name": "centre", "axis": "z", "slab": SLAB, "start": [AXES.x[22], AXES.y[19]]})
    answer = put(http, volume, *items)
    assert answer.status_code == 200, answer.text
    told = answer.json()["items"]
    assert http.get(f"/reconstructions/{volume}/measurements").json()["items"] == told, "another browser sees the same"
    width, region, contrast, point = (item["figures"] for item in told)
    assert width["width"] == pytest.approx(2 * math.sqrt(2 * math.log(2)) * SIGMA, rel=0.05)
    assert 0 < width["repeatability"] < 0.1 * width["width"]
    assert [end[2] for end in told[0]["ends"]] == pytest.approx([PLACE[2]] * 2, abs=5e-5)
    chosen = (AXES.z >= SLAB[0] - 1e-9) & (AXES.z <= SLAB[1] + 1e-9)
    image = VALUES[:, :, chosen].max(axis=2).astype(float)
    inside = image[20:27, 16:23]
    outside = image[2:11, 30:39]
    assert (region["value"], region["deviation"]) == pytest.approx((inside.mean(), inside.std()), rel=1e-5)
    assert region["voxels"] == inside.size
    assert contrast["value"] == pytest.approx((inside.mean() - outside.mean()) / outside.std(), rel=1e-4)
    assert point["value"] == pytest.approx(image[22, 19], rel=1e-5)


def test_profile_of_a_line_scan_has_the_width_of_its_image(tmp_path):
    """An image from a line of sensors has no axis across it, and voxels without a value do not count."""
    image = VALUES[:, 19, :].copy()
    image[0, 0] = np.nan
    write_volume(tmp_path / "volume.h5", Volume(image, VoxelAxes(AXES.x, None, AXES.z), (5e-5,) * 2), **ABOUT)
    stored, place = VolumeReader(tmp_path / "volume.h5"), {"name": "a", "axis": "y"}
    line = ProfileMeasurement(**place, start=(-0.8e-3, PLACE[2]), end=(0.9e-3, PLACE[2]))
    found = measure_named(stored, line)
    assert found.figures["width"] == pytest.approx(2 * math.sqrt(2 * math.log(2)) * SIGMA, rel=0.05)
    assert found.ends == ()
    corner = RegionMeasurement(**place, start=(AXES.x[0], AXES.z[0]), end=(AXES.x[1], AXES.z[1]))
    assert measure_named(stored, corner).figures["voxels"] == 3
    with pytest.raises(InvalidInput, match=r"y without slab"):
        measure_named(stored, line.replace(slab=(0.0, 1e-3)))


def test_table_has_the_correction_that_a_width_job_found(server, http, volume):
    """In SI units, a row for each measurement, with the newest job along the same line."""
    (told,) = put(http, volume, PROFILE).json()["items"]
    assert told["correction"] is None
    scan = http.get(f"/reconstructions/{volume}").json()["scan_id"]
    asked = {"kind": "width", "scan_id": scan, "reconstruction_id": volume}
    made = http.post("/jobs", json=asked | dict(zip(("start", "end"), told["ends"], strict=True))).json()
    ledger = JobLedger(server.database)
    ledger.start_attempt(made["id"], "worker-8")
    found = {"fwhm": 3.5e-4, "point_spread": 7e-5, "corrected": 3.4e-4, "shape": "Gaussian sphere", "reason": ""}
    ledger.finish_attempt(made["id"], 1, Succeeded({"width": found}), "worker-8")
    text = http.get(f"/reconstructions/{volume}/measurements", headers={"Accept": "text/csv"}).text
    (row,) = csv.DictReader(io.StringIO(text))
    assert (row["name"], row["kind"]) == ("profile 1", "profile")
    assert float(row["width"]) == pytest.approx(told["figures"]["width"])
    assert (float(row["corrected"]), row["shape"]) == (3.4e-4, "Gaussian sphere")


def test_measurement_that_does_not_fit_is_refused_by_field(http, volume):
    far = PROFILE | {"name": "far", "start": [0.1, 0.0], "end": [0.2, 0.0]}
    two = [PROFILE, PROFILE | {"axis": "x"}]
    for items, pointer in (
        ([PROFILE, far], "#/items/1/start"),
        ([PROFILE | {"slab": [0.5, 0.6]}], "#/items/0/slab"),
        ([PROFILE | {"slab": None}], "#/items/0/slab"),
        ([PROFILE | {"index": 1}], "#/items/0/index"),
        (two, "#/items/1/name"),
        ([PROFILE | {"name": str(n)} for n in range(101)], "#/items"),
    ):
        refused = put(http, volume, *items)
        assert refused.status_code == 422, refused.text
        assert refused.json()["errors"][0]["pointer"] == pointer
    assert http.get(f"/reconstructions/{volume}/measurements").json() == {"items": []}


def test_change_of_measurements_that_another_browser_changed_returns_412(http, volume):
    before = put(http, volume, PROFILE).headers["etag"]
    assert http.get(f"/reconstructions/{volume}/measurements").headers["etag"] == before
    renamed = put(http, volume, PROFILE | {"name": "vessel"}, **{"If-Match": before})
    assert renamed.json()["items"][0]["measurement"]["name"] == "vessel"
    late = put(http, volume, **{"If-Match": before})
    assert (late.status_code, late.json()["code"]) == (412, "precondition-failed")


def test_measurements_go_with_their_volume(http, volume):
    put(http, volume, PROFILE)
    assert http.delete(f"/reconstructions/{volume}").status_code == 204
    assert http.get(f"/reconstructions/{volume}/measurements").status_code == 404
    assert put(http, volume, PROFILE).status_code == 404


def test_line_across_no_peak_tells_why_it_has_no_width(http, volume):
    short = PROFILE | {"start": [PLACE[0], PLACE[1]], "end": [PLACE[0] + 1e-5, PLACE[1]]}
    (told,) = put(http, volume, short).json()["items"]
    assert told["figures"]["width"] is None
    assert "does not fall to a half" in told["reason"]


def test_table_of_several_volumes_names_the_volume_of_each_row(server, http, plan, volume):
    """The same measurements in a second volume, of twice the pressure, have twice the value and the same width."""

    def write(folder):
        write_volume(folder / "volume.h5", Volume(2 * VALUES, AXES, (5e-5,) * 3), **ABOUT)

    scan = http.get(f"/reconstructions/{volume}").json()["scan_id"]
    other = settle(server, http, scan, write, {"shape": VALUES.shape})
    for each in (volume, other):
        put(http, each, PROFILE)
    here = f"/reconstructions/{volume}/measurements"
    text = http.get(here, params={"also": [other]}, headers={"Accept": "text/csv"}).text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["reconstruction_id"] for row in rows] == [volume, other]
    assert float(rows[1]["value"]) == pytest.approx(2 * float(rows[0]["value"]), rel=1e-6)
    assert float(rows[1]["width"]) == pytest.approx(float(rows[0]["width"]), rel=1e-6)
    assert http.get(here, params={"also": ["r0"]}).status_code == 404
