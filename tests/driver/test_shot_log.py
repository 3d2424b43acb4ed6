"""The simulated laser's last shots, the truth that tests of safety rest on."""

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from fabry_perot.simulator.shot_log import ShotLog

SHOTS = st.lists(st.tuples(st.integers(0, 2**62), st.integers(0, 2**31)), max_size=30)


@given(SHOTS, st.integers(1, 10), st.slices(12))
def test_shot_log_behaves_like_bounded_deque(shots, most, part):
    log, plain = ShotLog(most), deque(maxlen=most)
    for shot in shots:
        log.append(shot)
        plain.append(shot)
    assert list(log) == list(plain)
    assert len(log) == len(plain)
    assert bool(log) == bool(plain)
    assert log[part] == list(plain)[part]
    if shots:
        assert log[-1] == shots[-1]
        assert log[0] == plain[0]
