"""A writer and a reader of .sgl files, independent of the importer's."""

from math import prod

import numpy as np

NAME = "palm@750nm_t0[0]_dx[200µm]_dy[300µm]_dt[20ns]_39s19m20h_10-07-15_avg16_2D_raw.SGL"
TRAILER = (1, 16, 1, 20, 750, 21.5, 3.5, -2.0)
"""Pulse index, averages, Santec, cut-off in MHz, excitation in nm, energy, x0 and y0 in mm."""


def write_sgl(path, *, counts=(12, 8), steps=(200, 300), interval=20, samples=None, trailer=TRAILER):
    """Write a file of samples (M, N_t), x fastest; noise if none are given."""
    if samples is None:
        samples = np.random.default_rng(3).normal(size=(prod(counts), 128))
    header = [*counts, samples.shape[1], *steps, interval]
    parts = (header, np.ascontiguousarray(np.asarray(samples).T).ravel(), trailer)
    with np.errstate(over="ignore"):
        path.write_bytes(b"".join(np.asarray(part, ">f4").tobytes() for part in parts))
    return path


def read_sgl(path):
    """Read a file: samples (M, N_t), positions (M, 2) in m and all numbers."""
    numbers = np.frombuffer(path.read_bytes(), ">f4").astype(np.float64)
    nx, ny, nt = (int(each) for each in numbers[:3])
    dx, dy = 1e-6 * numbers[3:5]
    total = nx * ny * nt
    trailer = numbers[6 + total :]
    first = []
    for place, count, step in ((6, nx, dx), (7, ny, dy)):
        given = trailer[place] if len(trailer) > place else np.nan
        first.append(1e-3 * given if abs(given) <= 1e3 else -(count // 2) * step if count > 1 else 0.0)
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    steps = [step if count > 1 else 0.0 for step, count in ((dx, nx), (dy, ny))]
    positions = np.column_stack([first[0] + steps[0] * x.ravel(), first[1] + steps[1] * y.ravel()])
    samples = numbers[6 : 6 + total].reshape(nt, nx * ny).T.astype(np.float32)
    return {"samples": samples, "positions": positions, "interval": 1e-9 * numbers[5], "trailer": trailer}
