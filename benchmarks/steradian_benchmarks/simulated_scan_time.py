"""Duration of a scan plan on the simulated scanner, measured by the simulator's clock."""

from __future__ import annotations

from typing import Any

import numpy as np

from fabry_perot.hardware import PlanSampling
from fabry_perot.host.plan import WirePlan
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.phantoms import Balls
from steradian.plans import ScanPlan


def simulated_scan_seconds(plan: ScanPlan, **hardware: Any) -> float:
    """Run a plan on the simulated scanner without a serial link and return its duration in seconds.

    Further arguments configure the hardware.
    """
    ball = Balls(np.array([[0.0, 0.0, 3e-3]]), np.array([1e-4]), np.array([1.0]))
    pattern = [(round(1e9 * x), round(1e9 * y)) for x, y in plan.beams or ((0.0, 0.0),)]
    device = SimulatedInstrument(ball, repeat=1, beams=pattern, **hardware)
    device.boot(0)
    places = WirePlan.from_metres(
        plan.path,
        samples=plan.samples,
        sampling_interval=plan.sampling_interval,
        pulse_rate=plan.pulse_rate,
        averages=plan.averages,
        wavelength=0.0 if plan.bias is None else plan.bias[plan.visit[:: plan.beam_count]],
    )
    device.begin(PlanSampling(places.samples, places.interval_ps, places.pulse_rate_mhz, plan.beam_count))
    device.queue_points(0, places.points, 0)
    device.open()
    device.permit(1 << 60, 0)
    fired: list[int] = []
    now: int | None = 0
    while now is not None and len(fired) < places.length:
        fired += [taken.fire_time for taken in device.poll(now) if not taken.beam]
        now = device.next_due(now)
    return 1e-6 * (fired[-1] - fired[0]) / (len(fired) - 1) * len(fired)
