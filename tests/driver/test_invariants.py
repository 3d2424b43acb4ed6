"""A stateful property test: whatever happens to line, device and application, in whatever order, nothing is lost,
nothing comes twice, no shot lies outside a live lease, and an abort ends emission. The invariants are in ``World``."""

from __future__ import annotations

import driver_faults
import pytest
from driver_world import World
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from fabry_perot.errors import ScannerError
from fabry_perot.simulator import line_faults
from fabry_perot.wire.constants import AbortLevel, Type

WAYS = st.sampled_from(["up", "down"])
SEEDS = st.integers(0, 10_000)
SPAN = st.integers(1, 1500)
FRAMES = st.sampled_from([kind for kind in Type if kind not in (Type.ABORT, Type.FAULT_ACK)])


class ScanMachine(RuleBasedStateMachine):
    @initialize(ring=st.sampled_from([3, 12]), payload=st.sampled_from([200, 641, 8192]))
    def start(self, ring: int, payload: int) -> None:
        self.world = World(ring=ring, max_payload=payload)
        self.world.begin()

    def put(self, way: str, item: line_faults.Filter) -> None:
        getattr(self.world, way).filters.append(item)

    @rule(milliseconds=st.integers(1, 400))
    def time_passes(self, milliseconds: int) -> None:
        self.world.run(milliseconds)

    @rule(way=WAYS, seed=SEEDS, rate=st.sampled_from([1e-5, 1e-4, 1e-3]))
    def bit_flips(self, way: str, seed: int, rate: float) -> None:
        self.put(way, line_faults.BitFlips(seed, rate))

    @rule(way=WAYS, seed=SEEDS)
    def bytes_dropped_inserted_doubled(self, way: str, seed: int) -> None:
        self.put(way, driver_faults.ByteFaults(seed, 300))

    @rule(way=WAYS, seed=SEEDS)
    def pieces_doubled_or_overtaken(self, way: str, seed: int) -> None:
        self.put(way, driver_faults.ChunkFaults(seed, 4))

    @rule(way=WAYS, milliseconds=SPAN)
    def stall_then_release(self, way: str, milliseconds: int) -> None:
        now = self.world.clock.now()
        self.put(way, line_faults.Delay(now, now + 1000 * milliseconds))

    @rule(way=WAYS, milliseconds=SPAN)
    def one_way_cut(self, way: str, milliseconds: int) -> None:
        now = self.world.clock.now()
        self.put(way, line_faults.DropAll(now, now + 1000 * milliseconds))

    @rule(way=WAYS)
    def slow_reader(self, way: str) -> None:
        self.put(way, driver_faults.SlowReader(20_000))

    @rule(way=WAYS, kind=FRAMES, nth=st.integers(0, 3))
    def nth_frame_of_a_type_lost(self, way: str, kind: Type, nth: int) -> None:
        self.put(way, driver_faults.FramesOfType(kind, lambda count: count == nth))

    @rule(milliseconds=SPAN)
    def unplugged_and_plugged_in(self, milliseconds: int) -> None:
        self.world.unplug(milliseconds)

    @rule(milliseconds=st.integers(1, 500))
    def device_reboots(self, milliseconds: int) -> None:
        self.world.reboot(milliseconds)

    @rule(milliseconds=SPAN)
    def host_is_killed_and_bytes_of_it_still_arrive(self, milliseconds: int) -> None:
        self.world.kill_host()
        self.world.run(milliseconds)
        self.recover(self.world.new_host)

    @rule(milliseconds=SPAN)
    def application_hangs(self, milliseconds: int) -> None:
        self.world.hung = True
        self.world.run(milliseconds)
        self.world.hung = False

    @rule(milliseconds=SPAN)
    def disk_is_full(self, milliseconds: int) -> None:
        self.world.disk_full = True
        self.world.run(milliseconds)
        self.world.disk_full = False

    @rule(share=st.floats(0.1, 1.0))
    def earlier_bytes_are_replayed(self, share: float) -> None:
        data = self.world.recorder.data
        self.put("up", driver_faults.Replay(data[: int(share * len(data))], self.world.clock.now()))

    @rule(level=st.sampled_from([AbortLevel.PAUSE, AbortLevel.LASER_OFF, AbortLevel.EMERGENCY_STOP]))
    def somebody_aborts(self, level: AbortLevel) -> None:
        self.world.abort(level)

    @rule()
    def somebody_resumes(self) -> None:
        self.recover(self.world.go)

    @rule()
    def the_line_is_good_again(self) -> None:
        self.world.calm()

    def recover(self, action) -> None:
        """A person may try in vain on a bad line; that must be harmless."""
        if self.world.host.failure is not None and action == self.world.go:
            action = self.world.new_host
        try:
            action()
        except (ScannerError, AssertionError) as error:
            if isinstance(error, AssertionError) and "not reached" not in str(error):
                raise

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.world.finish()


def run(examples: int, steps: int, *, derandomize: bool) -> None:
    limits = settings(
        max_examples=examples,
        stateful_step_count=steps,
        deadline=None,
        derandomize=derandomize,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate],  # a failing sequence is short enough, and shrinking takes minutes
    )
    run_state_machine_as_test(ScanMachine, settings=limits)


@pytest.mark.long
def test_no_sequence_of_faults_loses_or_doubles_an_a_line_or_fires_outside_a_lease():
    run(30, 12, derandomize=True)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_no_sequence_of_faults_does_so_in_a_longer_random_search():
    run(200, 25, derandomize=False)
