"""Directed tests on the driver as it is, and on deliberately broken ones, each of which must be found."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from driver_scenarios import SCENARIOS

from fabry_perot import framing
from fabry_perot.device import core as device_core
from fabry_perot.device.lease import LaserLease
from fabry_perot.device.planbuffer import PlanBuffer
from fabry_perot.device.ring import ALineRing
from fabry_perot.framing import CRC, HEADER, Frame
from fabry_perot.host.assembly import Assembly
from fabry_perot.host.core import Host
from fabry_perot.host.uploader import Uploader

Patch = Callable[[pytest.MonkeyPatch], None]


@pytest.mark.parametrize("name", SCENARIOS)
def test_directed(name):
    SCENARIOS[name]()


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

    patch.setattr(ALineRing, "append", append)
    patch.setattr(ALineRing, "full", property(lambda self: False))


def _accepts_gaps(patch: pytest.MonkeyPatch) -> None:
    def accept(self, first, points):
        start, stop = max(first, self.expected), min(first + len(points), self.limit)
        if stop <= start:
            return points[:0]
        for index in range(start, stop):
            self._points[index % len(self._points)] = points[index - first]
        self.expected = stop
        return points[start - first : stop - first]

    patch.setattr(PlanBuffer, "accept", accept)


def _no_credit_check(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ALineRing, "limit", property(lambda self: 1 << 62, lambda self, value: None), raising=False)


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
        patch.setattr(device_core, "Deframer", Trusting)
        receive = device_core.Device.receive

        def trusting(self, data: bytes, now: int) -> None:
            self.deframer.expected = {"session": self.outbox.session, "boot": self.boot & 0xFF}
            receive(self, data, now)

        patch.setattr(device_core.Device, "receive", trusting)
        patch.setattr(Host, "_mine", lambda self, frame: self.hello is not None)

    return apply


def _by_arrival_time(patch: pytest.MonkeyPatch) -> None:
    def renew(self, echo: int, ttl: int, now: int) -> bool:
        self.until = max(self.until, now + min(ttl, self.cap))
        return self.permits(now)

    patch.setattr(LaserLease, "renew", renew)


MUTANTS: dict[str, Patch] = {
    "no CRC check": _deframer(crc=False, length=True),
    "no length check": _deframer(crc=True, length=False),
    "no tail-loss repair": lambda patch: patch.setattr(Assembly, "sent", lambda self, number: None),
    "no plan time-out": lambda patch: patch.setattr(Uploader, "__init__", _with_period(Uploader.__init__, 1 << 60)),
    "ring overwrites": _overwrites,
    "plan gaps accepted": _accepts_gaps,
    "session not checked": _unchecked("session"),
    "boot id not checked": _unchecked("boot"),
    "lease kept over a new session": lambda patch: patch.setattr(LaserLease, "revoke", lambda self, now: None),
    "lease by arrival time": _by_arrival_time,
    "no credit check": _no_credit_check,
}


def _with_period(original: Callable[..., None], period: int) -> Callable[..., None]:
    def init(self, plan, payload, _period, start=0) -> None:
        original(self, plan, payload, period, start)

    return init


@pytest.mark.mutants
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_found_by_a_directed_test(name, monkeypatch):
    MUTANTS[name](monkeypatch)
    killers = []
    for scenario, run in SCENARIOS.items():
        try:
            run()
        except Exception:  # whatever a broken driver does is a find
            killers.append(scenario)
            break
    assert killers, f"{name}: no directed test notices"
