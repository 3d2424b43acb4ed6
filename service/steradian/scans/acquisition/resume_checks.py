"""Checks before resuming a scan: same plan, scanner, tuning and reference signal."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import fabry_perot
from steradian.core.exceptions import Conflict, ScanFailed
from steradian.plans import ScanPlan
from steradian.scans.acquisition.excitation import tune_excitation
from steradian.scans.file.create import tuning_map_hash
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.stages import stages_of
from steradian.scans.file.verify import CheckReport
from steradian.scans.file.writer import ScanFileWriter

REFERENCE_SHOTS = 16
"""Shots averaged when the reference point is measured again."""
MIN_SNR = 4.0
"""Below this ratio of power to noise an A-line proves nothing."""


class ResumeRefused(Conflict):
    """Error of a scan that cannot be resumed, because plan, scanner, tuning or reference signal differ."""

    code = "resume-refused"


@dataclass(frozen=True)
class Tolerance:
    """Tolerated differences of tuning and reference signal between the start of a scan and its resumption.

    Attributes
    ----------
    bias
        Shift of the film's bias wavelength at the reference point, in m: a quarter of a usual linewidth.
    sensitivity
        Factor by which the film's sensitivity there may have grown or fallen.
    correlation
        Least correlation of the reference A-line with its new measurement.
    gain
        Factor by which its amplitude may have grown or fallen, per pulse energy.
    """

    bias: float = 0.125e-9
    sensitivity: float = 2.0
    correlation: float = 0.8
    gain: float = 1.4


@dataclass(frozen=True)
class Check:
    """Result of one comparison between the start of a scan and its resumption.

    Attributes
    ----------
    what
        What was compared.
    then, now
        In words.
    allowed
        The tolerance in words; empty when they must be equal.
    agrees
        The outcome.
    """

    what: str
    then: str
    now: str
    allowed: str
    agrees: bool

    def __str__(self) -> str:
        """Return the comparison as text, for example "the scanner was A and is B"."""
        allowed = f" (allowed: {self.allowed})" if self.allowed else ""
        return f"{self.what} was {self.then} and is {self.now}{allowed}"


def require_all(findings: list[Check]) -> None:
    """Raise :class:`ResumeRefused` with all failed comparisons, if there are any."""
    differences = [str(finding) for finding in findings if not finding.agrees]
    if differences:
        raise ResumeRefused("the scan cannot be resumed: " + "; ".join(differences))


def check_identity(store: ScanFileWriter, plan: ScanPlan | None, capabilities: fabry_perot.Capabilities) -> list[Check]:
    """Compare plan, tuning map and scanner with those recorded in the scan file."""
    with open_for_reading(store.path) as file:
        plan_id, serial = str(file["plan"].attrs["id"]), str(file.attrs["scanner"])
        stages = stages_of(file)
        tuning, simulated = str(file.attrs["tuning_map"]), bool(file.attrs["simulated"])
    pairs = [("the scanner", serial, capabilities.serial)]
    pairs.append(("the scanner", _kind(simulated), _kind(capabilities.simulated)))
    if plan is not None:
        is_of_stage = plan.id in {stage.plan_id for stage in stages}
        pairs.append(("the plan", plan.id if is_of_stage else plan_id, plan.id))
        if not is_of_stage:
            pairs.append(("the tuning map", tuning, tuning_map_hash(plan)))
    return [Check(what, then, now, "", then == now) for what, then, now in pairs]


def record_tuning(scanner: fabry_perot.Scanner, store: ScanFileWriter) -> None:
    """Sweep the bias wavelength at the first point of a new scan and record the curve."""
    if scanner.capabilities.tuning_time:
        point = int(store.course.visit[0])
        curve = _sweep(scanner, store, point)
        store.set_reference(point, curve.bias, curve.sensitivity, curve.reflectivity)


def compare_tuning(scanner: fabry_perot.Scanner, store: ScanFileWriter, tolerance: Tolerance) -> list[Check]:
    """Repeat the tuning sweep at the scan's first point and compare; empty without a recorded sweep."""
    noted = store.reference()
    if noted is None or not scanner.capabilities.tuning_time:
        return []
    point, bias, sensitivity, _ = noted
    curve = _sweep(scanner, store, point)
    ratio = curve.sensitivity / sensitivity
    return [
        Check(
            f"the bias wavelength at point {point}",
            f"{1e9 * bias:.4f} nm",
            f"{1e9 * curve.bias:.4f} nm",
            f"±{1e9 * tolerance.bias:g} nm",
            abs(curve.bias - bias) <= tolerance.bias,
        ),
        Check(
            f"the film's sensitivity at point {point}",
            "1",
            f"{ratio:.3g} of that",
            f"{1 / tolerance.sensitivity:g} to {tolerance.sensitivity:g}",
            1 / tolerance.sensitivity <= ratio <= tolerance.sensitivity,
        ),
    ]


def check_reference_point(
    scanner: fabry_perot.Scanner, store: ScanFileWriter, report: CheckReport, tolerance: Tolerance
) -> list[Check]:
    """Re-measure the point with the strongest stored A-line and compare; empty if all signals are weak."""
    usable = np.where(store.column("quality") == 0, report.strength, 0)
    usable[np.arange(len(usable)) % store.course.beams > 0] = 0  # the first beam alone measures it again
    row = int(usable.argmax())
    then = store.read_row(row).astype(np.float64)
    if not usable[row] or _power_over_noise(then) < MIN_SNR:
        return []
    again = _measure(scanner, store, row)
    before = _pressure(then, float(store.column("scale")[row]), float(store.column("energy")[row]))
    now = _pressure(again.samples.astype(np.float64), again.scale, again.energy)
    product = float(before @ now)
    correlation = product / float(np.linalg.norm(before) * np.linalg.norm(now) or 1.0)
    gain = product / float(before @ before)
    where = f"the reference A-line at point {row % store.course.points}"
    low, high = 1 / tolerance.gain, tolerance.gain
    return [
        Check(
            where,
            "itself",
            f"correlated with it by {correlation:.3f}",
            f"at least {tolerance.correlation:g}",
            correlation >= tolerance.correlation,
        ),
        Check(where, "1", f"{gain:.3g} times as strong", f"{low:.3g} to {high:.3g}", low <= gain <= high),
    ]


def _kind(simulated: bool) -> str:
    return "simulated" if simulated else "real"


def _sweep(scanner: fabry_perot.Scanner, store: ScanFileWriter, point: int) -> fabry_perot.TuningCurve:
    x, y = store.course.positions[point].tolist()
    return scanner.tune(x, y)


def _measure(scanner: fabry_perot.Scanner, store: ScanFileWriter, row: int) -> fabry_perot.ALine:
    """Measure the point of one row again and return the A-line; its shots are added to the scan's count."""
    course = store.course
    tune_excitation(scanner, course.excitation[row // course.points])
    shots, tag = min(REFERENCE_SHOTS, scanner.capabilities.averages[1]), 1 + secrets.randbelow(0xFFFFFFFE)
    course.upload(scanner, np.array([row]), tag, averages=shots, alone=True)
    scanner.start(scanner.arm())
    found: list[fabry_perot.ALine] = []
    for batch in scanner.alines():
        found += batch
        scanner.acknowledge(batch[-1])
    if not found:
        raise ScanFailed("the scanner did not measure the reference point")
    store.record_shot_count(store.fired + scanner.report().fired)
    return found[0]


def _pressure(samples: NDArray[np.float64], scale: float, energy: float) -> NDArray[np.float64]:
    """Return the A-line (N_t,) as pressure per pulse energy, without its mean."""
    pressure: NDArray[np.float64] = (samples - samples.mean()) * (scale / (energy or 1.0))
    return pressure


def _power_over_noise(samples: NDArray[np.float64]) -> float:
    """Return the signal-to-noise power ratio of an A-line, with noise estimated from third differences."""
    noise = np.median(np.abs(np.diff(samples, 3))) / 0.6745 / np.sqrt(20.0)
    power = float(samples.var())
    return power / max(float(noise) ** 2, 1e-12) - 1
