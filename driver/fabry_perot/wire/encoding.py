"""Encodings of an A-line's samples: int16, or Rice-coded differences.

Delta + Rice (encoding 1), losslessly: the difference to the sample before (the first to 0) is folded to an unsigned
number, ``u = 2d`` or ``−2d − 1``. Samples go in blocks of 32, each with a parameter k: the low k bits of every u are
sent as they are, the rest ``u >> k`` in unary. Layout, bits most significant first:

======================  ===============================================================================
bytes                   content
======================  ===============================================================================
⌈N/32⌉                  k of each block, 0 … 17
⌈Σ k/8⌉                 low bits of all samples, in order, k of its block each; padded with zeros
the rest                per sample ``u >> k`` zeros and a one; padded with zeros
======================  ===============================================================================

The parts lie apart so that both can be decoded by whole-array operations.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fabry_perot.errors import FrameError

BLOCK = 32
"""Samples that share a parameter k."""
MAX_K = 17


class Encoding(IntEnum):
    """Encodings of an A-line's samples, with their numbers in ALINE."""

    INT16 = 0
    DELTA_RICE = 1


NAMES = {"int16": Encoding.INT16, "delta-rice": Encoding.DELTA_RICE}
"""Encodings as an application asks for them."""


def encode(samples: NDArray[np.int16], encoding: int) -> tuple[int, bytes]:
    """Return encoding and bytes of samples; int16 if the compressed form would be longer."""
    plain = samples.astype("<i2", copy=False).tobytes()
    if encoding != Encoding.DELTA_RICE or len(samples) == 0:
        return Encoding.INT16, plain
    packed = _pack(samples)
    return (Encoding.DELTA_RICE, packed) if len(packed) < len(plain) else (Encoding.INT16, plain)


def decode(data: bytes, encoding: int, samples: int) -> NDArray[np.int16]:
    """Return the decoded samples as (``samples``,) int16.

    Raises
    ------
    FrameError
        The encoding is unknown, or ``data`` is not what the encoder makes of so many samples.
    """
    if encoding == Encoding.INT16:
        if len(data) != 2 * samples:
            raise FrameError(f"{len(data)} bytes for {samples} samples")
        return np.frombuffer(data, "<i2").astype(np.int16, copy=False)
    if encoding == Encoding.DELTA_RICE:
        return _unpack(data, samples)
    raise FrameError(f"unknown encoding {encoding}")


def _pack(samples: NDArray[np.int16]) -> bytes:
    count = len(samples)
    delta = np.diff(samples.astype(np.int32), prepend=np.int32(0))
    folded = np.where(delta >= 0, 2 * delta, -2 * delta - 1)
    blocks = -(-count // BLOCK)
    padded = np.zeros(blocks * BLOCK, np.int64)
    padded[:count] = folded
    mean = padded.reshape(blocks, BLOCK).mean(axis=1)
    k = np.clip(np.floor(np.log2(0.6931 * mean + 1e-9)) + 1, 0, MAX_K).astype(np.int64)
    each = np.repeat(k, BLOCK)[:count]
    low = _low_bits(folded, each)
    quotients = folded >> each
    unary = np.zeros(int(quotients.sum()) + count, np.uint8)
    unary[np.cumsum(quotients + 1) - 1] = 1
    return bytes(k.astype(np.uint8).tobytes() + np.packbits(low).tobytes() + np.packbits(unary).tobytes())


def _low_bits(folded: NDArray[np.int64], each: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the low bits of all samples, one bit per byte."""
    sample = np.repeat(np.arange(len(each)), each)
    place = np.arange(len(sample)) - (np.cumsum(each) - each)[sample]
    bits: NDArray[np.uint8] = ((folded[sample] >> (each[sample] - 1 - place)) & 1).astype(np.uint8)
    return bits


def _unpack(data: bytes, count: int) -> NDArray[np.int16]:
    raw = np.frombuffer(data, np.uint8)
    blocks = -(-count // BLOCK)
    parameters = raw[:blocks]
    if count == 0 or len(parameters) != blocks or parameters.max() > MAX_K:
        raise FrameError("a Rice code without its parameters")
    each = np.repeat(parameters.astype(np.int32), BLOCK)[:count]
    ends = np.cumsum(each, dtype=np.int32)
    low_bytes = (int(ends[-1]) + 7) // 8
    ones = np.flatnonzero(np.unpackbits(raw[blocks + low_bytes :]))
    if len(ones) != count or len(data) != blocks + low_bytes + (int(ones[-1]) + 8) // 8:
        raise FrameError("a Rice code of the wrong length")
    start = ends - each
    window = np.zeros(low_bytes + 4, np.int32)
    window[:low_bytes] = raw[blocks : blocks + low_bytes]
    wide = (window[:-3] << 16) | (window[1:-2] << 8) | window[2:-1]  # 24 bits from each byte on: 17 and a shift of 7
    low = (wide[start >> 3] >> (24 - (start & 7) - each)) & ((1 << each) - 1)
    folded = (np.diff(ones, prepend=-1).astype(np.int64) - 1 << each) | low
    delta = (folded >> 1) ^ -(folded & 1)
    values = np.cumsum(delta)
    if values.min() < -32768 or values.max() > 32767:
        raise FrameError("a Rice code of samples beyond 16 bits")
    return values.astype(np.int16)
