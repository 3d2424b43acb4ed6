"""The preview's time is what a simulated scanner takes, by the scanner's own clock."""

import numpy as np
import pytest

import fabry_perot
from fabry_perot.simulator import launch
from steradian import ScanPlan, equi_steradian_mask
from steradian.plans import Link, preview

RING, RUNS = 8, 10
MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 65)
FEW = equi_steradian_mask(13.56e-3, 3.6e-3, 45)

SLOW_LINE = Link(byte_rate=46_080, ring=RING)


def device_seconds(plan: ScanPlan, *, speed: float, baud: int = 0) -> float:
    """Run a plan and return its duration in device time."""
    fired, ring = [], RING if baud else 512
    with launch(speed=speed, baud=baud, ring=ring) as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload(
            plan.mask.film_positions[plan.visit],
            samples=plan.samples,
            sampling_interval=plan.sampling_interval,
            pulse_rate=plan.pulse_rate,
            averages=plan.averages,
            encoding="int16",
        )
        scanner.start(scanner.arm())
        for batch in scanner.alines():
            fired += [aline.fire_time_s for aline in batch]
            if len(fired) == plan.mask.count:
                ended = simulator.send_command("report")["time"] * 1e-6
            scanner.acknowledge(batch[-1])
    assert len(fired) == plan.mask.count
    if baud:  # shots wait for acknowledgements, which may come late; the line goes on meanwhile, to the last A-line
        return ended - fired[0]
    return (fired[-1] - fired[0]) / (len(fired) - 1) * len(fired)


@pytest.mark.long
@pytest.mark.parametrize(
    ("limiting", "plan", "run"),
    [
        ("laser", {"pulse_rate": 50, "averages": 2, "link": Link(byte_rate=None)}, {"speed": 20}),
        ("mover", {"pulse_rate": 5000, "samples": 64, "link": Link(byte_rate=None)}, {"speed": 0.1}),
        ("link", {"pulse_rate": 100, "samples": 2048, "link": SLOW_LINE}, {"speed": 1, "baud": 460_800}),
    ],
)
def test_the_preview_agrees_with_a_simulated_run(limiting, plan, run):
    """Whatever limits a scan, preview and device time differ by less than 2 %.

    A host that waits for a processor makes a run longer: the shortest of a few is the scanner's own. A simulator that
    waits leaves statuses out: ten a second, of some fifty bytes each, are about a hundredth of what this line carries.
    """
    mask = FEW if limiting == "link" else MASK  # a slow line in real time, so that a busy machine can keep up
    wanted = ScanPlan.create(mask=mask, order="shortest", **plan)
    cost = preview(wanted)
    assert cost.limiting == limiting
    expected, found = pytest.approx(cost.total_seconds, rel=0.02), []
    while len(found) < RUNS and (not found or (min(found) > cost.total_seconds and min(found) != expected)):
        found.append(device_seconds(wanted, **run))
    assert min(found) == expected, found


def test_no_part_of_the_time_is_forgotten():
    """The whole is at least as long as its longest part."""
    for rate in (20, 500, 3000):
        cost = preview(ScanPlan.create(mask=MASK, pulse_rate=rate))
        assert cost.total_seconds >= max(cost.seconds.values()) * (1 - 1e-12)
        assert np.isfinite(cost.total_seconds)
