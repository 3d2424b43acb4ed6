"""Made A-lines of balls by their closed form, and A-lines spoilt in five known ways."""

from dataclasses import dataclass

import numpy as np

STEP, SPEED, SAMPLES = 16e-9, 1500.0, 256
KINDS = ("dead", "noisy", "inverted", "saturated", "shifted")


def square(side, aperture):
    """Return positions (side², 2) of a square grid of sensors in m."""
    line = ((np.arange(side) + 0.5) / side - 0.5) * aperture
    return np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2)


def points(rng, aperture, count=60):
    """Return centres (n, 3) and radii (n,) of balls in m."""
    centres = np.column_stack([rng.uniform(-aperture / 2, aperture / 2, (count, 2)), rng.uniform(2e-3, 4e-3, count)])
    return centres, rng.uniform(80e-6, 150e-6, count)


def vessels(rng, aperture, count=10):
    """Return balls in rows, 150 um apart, along straight lines across the aperture."""
    rows = []
    for _ in range(count):
        turn, along = rng.uniform(0, np.pi), np.arange(-0.7 * aperture, 0.7 * aperture, 150e-6)
        x, y = rng.uniform(-aperture / 2, aperture / 2, 2)
        z = rng.uniform(2e-3, 4e-3) + 0.1 * rng.uniform(-1, 1) * along
        row = np.column_stack([x + along * np.cos(turn), y + along * np.sin(turn), z])
        rows.append(row[(np.abs(row[:, :2]) < 0.6 * aperture).all(axis=1) & (z > 1.5e-3)])
    centres = np.concatenate(rows)
    return centres, np.full(len(centres), 120e-6)


def pressure(positions, centres, radii):
    """Return A-lines (n, SAMPLES): the sum over balls of (d - ct)/d while |d - ct| is less than the radius."""
    traces, pitch = np.zeros((len(positions), SAMPLES)), SPEED * STEP
    for centre, radius in zip(centres, radii, strict=True):
        distance = np.sqrt(((positions - centre[:2]) ** 2).sum(axis=1) + centre[2] ** 2)
        first = np.floor((distance - radius) / pitch).astype(int)
        for column in range(int(2 * radius / pitch) + 3):
            at = first + column
            rows = np.flatnonzero((at >= 0) & (at < SAMPLES))
            behind = distance[rows] - pitch * at[rows]
            traces[rows, at[rows]] += np.where(np.abs(behind) < radius, behind / distance[rows], 0)
    return traces


@dataclass
class Faulty:
    """Codes (n, SAMPLES) as they should be and with faults, and the kind of fault by A-line."""

    clean: np.ndarray
    codes: np.ndarray
    truth: dict

    def of(self, kind):
        """Return the A-lines with this fault."""
        return sorted(aline for aline, one in self.truth.items() if one == kind)


def spoil(traces, rng, noise, share=0.01, shifts=(25, 60)):
    """Scale A-lines to a peak of 2000 codes, add noise (share of the peak) and spoil a share of them, five kinds alike.

    Dead ones have noise alone, noisy ones eight times as much more, saturated ones end at 0.4 of their peak, shifted
    ones come 25 to 60 samples early or late.
    """
    sigma = 2000 * noise
    clean = traces * (2000 / np.abs(traces).max()) + rng.normal(0, sigma, traces.shape)
    each = max(1, round(len(traces) * share / len(KINDS)))
    chosen = rng.choice(len(traces), (len(KINDS), each), replace=False)
    dead, noisy, inverted, saturated, shifted = chosen
    codes = clean.copy()
    codes[dead] = rng.normal(0, sigma, (each, traces.shape[1]))
    codes[noisy] += rng.normal(0, 8 * sigma, (each, traces.shape[1]))
    codes[inverted] *= -1
    end = 0.4 * np.abs(codes[saturated]).max(axis=1, keepdims=True)
    codes[saturated] = np.clip(codes[saturated], -end, end)
    for row in shifted:
        codes[row] = np.roll(codes[row], rng.choice([-1, 1]) * rng.integers(*shifts))
    truth = {int(row): kind for kind, rows in zip(KINDS, chosen, strict=True) for row in rows}
    return Faulty(clean.round().astype(np.int16), codes.round().astype(np.int16), truth)
