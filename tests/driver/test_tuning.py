"""Tuning, parameters, interlock and the film, on the bench and against the simulator's own truth."""

from __future__ import annotations

import numpy as np
import pytest

import fabry_perot
from fabry_perot import TuningMap
from fabry_perot.errors import PlanInvalid, RequestRejected, ResponseTimeout
from fabry_perot.hardware import PlanSampling
from fabry_perot.simulator import launch, named_phantoms, phantoms
from fabry_perot.simulator.film import BANDWIDTH, Film, Response, directivity, low_pass
from fabry_perot.simulator.instrument import SimulatedInstrument
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.messages import POINT
from fabry_perot.wire.states import DeviceState

SWEEP = {"x": 0, "y": 0, "from_pm": 1_548_000, "to_pm": 1_552_000, "steps": 5}


def test_a_sweep_is_answered_when_it_is_done_and_carried_out_once_however_often_it_is_asked_for(bench):
    bench.connect()
    bench.instrument.tuning = 1_800_000
    swept = []
    sweep = bench.instrument.sweep
    bench.instrument.sweep = lambda *given: swept.append(given) or sweep(*given)
    before = bench.clock.now()
    assert bench.call(Operation.TUNE_SCAN, **SWEEP)["dc_mv"] == [0, 0, 0, 0, 0]
    assert bench.clock.now() - before > 1_800_000
    assert len(swept) == 1


def test_nothing_is_armed_while_a_sweep_is_under_way(bench):
    bench.connect()
    bench.upload(3)
    bench.instrument.tuning = 300_000
    sweep = bench.host.call(Operation.TUNE_SCAN, bench.clock.now(), **SWEEP)
    bench.run(20)
    with pytest.raises(RequestRejected, match="wrong-state"):
        bench.call(Operation.ARM)
    bench.until(lambda: sweep.done)
    assert bench.call(Operation.ARM)["token"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"x": 20_000_000}, r"\(x\)"),
        ({"steps": 1}, "steps"),
        ({"from_pm": 1}, "from_pm"),
        ({"y": "a"}, "malf"),
    ],
)
def test_a_sweep_beyond_the_limits_is_refused(bench, change, reason):
    bench.connect()
    with pytest.raises(RequestRejected, match=reason):
        bench.call(Operation.TUNE_SCAN, **{**SWEEP, **change})


def test_nothing_is_tuned_or_set_while_the_laser_fires(bench):
    bench.scan(100)
    for operation, body in ((Operation.TUNE_SCAN, SWEEP), (Operation.SET, {"power": 2})):
        with pytest.raises(RequestRejected, match="wrong-state"):
            bench.call(operation, **body)


def test_a_parameter_is_set_within_its_range_only(bench):
    bench.connect()
    assert bench.call(Operation.SET, power=7) == {"power": 7}
    with pytest.raises(RequestRejected, match="out-of-range"):
        bench.call(Operation.SET, power=11)
    assert bench.call(Operation.GET)["power"] == 7


def test_an_opened_interlock_latches_a_fault_and_ends_emission_at_once(bench):
    bench.scan(100)
    bench.run(100)
    opened = bench.device_now
    bench.instrument.closed = False
    bench.run(200)
    assert bench.device.state is DeviceState.FAULT
    assert bench.instrument.log[-1][0] <= opened + 1000
    bench.instrument.closed = True
    bench.call(Operation.CLEAR_FAULT)
    bench.call(Operation.RELEASE)
    bench.start()
    bench.finish()
    bench.check_exact(100)


def test_request_ids_wrap_without_being_taken_for_old_ones(bench):
    bench.connect()
    bench.host.calls._number = 0xFFFD
    for _ in range(6):
        assert bench.call(Operation.GET)["shots"] == 0


def test_request_without_response_raises_response_timeout(bench, faults):
    bench.connect()
    bench.up.filters.append(faults.drop(Operation.GET, lambda count: True))
    bench.down.filters.append(faults.drop(0x83, lambda count: True))
    with pytest.raises(ResponseTimeout, match="GET after 5 tries"):
        bench.call(Operation.GET)


def test_pretune_real_film_saves_accurate_map_and_detects_drift(tmp_path):
    where = np.random.default_rng(0).uniform(-5e-3, 5e-3, (12, 2)).round(6)
    film = Film(3)
    truth = np.array([film.bias(round(x * 1e9), round(y * 1e9)) for x, y in where]) * 1e-12
    with launch(speed=50, seed=3, film="real") as simulator, fabry_perot.connect(simulator.url) as scanner:
        tuned = scanner.pretune(where, steps=201)
        tuned.save(tmp_path / "map.npz")
        simulator.send_command("drift", pm=200)
        drift = TuningMap.load(tmp_path / "map.npz").compare(scanner.pretune(where, steps=201))
        assert scanner.set(interrogation_uw=500)["interrogation_uw"] == 500
        weaker = scanner.tune(*where[0])
        with pytest.raises(PlanInvalid, match="interrogation_uw"):
            scanner.set(colour=1)
        with pytest.raises(PlanInvalid, match="100"):
            scanner.set(interrogation_uw=1)
        with pytest.raises(PlanInvalid, match="points"):
            scanner.pretune([])
    assert np.abs(tuned.wavelength - truth).max() < 30e-12, "the same flank everywhere, or signals differ in sign"
    assert np.median(drift.shift) == pytest.approx(200e-12, abs=20e-12)
    assert len(drift.stale) >= 10
    assert weaker.reflectivity == pytest.approx(tuned.reflectivity[0] / 2, rel=0.05)


def test_maps_of_different_points_cannot_be_compared():
    one = TuningMap(np.zeros((2, 2)), np.ones(2), np.ones(2), np.ones(2))
    with pytest.raises(PlanInvalid, match="same points"):
        one.compare(TuningMap(np.ones((2, 2)), np.ones(2), np.ones(2), np.ones(2)))


def test_a_point_far_from_its_bias_is_flagged_and_on_a_real_film_hardly_hears(tmp_path):
    where = np.zeros((2, 2))
    bias = Film(0).bias(0, 0) * 1e-12
    with (
        launch(speed=50, film="nonlinear", noise_db=float("inf")) as simulator,
        fabry_perot.connect(simulator.url) as scanner,
    ):
        scanner.upload(where, samples=1200, sampling_interval=8e-9, pulse_rate=50.0, wavelength=[bias, bias + 0.9e-9])
        scanner.start(scanner.arm())
        lines = []
        for batch in scanner.alines():
            lines += batch
            scanner.acknowledge(batch[-1])
        with pytest.raises(PlanInvalid, match="wavelength"):
            scanner.upload(where, samples=64, sampling_interval=8e-9, pulse_rate=50.0, wavelength=1e-6)
        with pytest.raises(PlanInvalid, match="wavelength"):
            scanner.upload(where, samples=64, sampling_interval=8e-9, pulse_rate=50.0, wavelength=[bias] * 3)
        with pytest.raises(PlanInvalid, match="start"):
            scanner.upload(where, samples=64, sampling_interval=8e-9, pulse_rate=50.0, start=2)
    assert [line.quality for line in lines] == [0, 2]
    assert np.abs(lines[1].samples.astype(int)).max() < 0.3 * np.abs(lines[0].samples.astype(int)).max()
    assert lines[0].wavelength_m == pytest.approx(bias)


def test_the_films_transfer_is_linear_for_weak_sound_and_bends_for_strong():
    film = Film(1)
    bias = film.bias(0, 0)
    weak = film.transfer(0, 0, bias, np.array([1e-4, -1e-4]))
    assert weak == pytest.approx([1e-4, -1e-4], rel=2e-3)
    strong = film.transfer(0, 0, bias, np.array([0.5, -0.5]))
    assert np.abs(strong).max() < 0.5


def test_the_films_low_pass_halves_the_power_at_its_bandwidth():
    interval, count = 1e-9, 4096
    rows = np.sin(2 * np.pi * BANDWIDTH * np.arange(count) * interval)[None].astype(np.float32)
    passed = low_pass(rows, interval)[0, 1000:3000]
    assert passed.std() / rows[0, 1000:3000].std() == pytest.approx(0.5**0.5, rel=0.01)


def test_the_film_hears_from_the_front_and_not_from_the_side():
    assert directivity(np.array([1.0, 0.9, 0.0])) == pytest.approx([1.0, 1.0, 0.2], abs=0.05)


@pytest.mark.parametrize("response", [Response(), Response(nonlinear=True, bandwidth=True, directivity=True)])
def test_every_film_records_within_16_bits_and_a_small_range_clips_with_a_flag(response):
    from fabry_perot.hardware.instrument import PlanSampling
    from fabry_perot.wire.messages import POINT

    point = np.zeros(1, POINT)
    for full_scale, flag in ((2.0, 0), (0.02, 1)):
        instrument = SimulatedInstrument(phantoms.yarn(0), response=response, full_scale=full_scale)
        instrument.begin(PlanSampling(1200, 8000, 50_000))
        assert instrument.measure(point[0], shot=1).quality == flag


@pytest.mark.parametrize("name", named_phantoms.NAMES)
def test_every_phantom_lies_under_the_film_and_is_the_same_for_the_same_seed(name):
    balls = named_phantoms.by_name(name, 4)
    assert balls.centres[:, 2].min() > 0.1e-3
    assert np.abs(balls.centres[:, :2]).max() < 8e-3
    assert np.array_equal(balls.centres, named_phantoms.by_name(name, 4).centres)


def test_a_phantom_from_a_file_is_its_balls_or_its_volumes_strongest_voxels(tmp_path):
    balls = named_phantoms.star()
    np.savez(tmp_path / "a.npz", centres=balls.centres, sigmas=balls.sigmas, amplitudes=balls.amplitudes)
    assert np.array_equal(named_phantoms.by_name(str(tmp_path / "a.npz")).centres, balls.centres)
    volume = np.zeros((3, 4, 5))
    volume[1, 2, 3] = 2.0
    np.savez(tmp_path / "b.npz", volume=volume, spacing=[1e-4] * 3, origin=[0, 0, 1e-3])
    one = named_phantoms.from_file(tmp_path / "b.npz")
    assert one.centres.tolist() == [pytest.approx([1e-4, 2e-4, 1.3e-3])]
    assert one.amplitudes.tolist() == [2.0]
    np.savez(tmp_path / "c.npz", other=volume)
    with pytest.raises(ValueError, match="expected: balls"):
        named_phantoms.from_file(tmp_path / "c.npz")
    np.savez(tmp_path / "d.npz", volume=0 * volume, spacing=[1e-4] * 3, origin=[0, 0, 1e-3])
    with pytest.raises(ValueError, match="all zero"):
        named_phantoms.from_file(tmp_path / "d.npz")


@pytest.mark.parametrize(("relief", "alike", "unlike"), [("scatter", 5e-6, 100e-6), ("domains", 2e-6, 8e-3)])
def test_film_resonance_is_correlated_only_within_relief_length(relief, alike, unlike):
    """Resonances at places so near each other are the same, at places so far apart they are not."""
    film, random = Film(1, relief), np.random.default_rng(0)
    places = (random.integers(-250, 250, (200, 2)) * 20_000 + 7_000).tolist()
    near = [film.resonance(x, y) == film.resonance(x + round(alike * 1e9), y) for x, y in places]
    far = [film.resonance(x, y) == film.resonance(x - round(unlike * 1e9) * (1 if x > 0 else -1), y) for x, y in places]
    assert np.mean(near) > 0.95
    assert np.mean(far) < 0.3
    found = [film.resonance(x, y) for x, y in places]
    assert 1_548_000 <= min(found) < 1_549_000
    assert 1_551_000 < max(found) <= 1_552_000


def test_a_wedge_rises_evenly():
    film = Film(1, "wedge")
    rise = np.diff([film.resonance(x, 0) for x in range(-5_000_000, 5_000_001, 1_000_000)])
    np.testing.assert_allclose(rise, rise[0])
    assert rise[0] > 0


def test_the_laser_tunes_only_after_the_record_and_in_the_time_it_was_given():
    instrument = SimulatedInstrument(phantoms.yarn(0), seed=3, tuning=5_000)
    places = np.zeros(4, POINT)
    places["wavelength"], places["averages"] = [1_549_000, 1_551_000] * 2, 1
    instrument.boot(0)
    instrument.begin(PlanSampling(1024, 8_000, 1_000_000))
    instrument.queue_points(0, places, 0)
    instrument.open()
    instrument.permit(1 << 40, 0)
    taken, now = [], 0
    while len(taken) < 4:
        taken += instrument.poll(now)
        now = instrument.next_due(now) or now
    gaps = np.diff([each.fire_time for each in taken])
    assert np.round(gaps / 1000).tolist() == [6, 6, 6], "5 ms and 8 µs of record miss the fifth pulse"
