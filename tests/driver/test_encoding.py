"""Packed A-lines are the same A-lines: the code against itself and a bit-by-bit reading of the document."""

from __future__ import annotations

import numpy as np
import pytest
from driver_bench import Bench, truth
from driver_reference import rice
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fabry_perot.errors import FrameError, PlanInvalid
from fabry_perot.host import WirePlan
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.simulator.phantoms import yarn
from fabry_perot.wire.encoding import Encoding, decode, encode


@given(arrays(np.int16, st.integers(1, 300)), st.integers(0, 15))
@settings(deadline=None)
def test_any_samples_come_back_bit_by_bit(samples, shift):
    samples = samples >> shift
    used, data = encode(samples, Encoding.DELTA_RICE)
    assert np.array_equal(decode(data, used, len(samples)), samples)
    assert len(data) <= 2 * len(samples), "packing never makes an A-line longer"


def smooth(count: int) -> np.ndarray:
    random = np.random.default_rng(1)
    return (2000 * np.sin(np.arange(count) / 9) + random.normal(0, 30, count)).astype(np.int16)


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1024])
def test_independent_rice_decoder_returns_same_samples(count):
    samples = smooth(count)
    used, data = encode(samples, Encoding.DELTA_RICE)
    if count > 32:
        assert used == Encoding.DELTA_RICE
    assert (rice(data, count) if used else samples.tolist()) == samples.tolist()


def test_a_lines_of_little_noise_shrink_by_a_third():
    assert len(encode(smooth(1024), Encoding.DELTA_RICE)[1]) < 1024 * 2 * 0.65


def test_the_extremes_of_16_bits_survive():
    samples = np.array([-32768, 32767, -32768, 0, 32767] * 7, np.int16)
    used, data = encode(samples, Encoding.DELTA_RICE)
    assert np.array_equal(decode(data, used, len(samples)), samples)


@pytest.mark.parametrize("change", [lambda d: d[:-1], lambda d: d + b"\0", lambda d: b"\x12" + d[1:], lambda d: b""])
def test_damaged_packed_samples_are_refused_not_guessed(change):
    _, data = encode(smooth(200), Encoding.DELTA_RICE)
    with pytest.raises(FrameError):
        decode(change(data), Encoding.DELTA_RICE, 200)


@given(st.binary(max_size=200), st.integers(0, 200), st.integers(0, 3))
@settings(deadline=None)
def test_random_bytes_decode_to_something_or_are_refused(data, count, encoding):
    try:
        assert decode(data, encoding, count).shape == (count,)
    except FrameError:
        return


def test_a_code_that_leaves_16_bits_is_refused():
    bits = np.zeros(2 * 17 + 2, np.uint8)
    bits[:17], bits[17:34] = 0, 0
    packed = bytes([17]) + np.packbits([1] * 16 + [0]).tobytes() + np.packbits([1]).tobytes()
    with pytest.raises(FrameError, match="16 bits"):
        decode(packed, Encoding.DELTA_RICE, 1)


def test_a_scan_may_ask_for_packed_a_lines(make_bench):
    bench: Bench = make_bench(max_payload=641)
    bench.instrument.make = lambda index: smooth(700)
    bench.connect()
    points = np.zeros(5, bench_point())
    points["averages"] = 1
    plan = WirePlan(points, 700, 8000, 200_000, encoding=Encoding.DELTA_RICE)
    call = bench.host.upload(plan, bench.clock.now())
    bench.until(lambda: call.done and bench.device.state.name == "READY")
    bench.start()
    bench.finish()
    assert all(np.array_equal(line.samples, smooth(700)) for line in bench.stored)
    assert len(bench.stored) == 5
    assert truth(0, 3).shape == (3,)


def bench_point():
    from fabry_perot.wire.messages import POINT

    return POINT


def known(**changes) -> Capabilities:
    instrument = SimulatedInstrument(yarn(0))
    return Capabilities.from_map({**instrument.capabilities(), "lease_cap_us": 1, **changes})


@pytest.mark.parametrize(
    ("name", "changes", "number"),
    [
        ("auto", {}, 0),
        ("auto", {"line_rate": 92160}, 1),
        ("auto", {"line_rate": 92160, "encodings": [0]}, 0),
        ("delta-rice", {}, 1),
        ("int16", {"line_rate": 92160}, 0),
    ],
)
def test_packing_is_chosen_where_the_line_is_the_bottleneck(name, changes, number):
    assert known(**changes).encoding(name) == number


@pytest.mark.parametrize(("name", "encodings"), [("zip", [0, 1]), ("delta-rice", [0])])
def test_unsupported_encoding_raises_plan_invalid_listing_supported(name, encodings):
    with pytest.raises(PlanInvalid, match="auto"):
        known(encodings=encodings).encoding(name)


@pytest.mark.parametrize("lack", ["model", "x_nm", "encodings", "samples"])
def test_capabilities_that_lack_something_are_refused(lack):
    data = {**SimulatedInstrument(yarn(0)).capabilities(), "lease_cap_us": 1}
    del data[lack]
    with pytest.raises(FrameError, match=lack):
        Capabilities.from_map(data)
