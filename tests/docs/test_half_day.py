"""Study of half a day with the command line, each step one command: budget, scan, width, figure, own data, sO2, layers.

The times of the steps are printed. Objects, widths and places are closed forms. Of the oxygen saturation only files are
expected, since the simulator has no chromophores.
"""

import re
import subprocess
import sys
import time

import numpy as np
import pytest

import steradian
from steradian import Layer, Medium
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, layered_pressure, pressure

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1200)]
SIGMA, DEPTH = 90e-6, 2.5e-3
DIAMETER = 2 * np.sqrt(2 * np.log(2)) * SIGMA
INTERVAL, SPEED = 8e-9, 1500.0


def vessel():
    """Return a vessel along y as a row of balls."""
    y = np.linspace(-3.5e-3, 3.5e-3, 160)
    centres = np.column_stack([np.full_like(y, 0.3e-3), y, np.full_like(y, DEPTH)])
    return Balls(centres, np.full(len(y), SIGMA), np.full(len(y), 0.3))


def peak(volume):
    """Return the place of a volume's maximum."""
    found = np.unravel_index(volume.values.argmax(), volume.values.shape)
    return [volume.coordinates(name)[at] for name, at in zip(volume.names, found, strict=True)]


class Study:
    """Commands in a folder, each timed."""

    def __init__(self, folder):
        self.folder, self.rows = folder, []

    def run(self, step, *words):
        """Run one command of ``steradian``; return what it prints."""
        begun = time.monotonic()
        found = subprocess.run(
            [sys.executable, "-m", "steradian", *words], cwd=self.folder, capture_output=True, text=True
        )
        self.rows.append((step, time.monotonic() - begun))
        assert found.returncode == 0, found.stderr
        return found.stdout

    def table(self):
        """Return the steps with their seconds as text."""
        return "\n".join(f"{seconds:7.1f} s  {step}" for step, seconds in self.rows)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder, balls = tmp_path_factory.mktemp("study"), vessel()
    np.savez(folder / "vessel.npz", centres=balls.centres, sigmas=balls.sigmas, amplitudes=balls.amplitudes)
    study = Study(folder)
    yield study
    print(f"\n{study.table()}")


@pytest.fixture(scope="module")
def designed(study):
    """The study with the mask and plan of 15 minutes at 50 Hz."""
    size = ["--depth", "2.5mm", "--vessel", "212um", "--aperture", "10mm", "--noise", "0.05", "--method", "direct"]
    time = ["--time", "15min", "--pulse-rate", "50Hz"]
    study.run("budget", "design", *time, *size, "-o", "mask.json", "--plan", "plan.json")
    return study


def test_scan_of_a_budget_shows_the_vessel_s_diameter(designed):
    study = designed
    study.run("scan", "scan", "run", "plan.json", "-o", "s.h5", "--phantom", "vessel.npz", "--simulator-speed", "100")
    study.run("direct image", "reconstruct", "s.h5", "-o", "direct")
    study.run("iterative image", "reconstruct", "s.h5", "-o", "iterative", "--method", "iterative")
    said = study.run("width", "measure", "direct", "s.h5", "--from", "-0.4,0.5,2.5", "--to", "1.0,0.5,2.5")
    assert float(re.search(r"corrected +([\d.]+) µm", said)[1]) == pytest.approx(1e6 * DIAMETER, rel=0.05)
    study.run("figure of 85 mm", "figure", "direct", "iterative", "-o", "figure.pdf", "--width", "85mm")
    assert (study.folder / "figure.pdf").read_bytes().startswith(b"%PDF")


def test_output_of_kwave_is_imported_without_a_description(study):
    where, random = 0.15e-3 * (np.arange(36) - 18), np.random.default_rng(3)
    positions = np.column_stack([axis.ravel() for axis in np.meshgrid(where, where, indexing="ij")])
    balls = Balls(random.uniform((-2e-3, -2e-3, 2e-3), (2e-3, 2e-3, 4e-3), (3, 3)), np.full(3, 0.15e-3), np.ones(3))
    mask = (random.random((1, 36, 36)) < 0.7).astype(
        float
    )  # of a whole square either order of the sensors is as smooth
    positions = positions[mask.ravel() > 0]
    p = pressure(balls, positions, samples=400, sampling_interval=20e-9, sound_speed=SPEED)
    np.savez(study.folder / "result.npz", p=p, dt=20e-9, dx=0.15e-3, mask=mask, sound_speed=SPEED)
    study.run("import of k-Wave", "import", "result.npz", "kwave.h5")
    study.run("its image", "reconstruct", "kwave.h5", "-o", "kwave")
    volume = steradian.open(study.folder / "kwave" / "volume.h5")
    nearest = np.linalg.norm(balls.centres - peak(volume), axis=1).min()
    assert nearest < 1.5 * max(volume.spacing)


def test_two_wavelengths_become_a_map_of_oxygen_saturation(designed):
    study = designed
    study.run("plan of two", "plan", "mask.json", "--excitation", "750nm", "--excitation", "850nm", "-o", "two.json")
    command = ["scan", "run", "two.json", "-o", "two.h5", "--phantom", "vessel.npz", "--simulator-speed", "1000"]
    study.run("scan of two", *command)
    study.run("series", "reconstruct", "two.h5", "-o", "series")
    study.run("oxygen saturation", "unmix", "series", "-o", "so2")
    assert {each.name for each in (study.folder / "so2").iterdir()} >= {"saturation.h5", "saturation.png"}


def test_image_through_layers_has_a_ball_at_its_depth(study):
    medium = Medium([Layer(1480.0, 1e-3), Layer(1600.0)])
    mask = equi_steradian_mask(10e-3, DEPTH, 600)
    ball = Balls(np.array([[0.3e-3, -0.2e-3, 3.5e-3]]), np.array([0.15e-3]), np.ones(1))
    traces = layered_pressure(ball, mask.positions, medium, samples=700, sampling_interval=INTERVAL)
    np.savez(study.folder / "own.npz", traces=traces, positions=mask.positions, dt=INTERVAL, c=1540.0)
    study.run("import of own data", "import", "own.npz", "own.h5")
    study.run(
        "image through layers", "reconstruct", "own.h5", "-o", "own", "--layer", "1480m/s:1mm", "--layer", "1600m/s"
    )
    volume = steradian.open(study.folder / "own" / "volume.h5")
    np.testing.assert_allclose(peak(volume), ball.centres[0], atol=max(volume.spacing))
