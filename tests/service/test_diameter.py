"""Diameters of vessels: lines across against closed forms, and whole scans of vessels of known diameter."""

import csv
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from steradian import InvalidInput, Volume
from steradian.imaging import VoxelAxes
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, pressure
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.run import reconstruct_in_memory
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series
from steradian.reconstructions.studies.diameter import VesselLines, measure_diameter, measure_diameters
from steradian.reconstructions.studies.diameter_scale import gaussian_scale
from steradian.scans.recording import Recording
from support.commands import run_here

GAUSSIAN = np.sqrt(8 * np.log(2))
DEPTH, SPEED, INTERVAL = 2.5e-3, 1500.0, 8e-9
ANGLE, PLACE = 0.6, np.array([0.4e-3, -0.3e-3, DEPTH])
LINE = 20e-6 * (np.arange(101) - 50)


def tube(fwhm, slope=0.3):
    """A Gaussian tube through the middle, in the sensors' plane."""
    x, y, z = np.meshgrid(LINE, LINE, LINE, indexing="ij")
    along = np.array([slope, 1.0, 0.0]) / np.hypot(slope, 1.0)
    square = x**2 + y**2 + z**2 - (x * along[0] + y * along[1]) ** 2
    values = np.exp(-square / (2 * (fwhm / GAUSSIAN) ** 2))
    return Volume(values.astype(np.float32), VoxelAxes(LINE, LINE, LINE), (20e-6,) * 3)


TUBE = tube(150e-6)


def test_lines_across_an_oblique_tube_have_its_width():
    lines = VesselLines.at(TUBE, (60e-6, 40e-6, -50e-6))
    np.testing.assert_allclose(abs(lines.across @ [1.0, -0.3, 0]) / np.hypot(1, 0.3), 1, atol=1e-3)
    assert [each.fwhm for each in lines.widths(TUBE)] == pytest.approx([150e-6] * 9, rel=0.02)


def test_scale_of_a_gaussian_point_spread_is_that_of_a_blurred_disc():
    step, spread = 4e-6, 80e-6
    line = step * np.arange(-100, 101)
    scale = gaussian_scale(spread)
    for diameter in (100e-6, 250e-6):
        fine = step * (np.arange(5) - 2) / 5
        disc = np.mean([(line[:, None] + a) ** 2 + (line + b) ** 2 <= diameter**2 / 4 for a in fine for b in fine], 0)
        across = gaussian_filter(disc, spread / GAUSSIAN / step)[100]
        width = 2 * np.interp(-across[100] / 2, -across[100:], line[100:])
        found, slope = scale.diameter(width)
        assert found == pytest.approx(diameter, rel=0.01)
        assert slope > 0
    assert scale.diameter(0.9 * spread) == (None, 0.0)


def test_stated_point_spread_corrects_and_its_absence_is_a_reason():
    corrected = measure_diameter(TUBE, (0, 0, 0), point_spread=80e-6)
    assert 100e-6 < corrected.diameter < 170e-6
    assert corrected.standard_error < 5e-6
    plain = measure_diameter(TUBE, (0, 0, 0))
    assert plain.diameter is None
    assert plain.fwhm == pytest.approx(150e-6, rel=0.02)
    assert plain.reason == "neither the scan nor a point spread was given"
    narrow = measure_diameter(TUBE, (0, 0, 0), point_spread=145e-6)
    assert narrow.diameter is None
    assert 50e-6 < narrow.at_most < 145e-6
    assert "not wider than 1.1 times the point spread" in narrow.reason


def test_place_without_a_vessel_and_values_out_of_range_are_refused():
    profile = np.exp(-(LINE**2) / (2 * (150e-6 / GAUSSIAN) ** 2))
    ball = Volume(np.einsum("i,j,k->ijk", profile, profile, profile), TUBE.axes, TUBE.spacing)
    for volume, place, options, told in (
        (ball, (0, 0, 0), {}, "a place on an elongated object that is not upright"),
        (TUBE, (0, 0, 2e-3), {}, r"place\.z is 0\.002"),
        (TUBE, (0, 0), {}, "x, y, z in metres"),
        (TUBE, (0, 0, 0), {"point_spread": 0}, r"point_spread is 0; allowed: above 0, at most 0\.01 m"),
        (TUBE, (0, 0, 0), {"lines": 2}, "lines is 2; allowed: a whole number from 3 to 200"),
        (TUBE, (0, 0, 0), {"length": 1.0}, r"length is 1\.0; allowed: above 0, at most 0\.02 m"),
    ):
        with pytest.raises(InvalidInput, match=told):
            measure_diameter(volume, place, **options)


def vessel(diameter, angle, place):
    """Fine balls that fill a cylinder in the sensors' plane evenly: closed-form A-lines, no operator of ours."""
    s = max(diameter / 16, 8e-6)
    pitch = 1.5 * s
    count = int(np.ceil(diameter / 2 / pitch))
    grid, fine = np.arange(-count, count + 1) * pitch, ((np.arange(8) + 0.5) / 8 - 0.5) * pitch
    share = np.array(
        [[((a + fine[:, None]) ** 2 + (b + fine) ** 2 <= (diameter / 2) ** 2).mean() for b in grid] for a in grid]
    )
    a, b = (grid[index] for index in np.nonzero(share))
    along = np.arange(-1.2e-3, 1.2e-3, pitch)
    centres = np.stack([np.repeat(a, len(along)), np.tile(along, len(a)), np.repeat(b, len(along))], axis=1)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    amplitudes = np.repeat(share[share > 0], len(along)) * (1.5 / np.sqrt(2 * np.pi)) ** 3
    return Balls(centres @ turn.T + place, np.full(len(centres), s), amplitudes)


@cache
def scan(diameter, angle=ANGLE):
    """The vessel seen by 1,000 equi-steradian points on 8 mm, noise 30 dB below the largest sample."""
    mask = equi_steradian_mask(aperture=8e-3, depth=DEPTH, count=1000)
    places = np.asarray(mask.positions)
    traces = pressure(
        vessel(diameter, angle, PLACE), places, samples=420, sampling_interval=INTERVAL, sound_speed=SPEED
    )
    noise = np.random.default_rng(1).standard_normal(traces.shape).astype(np.float32)
    traces += noise * np.abs(traces).max() * np.float32(10**-1.5)
    return Recording(traces, 1.0, places, np.asarray(mask.weights), INTERVAL, SPEED, mask.aperture, 0.0, None, None,
                     len(places), {})  # fmt: skip


def image(recording, highest):
    parameters = ReconstructionParameters.create(modes=133, depth_range=(1.5e-3, 3.5e-3), highest_frequency=highest)
    return reconstruct_in_memory(recording, parameters), parameters


@pytest.mark.long
def test_diameters_of_100_150_and_250_micrometres_are_found_with_one_scale():
    scans = [scan(diameter) for diameter in (100e-6, 150e-6, 250e-6)]
    (first, parameters), *others = (image(each, 20e6) for each in scans)
    place = PLACE + 0.2e-3 * np.array([np.sin(ANGLE), np.cos(ANGLE), 0])
    volumes = [first, *(volume for volume, _ in others)]
    found = measure_diameters(volumes, place, recording=scans[0], parameters=parameters)
    assert [each.diameter for each in found] == pytest.approx([100e-6, 150e-6, 250e-6], rel=0.1)
    assert found[0].point_spread == pytest.approx(80e-6, rel=0.1)


@pytest.mark.long
def test_vessel_of_two_thirds_of_the_point_spread_has_an_upper_limit_only():
    volume, parameters = image(scan(100e-6), 10e6)
    found = measure_diameter(volume, PLACE, recording=scan(100e-6), parameters=parameters)
    assert found.point_spread == pytest.approx(150e-6, rel=0.1)
    assert found.diameter is None
    assert 100e-6 < found.at_most < 140e-6


@pytest.mark.long
def test_measure_command_lists_diameters_of_a_series(tmp_path):
    frames = [SeriesFrame((n,), 0.0, 0.5 * n) for n in range(2)]
    Series(frames, lambda n: (TUBE, tube(200e-6))[n]).save(tmp_path / "series.h5")
    words = ("measure", "series.h5", "--vessel", "0,0,0", "--point-spread", "80um", "-o", "table.csv")
    told = run_here(*words, cwd=tmp_path)
    assert "frame 1" in told
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert [float(row["fwhm"]) for row in rows] == pytest.approx([150e-6, 200e-6], rel=0.03)
    assert [float(row["time"]) for row in rows] == [0.0, 0.5]
    assert float(rows[0]["diameter"]) < float(rows[1]["diameter"])
    refused = run_here("measure", "series.h5", cwd=tmp_path, code=2)
    assert "region is missing" in " ".join(refused.split())
