"""Simulated scanner with power cycles and reboots."""

from __future__ import annotations

import secrets

from fabry_perot.device import Device, DeviceTiming
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.named_phantoms import by_name
from fabry_perot.simulator.options import FILMS, Options, pattern
from fabry_perot.wire.framing import MAX_PAYLOAD, UART_PAYLOAD, USB_PAYLOAD

STATUS_DUE = 100_000
"""While the firmware is down, the machine wants to be looked at every so many µs."""


class PoweredDevice:
    """Simulated hardware with a firmware (:class:`~fabry_perot.device.device.Device`) that can lose power and reboot.

    All times are simulator time in µs; the firmware counts from its own boot.

    Parameters
    ----------
    options
        Settings.
    """

    def __init__(self, options: Options) -> None:
        self._options = options
        self.instrument = SimulatedInstrument(
            by_name(options.phantom, options.seed),
            sound_speed=options.sound_speed,
            seed=options.seed,
            noise_db=options.noise_db,
            clock_rate=options.speed,
            line_rate=options.baud // 10,
            response=FILMS[options.film],
            energy_jitter=options.energy_jitter,
            time_zero=options.time_zero,
            relief=options.relief,
            tuning=round(1e6 * options.tuning_time),
            gate=round(1e6 / options.gate_rate) if options.gate_rate else 0,
            beams=pattern(options.beams, options.beam_spacing),
            full_scale=options.full_scale,
            repeat=options.repeat,
        )
        self._up_at: int | None = None
        self.boots = 0
        self.ring_peak = 0
        self.device = self._boot(0, options.boot, cause=1)

    def _boot(self, now: int, boot: int | None, cause: int) -> Device:
        self.instrument.boot(now)
        self.boots += 1
        options = self._options
        return Device(
            self.instrument,
            boot=boot or 1 + secrets.randbelow(0xFFFFFFFE),
            timing=DeviceTiming().scaled(options.speed),
            ring=options.ring,
            plan_points=options.plan_points,
            max_payload=UART_PAYLOAD if options.baud else MAX_PAYLOAD if options.tcp else USB_PAYLOAD,
            reset_cause=cause,
        )

    def reboot(self, now: int, duration: int) -> None:
        """Power off at ``now`` and boot ``duration`` µs later; the firmware's memory is lost."""
        self.ring_peak = max(self.ring_peak, self.device.ring.peak)
        self._up_at = now + duration

    def receive(self, data: bytes, now: int) -> None:
        """Pass received bytes to the firmware, if it is running."""
        if self._up_at is not None:
            if now < self._up_at:
                return
            self.device, self._up_at = self._boot(now, None, cause=3), None
        self.device.receive(data, now - self.instrument.epoch)

    def pull(self, budget: int) -> bytes:
        """Return the bytes that the firmware sends."""
        return self.device.next_frames(budget) if self._up_at is None else b""

    def next_due(self, now: int) -> int:
        """Return the simulator time of the next action of firmware or reboot."""
        if self._up_at is not None:
            return min(self._up_at, now + STATUS_DUE)
        return self.instrument.epoch + self.device.next_deadline()
