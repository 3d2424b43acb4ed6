"""Every pair of states is either in the table or refused, and the tables say what they should."""

import itertools

import pytest

from steradian.core.exceptions import Conflict
from steradian.storage import state_machines
from steradian.storage.state_machines import (
    ACTIVE_SCAN_STATES,
    ALLOWED_DESIRED_STATES,
    IRREVERSIBLE_DESIRED_STATES,
    RECONSTRUCTION_TRANSITIONS,
    SCAN_TRANSITIONS,
    SETTLED_SCAN_STATES,
    DesiredScanState,
    ReconstructionState,
    ScanState,
    is_terminal,
    require_transition,
    shortest_path,
)

S, R = ScanState, ReconstructionState

SCAN_PATHS = [
    "queued arming running completing complete",
    "running pausing paused arming",
    "running stopping partial",
    "paused stopping partial",
    "arming recovering running",
    "running recovering interrupted",
    "interrupted arming",
    "interrupted partial",
    "queued aborted",
    *(f"{state} aborting aborted" for state in ACTIVE_SCAN_STATES - {S.ABORTING}),
    *(f"{state} failed" for state in ACTIVE_SCAN_STATES),
    *(f"{state} interrupted" for state in ACTIVE_SCAN_STATES),
]
RECONSTRUCTION_PATHS = [
    "queued running succeeded",
    "running failed",
    "running queued",
    "queued cancelling cancelled",
    "running cancelling cancelled",
]


def pairs(paths):
    return {pair for path in paths for pair in itertools.pairwise(path.split())}


@pytest.mark.parametrize(("present", "following"), list(itertools.product(S, S)))
def test_a_scan_changes_only_along_the_paths_of_the_design(present, following):
    if (present, following) in pairs(SCAN_PATHS):
        require_transition("s1", present, following)
    else:
        with pytest.raises(Conflict, match=f"s1 is {present} and cannot become {following}"):
            require_transition("s1", present, following)


@pytest.mark.parametrize(("present", "following"), list(itertools.product(R, R)))
def test_a_reconstruction_changes_only_along_the_paths_of_the_design(present, following):
    assert (following in RECONSTRUCTION_TRANSITIONS[present]) == ((present, following) in pairs(RECONSTRUCTION_PATHS))


def test_every_state_is_in_its_table_and_can_be_left_or_is_final():
    assert set(SCAN_TRANSITIONS) == set(S)
    assert set(RECONSTRUCTION_TRANSITIONS) == set(R)
    assert {s for s in S if is_terminal(s)} == {S.COMPLETE, S.PARTIAL, S.ABORTED, S.FAILED}
    assert {r for r in R if is_terminal(r)} == {R.SUCCEEDED, R.FAILED, R.CANCELLED}


def test_every_scan_state_is_reachable_and_reaches_an_end():
    def reach(start):
        seen, front = {start}, [start]
        while front:
            new = SCAN_TRANSITIONS[front.pop()] - seen
            seen |= new
            front += new
        return seen

    assert reach(S.QUEUED) == set(S)
    for state in S:
        assert reach(state) & {S.COMPLETE, S.PARTIAL, S.ABORTED, S.FAILED}


def test_a_state_is_queued_or_active_or_settled():
    groups = [{S.QUEUED}, ACTIVE_SCAN_STATES, SETTLED_SCAN_STATES]
    assert set().union(*groups) == set(S)
    assert sum(map(len, groups)) == len(S)


@pytest.mark.parametrize("state", S)
def test_every_allowed_desired_state_is_reachable(state):
    goals = {
        DesiredScanState.RUNNING: {S.RUNNING},
        DesiredScanState.PAUSED: {S.PAUSED},
        DesiredScanState.STOPPED: {S.PARTIAL, S.ABORTED},
        DesiredScanState.ABORTED: {S.ABORTED},
    }
    for wish in ALLOWED_DESIRED_STATES[state]:
        goal = goals[wish]
        front, seen = [state], set()
        while front:
            seen.add(present := front.pop())
            front += SCAN_TRANSITIONS[present] - seen
        assert goal & seen, wish


@pytest.mark.parametrize(("present", "goal"), list(itertools.product(S, S)))
def test_shortest_path_follows_transitions_and_avoids_interruption(present, goal):
    reachable, front = {present}, [present]
    while front:
        new = SCAN_TRANSITIONS[front.pop()] - reachable
        reachable |= new
        front += new
    if goal not in reachable:
        with pytest.raises(Conflict):
            shortest_path(present, goal)
        return
    way = (present, *shortest_path(present, goal))
    assert way[-1] is goal
    assert all(after in SCAN_TRANSITIONS[before] for before, after in itertools.pairwise(way))


@pytest.mark.parametrize(
    ("present", "goal", "way"),
    [
        (S.RUNNING, S.PARTIAL, [S.STOPPING, S.PARTIAL]),
        (S.PAUSING, S.PARTIAL, [S.PAUSED, S.STOPPING, S.PARTIAL]),
        (S.PAUSED, S.RUNNING, [S.ARMING, S.RUNNING]),
        (S.RECOVERING, S.ABORTED, [S.ABORTING, S.ABORTED]),
        (S.ARMING, S.COMPLETE, [S.RUNNING, S.COMPLETING, S.COMPLETE]),
        (S.RUNNING, S.RUNNING, []),
    ],
)
def test_a_route_is_the_way_a_person_would_tell(present, goal, way):
    assert list(shortest_path(present, goal)) == way


def test_stop_and_abort_requests_are_irreversible():
    assert IRREVERSIBLE_DESIRED_STATES[DesiredScanState.ABORTED] == frozenset()
    assert IRREVERSIBLE_DESIRED_STATES[DesiredScanState.STOPPED] == {DesiredScanState.ABORTED}


def test_interrupted_scan_allows_running_but_not_paused_request():
    assert DesiredScanState.RUNNING in ALLOWED_DESIRED_STATES[S.INTERRUPTED]
    assert DesiredScanState.PAUSED not in ALLOWED_DESIRED_STATES[S.INTERRUPTED]


def test_the_tables_cannot_be_changed_by_accident():
    with pytest.raises(TypeError):
        state_machines.SCAN_TRANSITIONS[S.COMPLETE] = frozenset(S)
