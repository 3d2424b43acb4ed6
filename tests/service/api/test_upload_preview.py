"""A look into a file before it is imported: what it says, what is missing, nothing made of it."""

import io

import numpy as np
import pytest

TRACES = np.arange(9 * 32, dtype=np.int16).reshape(9, 32)
PLACES = 1e-3 * np.argwhere(np.ones((3, 3)))


def sent(http, content):
    return http.post("/uploads", content=content).json()["id"]


def npy(values):
    held = io.BytesIO()
    np.save(held, values)
    return held.getvalue()


def kept(http, server):
    return sorted(server.data.uploads.iterdir()), *(http.get(f"/{noun}").json() for noun in ("scans", "jobs"))


def look(http, upload, **asked):
    return http.post(f"/uploads/{upload}/preview", json=asked)


@pytest.fixture
def recording(http):
    return sent(http, npy(TRACES))


def test_preview_of_incomplete_file_lists_missing_fields(http, server, recording):
    before = kept(http, server)
    told = look(http, recording).json()
    assert [one["field"] for one in told["missing"]] == ["positions", "sampling_interval", "sound_speed"]
    assert all(one["allowed"] for one in told["missing"])
    assert (told["format"], told["points"], told["samples"], told["dtype"]) == ("npy", 9, 32, "int16")
    assert (told["positions"], told["aperture"], told["sampling_interval"], told["sound_speed"]) == (None,) * 4
    assert np.array_equal(told["traces"], TRACES[told["rows"]])
    assert len(told["rows"]) == 5
    assert kept(http, server) == before


def test_a_description_and_a_companion_have_the_last_word(http, recording):
    beside = sent(http, b"x,y\n" + "".join(f"{1e3 * x},{1e3 * y}\n" for x, y in PLACES).encode())
    said = {"lengths": "mm", "times": "ns", "sampling_interval": 20, "sound_speed": 1480, "aperture": 4, "depth": 2}
    told = look(http, recording, description=said, companion_id=beside).json()
    assert told["missing"] == []
    assert told["sampling_interval"] == pytest.approx(20e-9)
    assert (told["sound_speed"], told["aperture"], told["depth"]) == pytest.approx((1480, 4e-3, 2e-3))
    assert np.ptp(told["positions"], axis=0) == pytest.approx(np.ptp(PLACES, axis=0))


@pytest.mark.long
def test_kwave_p_without_mask_lacks_positions_that_a_grid_gives(http):
    held = io.BytesIO()
    lines = np.random.default_rng(1).normal(size=(9, 32))
    lines[:, :4] = 0
    np.savez(held, p=lines.T, dt=2e-8, c0=1500)
    upload = sent(http, held.getvalue())
    (lacking,) = look(http, upload).json()["missing"]
    assert lacking["field"] == "positions"
    for each in ("beside p", "mask, with its pitch dx", "grid (interval, count)", "description"):
        assert each in lacking["allowed"]
    told = look(http, upload, description={"grid": {"count": [3, 3], "interval": [1e-3, 1e-3]}}).json()
    assert (told["missing"], told["points"], told["samples"]) == ([], 9, 32)
    assert np.ptp(told["positions"], axis=0) == pytest.approx(np.ptp(PLACES, axis=0))


def test_a_scan_file_of_our_own_lacks_nothing(http, scan_with_alines):
    scan = scan_with_alines["scan"]["id"]
    upload = sent(http, http.get(f"/scans/{scan}/file").content)
    told = look(http, upload).json()
    plan = http.get(f"/plans/{scan_with_alines['scan']['plan_id']}").json()
    assert (told["format"], told["missing"]) == ("steradian", [])
    assert (told["samples"], told["sampling_interval"]) == (plan["samples"], plan["sampling_interval"])
    assert told["points"] == len(told["positions"])


@pytest.mark.parametrize(
    ("asked", "status", "pointer"),
    [
        ({"description": {"positions": "/etc/passwd"}}, 422, "description"),
        ({"description": {"aperture": -1}}, 422, "aperture"),
        ({"description": {"nothing": 1}}, 422, "nothing"),
        ({"companion_id": "../x"}, 422, "companion_id"),
        ({"companion_id": "u0"}, 404, None),
    ],
)
def test_preview_of_invalid_description_or_companion_is_refused(http, recording, asked, status, pointer):
    answer = look(http, recording, **asked)
    assert answer.status_code == status, answer.text
    if pointer:
        assert pointer in answer.json()["errors"][0]["pointer"]


def test_a_damaged_file_and_one_that_is_gone(http):
    assert look(http, sent(http, b"\x89HDF\r\n\x1a\nnothing")).json()["code"] == "damaged-file"
    assert look(http, "u0").status_code == 404


@pytest.mark.long
def test_sgl_preview_reports_file_name_metadata_and_assumptions(http):
    """The upload has no name; the description brings it."""
    numbers = np.concatenate([[3, 3, 32, 500, 500, 20], TRACES.T.ravel()])
    upload = sent(http, numbers.astype(">f4").tobytes())
    told = look(http, upload).json()
    assert (told["format"], told["points"], told["samples"], told["time_zero"]) == ("sgl", 9, 32, 0)
    assert told["missing"] == []
    assert "1500 m/s is assumed" in told["notes"][0]
    told = look(http, upload, description={"file_name": "a@750nm_t0[-7]_dx[100µm].SGL", "sound_speed": 1480}).json()
    assert told["time_zero"] == pytest.approx(-7 * 20e-9)
    assert any("dx = 100 µm, the header 500 µm" in note for note in told["notes"])
