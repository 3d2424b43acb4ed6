"""``/scans/{id}/signals``: the inspection over HTTP, with the refusals."""

import pytest


@pytest.mark.long
def test_scan_signals_of_partial_scan_cover_stored_alines(http, scan_with_alines):
    """Five A-lines are stored, of as many as the mask has points."""
    scan = scan_with_alines["scan"]["id"]
    told = http.get(f"/scans/{scan}/signals").raise_for_status().json()
    shots = http.get(f"/scans/{scan}/shots").json()
    assert told["looked_at"] == sum(shots["stored"])
    assert (told["alines"], told["complete"]) == (len(shots["stored"]), False)
    assert sum(told["histogram"]["counts"]) == told["looked_at"] * told["samples"]
    assert len(told["maps"]["x"]) == told["looked_at"]


def test_read_scan_signals_frame_that_is_not_there_is_refused(http, scan_with_alines):
    answer = http.get(f"/scans/{scan_with_alines['scan']['id']}/signals", params={"frame": 7})
    assert answer.status_code == 422
    assert "0 to 0" in answer.text
