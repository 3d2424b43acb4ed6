"""Deliberately broken drivers, each with the directed test that must find it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import driver_scenarios as tests
import pytest

from fabry_perot.device import Device
from fabry_perot.device import device_state as device_body
from fabry_perot.device.lease import LaserLease
from fabry_perot.device.plan_buffer import PlanBuffer
from fabry_perot.device.ring_buffer import ALineRingBuffer
from fabry_perot.host.aborts import Aborts
from fabry_perot.host.auto_recovery import ScanRecovery
from fabry_perot.host.host import Host
from fabry_perot.host.reassembly import AlineReassembler
from fabry_perot.host.uploader import Uploader
from fabry_perot.wire import framing
from fabry_perot.wire.framing import CRC, HEADER, Frame

Patch = Callable[[pytest.MonkeyPatch], None]
Scenario = Callable[[], None]


def _deframer(*, crc: bool, length: bool) -> Patch:
    def decode(self, chunk: bytes) -> Frame | None:
        try:
            body = bytes(framing.cobs.decode(chunk))
        except framing.cobs.DecodeError:
            return None
        if len(body) < framing.OVERHEAD:
            return None
        version, kind, flags, boot, session, sequence, size = HEADER.unpack_from(body)
        wrong_crc = CRC.unpack_from(body, len(body) - 4)[0] != framing.crc32c(body[:-4])
        if version != framing.VERSION or flags & 0xF0 or (crc and wrong_crc):
            return None
        if length and size != len(body) - framing.OVERHEAD:
            return None
        return Frame(kind, flags, boot, session, sequence, body[HEADER.size : -4])

    return lambda patch: patch.setattr(framing.Deframer, "_decode", decode)


def _overwrites(patch: pytest.MonkeyPatch) -> None:
    def append(self, point: int, blob: bytes, encoding: int = 0) -> None:
        if len(self._blobs) >= self.capacity:
            self._blobs.popleft()
            self.acknowledged += 1
        self._blobs.append((point, encoding, blob))
        self.produced += 1

    patch.setattr(ALineRingBuffer, "append", append)
    patch.setattr(ALineRingBuffer, "free", property(lambda self: 1 << 30))


def _accepts_gaps(patch: pytest.MonkeyPatch) -> None:
    def accept(self, first, points):
        start, stop = max(first, self.expected), min(first + len(points), self.window_end)
        if stop <= start:
            return points[:0]
        for index in range(start, stop):
            self._points[index % len(self._points)] = points[index - first]
        self.expected = stop
        return points[start - first : stop - first]

    patch.setattr(PlanBuffer, "accept", accept)


def _no_credit_check(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ALineRingBuffer, "limit", property(lambda self: 1 << 62, lambda self, value: None), raising=False)


def _unchecked(name: str) -> Patch:
    """Frames whose session (or boot tag) differs are taken for one's own, at both ends."""

    def apply(patch: pytest.MonkeyPatch) -> None:
        def feed(self, data: bytes) -> list[Frame]:
            frames = original(self, data)
            return [frame._replace(**{name: self.expected[name]}) if self.expected else frame for frame in frames]

        original = framing.Deframer.feed

        class Trusting(framing.Deframer):
            expected: dict = {}  # noqa: RUF012

        Trusting.feed = feed
        patch.setattr(device_body, "Deframer", Trusting)
        receive = Device.receive

        def trusting(self, data: bytes, now: int) -> None:
            self.deframer.expected = {"session": self.outbox.session, "boot": self.boot & 0xFF}
            receive(self, data, now)

        patch.setattr(Device, "receive", trusting)
        patch.setattr(Host, "_mine", lambda self, frame: self.hello is not None)

    return apply


def _by_arrival_time(patch: pytest.MonkeyPatch) -> None:
    def renew(self, echo: int, ttl: int, now: int) -> bool:
        self.until = max(self.until, now + min(ttl, self.cap))
        return self.permits(now)

    patch.setattr(LaserLease, "renew", renew)


def _future_echoes(patch: pytest.MonkeyPatch) -> None:
    def renew(self, echo: int, ttl: int, now: int) -> bool:
        if echo >= self._not_before:
            self.until = max(self.until, min(echo, now) + min(ttl, self.cap))
        return self.permits(now)

    patch.setattr(LaserLease, "renew", renew)


def _one_abort(patch: pytest.MonkeyPatch) -> None:
    due = Aborts.due

    def once(self, now: int) -> bytes | None:
        payload = due(self, now)
        self._due = 1 << 62 if self.pending else 0
        return payload

    patch.setattr(Aborts, "due", once)


def _same_token(patch: pytest.MonkeyPatch) -> None:
    def new_token(self) -> int:
        self._armed_at, self.token = self.now, 77
        return self.token

    patch.setattr(Device, "issue_arm_token", new_token)


def _no_shutter(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Device, "close", lambda self: None)


class Mutant(NamedTuple):
    """A defect, the directed test that was made to kill it, and those that notice it besides."""

    apply: Patch
    killer: Scenario
    also: tuple[Scenario, ...] = ()


MUTANTS = {
    "no CRC check": Mutant(_deframer(crc=False, length=True), tests.noise_that_only_a_checksum_finds),
    "no length check": Mutant(_deframer(crc=True, length=False), tests.a_length_that_lies_under_a_valid_checksum),
    "no tail-loss repair": Mutant(
        lambda patch: patch.setattr(AlineReassembler, "mark_sent", lambda self, number: None),
        tests.the_last_a_line_is_lost,
    ),
    "no plan time-out": Mutant(
        lambda patch: patch.setattr(Uploader, "__init__", _with_period(Uploader.__init__, 1 << 60)),
        tests.the_last_points_are_lost,
        (tests.points_are_lost_on_the_way, tests.replay_from_an_earlier_session),
    ),
    "ring overwrites": Mutant(
        _overwrites,
        tests.a_full_disk_fills_the_ring_and_stops_the_laser,
        (tests.reboot_in_mid_plan, tests.lost_acknowledgements),
    ),
    "plan gaps accepted": Mutant(_accepts_gaps, tests.points_are_lost_on_the_way),
    "session not checked": Mutant(
        _unchecked("session"), tests.frames_of_another_session, (tests.replay_from_an_earlier_session,)
    ),
    "boot id not checked": Mutant(
        _unchecked("boot"), tests.frames_of_another_boot, (tests.replay_from_an_earlier_session,)
    ),
    "lease kept over a new session": Mutant(
        lambda patch: patch.setattr(LaserLease, "revoke", lambda self, now: None), tests.an_old_echo_in_a_new_session
    ),
    "lease by arrival time": Mutant(
        _by_arrival_time,
        tests.an_abort_on_a_dead_line_still_ends_emission_by_the_lease,
        (
            tests.an_old_echo_in_a_new_session,
            tests.an_echo_of_the_future_keeps_no_laser_on,
            tests.a_laser_that_was_off_for_seconds_waits_for_a_person,
        ),
    ),
    "no credit check": Mutant(_no_credit_check, tests.nothing_is_sent_without_credit),
    "shutter left open": Mutant(
        _no_shutter,
        tests.every_way_out_of_a_running_scan_closes_the_shutter,
        (  # its read-back then says that light leaves the aperture, which is a fault that ends these
            tests.stall_released_after_the_hosts_death,
            tests.long_stall_with_a_living_host,
            tests.replay_from_an_earlier_session,
            tests.reboot_in_mid_plan,
            tests.unplugged_and_plugged_in_again,
            tests.host_killed_and_started_again,
            tests.the_last_a_line_is_lost,
            tests.an_abort_ends_emission_within_its_bound,
        ),
    ),
    "interlock not watched": Mutant(
        lambda patch: patch.setattr(Device, "check_safety", lambda self: True),
        tests.an_opened_interlock_ends_emission_for_good,
    ),
    "abort not repeated": Mutant(_one_abort, tests.an_abort_ends_emission_within_its_bound),
    "token used again": Mutant(_same_token, tests.an_arm_token_starts_one_scan_only),
    "echoes of the future": Mutant(_future_echoes, tests.an_echo_of_the_future_keeps_no_laser_on),
    "laser comes back at any time": Mutant(
        lambda patch: patch.setattr(ScanRecovery, "_permitted", lambda self: True),
        tests.a_laser_that_was_off_for_seconds_waits_for_a_person,
    ),
}


def _with_period(original: Callable[..., None], period: int) -> Callable[..., None]:
    def init(self, plan, payload, _period, start=0) -> None:
        original(self, plan, payload, period, start)

    return init
