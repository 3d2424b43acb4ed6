"""``python -m steradian_benchmarks stop`` in small: the laser that it times does go off."""

import pytest

from steradian_benchmarks.stop_latency import stop


@pytest.mark.soak
@pytest.mark.timeout(300)
def test_every_stop_is_confirmed_by_the_scanner():
    rows = stop(presses=2)
    assert [row["case"] for row in rows] == ["idle", "two busy processes", "database locked"]
    assert all(row["confirmed"] == row["presses"] == 2 for row in rows)
