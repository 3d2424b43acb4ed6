"""Outcome of each shot, told in pieces; the counts of flags; the A-line that was stored last."""

import io

import numpy as np
import pytest

from steradian.scans.file.writer import ScanFileWriter, UploadRecord
from support.alines import Aline

COLUMNS = "points frames stored shot fire_time energy quality averages time_zero level gain".split()


@pytest.fixture
def here(scan_with_alines):
    return f"/scans/{scan_with_alines['scan']['id']}"


@pytest.fixture
def store(server, scan_with_alines):
    """Its file, to be written on: five A-lines, in the order of interrogation, with shots 1 to 5."""
    with ScanFileWriter(server.data.scan_file(scan_with_alines["scan"]["id"])) as store:
        yield store


def line(store, number, **about):
    return Aline(number, np.full(store.samples, 7 * number, np.int16), **about)


def shots(http, here, **query):
    return http.get(f"{here}/shots", params=query).raise_for_status().json()


def rows_of(told):
    return list(zip(*(told[name] for name in COLUMNS), strict=True))


def test_shots_since_cursor_returns_only_changed_points(http, here, store, scan_with_alines):
    """Each answer, laid over those before it, is what a client that reads everything is told."""
    visit = scan_with_alines["visit"].tolist()
    first = shots(http, here)
    seen = dict(zip(first["points"], rows_of(first), strict=True))
    assert len(seen) == 53

    def follow(mark, expected, **query):
        told = shots(http, here, since=mark, **query)
        assert told["points"] == sorted(expected)
        seen.update(zip(told["points"], rows_of(told), strict=True))
        assert [seen[point] for point in range(53)] == rows_of(shots(http, here))
        return told

    mark = follow(first["next"], [])["next"]
    store.append([line(store, 5, shot=6), line(store, 6, shot=7, quality=1)])
    mark = follow(mark, visit[5:7])["next"]
    store.append([line(store, 2, shot=8, quality=2)])  # measured again
    store.set_status(np.array([visit[0]]), 0)  # found damaged
    told = follow(mark, [visit[0], visit[2]])
    assert (told["coverage"]["stored"], told["coverage"]["missing"]) == (6, 47)
    assert follow(first["next"], [visit[0], visit[2], *visit[5:7]])["next"] == told["next"]
    assert shots(http, here, since=mark, points=str(visit[2]))["points"] == [visit[2]]


@pytest.mark.parametrize("mark", ["nonsense", "00000000.1", ".", "1.2.3", "٣.٣", "x" * 60])
def test_a_mark_that_is_not_known_any_more_brings_everything(http, here, mark):
    assert len(shots(http, here, since=mark)["points"]) == 53


def test_stored_a_lines_are_counted_by_their_flags(http, here, store):
    for number, quality in enumerate([0, 1, 3, 2, 4, 9, 1], start=10):
        store.append([line(store, number, quality=quality)])
    told = http.get(f"{here}/coverage").json()
    assert told["flags"] == {"saturated": 4, "mistuned": 2, "misfired": 1, "partial": 1}
    assert (told["flagged"], told["stored"]) == (6, 12)
    assert shots(http, here)["coverage"] == told


def test_the_newest_a_line_is_the_one_stored_last_also_when_the_scanner_has_booted(http, here, store, scan_with_alines):
    """It counts its shots anew then: the highest number is an old one."""
    visit = scan_with_alines["visit"]
    assert shots(http, here)["newest"] == visit[4]
    rows = visit[5:]
    store.record_upload(UploadRecord(rows, 99, 5, 5))
    assert shots(http, here)["newest"] == visit[4], "nothing of the new session is there yet"
    store.append([line(store, 0, shot=1, scale=0.25, time_zero_offset_s=2e-6, quality=2)], rows)
    assert shots(http, here)["newest"] == rows[0]
    latest = f"{here}/alines/latest"
    told = http.get(latest, headers={"Accept": "application/json"}).json()
    assert (told["row"], told["point"], told["frame"], told["shot"]) == (rows[0], rows[0], 0, 1)
    assert (told["scale"], told["time_zero"], told["quality"]) == (0.25, pytest.approx(2e-6), 2)
    answer = http.get(latest)
    np.testing.assert_array_equal(np.load(io.BytesIO(answer.content)), told["values"])
    whole = np.load(io.BytesIO(http.get(f"{here}/alines").content))
    np.testing.assert_array_equal(told["values"], whole[rows[0]])
    assert (answer.headers["x-row"], answer.headers["x-axes"]) == (str(rows[0]), "time")
    assert float(answer.headers["x-spacing"]) == told["sampling_interval"]
    same = http.get(latest, headers={"If-None-Match": answer.headers["etag"]})
    assert (same.status_code, same.content) == (304, b"")
    store.append([line(store, 1, shot=2)], rows)
    other = http.get(latest, headers={"If-None-Match": answer.headers["etag"]})
    assert (other.status_code, other.headers["x-row"]) == (200, str(rows[1]))


def test_before_the_first_a_line_there_is_no_latest(http, here, store, scan_with_alines):
    store.set_status(scan_with_alines["visit"][:5], 0)
    assert shots(http, here)["newest"] is None
    refused = http.get(f"{here}/alines/latest")
    assert (refused.status_code, refused.json()["code"]) == (409, "not-ready")
