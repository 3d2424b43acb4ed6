"""Weighted linear least squares of spectra, with the covariance of an image's background as error model."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput

Floats = NDArray[np.float64]
_NORMAL = 1.4826  # standard deviation of normally distributed values over the median of their absolute values
_FAR = 3.0  # standard deviations beyond which a voxel is not background
_SMOOTH = np.array([1, 2, 3, 2, 1]) / 9  # over depths
MOST_CHROMOPHORES = 6


def background_covariance(volumes: NDArray[Any]) -> Floats:
    """Return the covariance between wavelengths of an image series' background at each depth, (z, K, K).

    Noise and streaks of voxels without an object: those within three standard deviations at all wavelengths. Variances
    are by the median of absolute values at a depth, right where objects leave most voxels empty.

    Parameters
    ----------
    volumes
        Images, shape (K, x, y, z).
    """
    thinned = np.asarray(volumes[:, ::2, ::2] if min(volumes.shape[1:3]) > 8 else volumes, np.float64)
    deviations = _deviations(np.abs(thinned))
    empty = (np.abs(thinned) < _FAR * deviations[:, None, None]).all(axis=0)
    deviations = _deviations(np.where(empty, np.abs(thinned), np.nan))
    scaled = np.where(empty, thinned / deviations[:, None, None], 0.0)
    products = np.einsum("kxyz,lxyz->zkl", scaled, scaled)
    norms = np.sqrt(np.einsum("zkk->zk", products))
    correlations = products / np.maximum(norms[:, :, None] * norms[:, None, :], np.finfo(np.float64).tiny)
    count = len(volumes)
    correlations = 0.999 * correlations + 0.001 * np.eye(count)  # invertible for identical images
    correlations[:, range(count), range(count)] = 1.0
    return np.asarray(correlations * deviations.T[:, :, None] * deviations.T[:, None, :])


def _deviations(absolute: Floats) -> Floats:
    """Return standard deviations (K, z) by the median of absolute values, NaN left out, smoothed over depths."""
    medians = np.maximum(_NORMAL * np.nanmedian(absolute, axis=(1, 2)), np.finfo(np.float32).tiny)
    return np.array([np.convolve(np.pad(row, 2, mode="edge"), _SMOOTH, "valid") for row in medians])


def brightest_spectra(volumes: NDArray[Any], covariance: Floats, most: int) -> tuple[Floats, NDArray[np.int64]]:
    """Return the spectra (K, n) of at most ``most`` voxels that rise highest above the background, and their slices.

    Raises
    ------
    InvalidInput
        If no voxel rises above five standard deviations.
    """
    deviations = np.sqrt(np.einsum("zkk->kz", covariance))
    heights = (volumes / deviations[:, None, None]).mean(axis=0)
    flat = heights.ravel()
    chosen = np.argpartition(flat, -min(most, flat.size))[-min(most, flat.size) :]
    chosen = chosen[flat[chosen] > 5.0]
    if not len(chosen):
        raise InvalidInput(
            "volumes", f"{flat.max():.2g} standard deviations at most", "a voxel above 5, with an object"
        )
    places = np.unravel_index(chosen, heights.shape)
    return np.asarray(volumes[(slice(None), *places)], np.float64), places[-1].astype(np.int64)


def misfit(spectra: Floats, absorption: Floats, fluence: Floats, covariance: Floats) -> Floats:
    """Return the whitened residuals (K, n) of spectra (K, n) fitted by a matrix (K, I) times a fluence (K, n)."""
    roots = np.linalg.inv(np.linalg.cholesky(covariance))
    data = np.einsum("nkl,ln->nk", roots, spectra)
    model = np.einsum("nkl,ln,li->nki", roots, fluence, absorption)
    basis, _ = np.linalg.qr(model)
    return np.asarray((data - np.einsum("nki,nli,nl->nk", basis, basis, data)).T)


def squared_height(spectra: Floats, covariance: Floats) -> Floats:
    """Return χ² (n,) of spectra (K, n) against none, with the covariance (K, K) of one spectrum."""
    return np.asarray(np.sum((np.linalg.inv(np.linalg.cholesky(covariance)) @ spectra) ** 2, axis=0))


def solve_spectra(
    spectra: Floats, absorption: Floats, covariance: Floats, *, non_negative: bool
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return weighted least-squares solutions (I, n), their covariance (I, I), explained and left χ² (n,).

    Non-negative solutions are found by trying all sets of chromophores. The covariance is that without the constraint.

    Parameters
    ----------
    spectra
        Divided by the fluence, shape (K, n).
    absorption
        Shape (K, I).
    covariance
        Of one spectrum, divided by the fluence, too, shape (K, K).
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    data, model = root @ spectra, root @ absorption
    normal = model.T @ model
    count = model.shape[1]
    best = np.linalg.lstsq(model, data, rcond=None)[0]
    if non_negative:
        wrong = (best < 0).any(axis=0)
        best[:, wrong] = _non_negative(model, data[:, wrong], count)
    explained = np.einsum("in,ij,jn->n", best, normal, best)
    left = np.sum((data - model @ best) ** 2, axis=0)
    return np.asarray(best, np.float64), np.asarray(np.linalg.inv(normal)), np.asarray(explained), np.asarray(left)


def _non_negative(model: Floats, data: Floats, count: int) -> Floats:
    """Return the non-negative solution of each column by trying all proper subsets of unknowns."""
    best = np.zeros((count, data.shape[1]))
    least = np.sum(data**2, axis=0)
    for size in range(1, count):
        for members in map(list, combinations(range(count), size)):
            part = model[:, members]
            found = np.linalg.lstsq(part, data, rcond=None)[0]
            left = np.sum((data - part @ found) ** 2, axis=0)
            better = (found >= 0).all(axis=0) & (left < least)
            best[:, better] = 0.0
            best[np.ix_(np.array(members), np.flatnonzero(better))] = found[:, better]
            least = np.where(better, left, least)
    return best
