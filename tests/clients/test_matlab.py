"""The MATLAB package against a real service, run by Octave."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from support import recordings

MATLAB = Path(__file__).parents[2] / "clients" / "matlab"
pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(400),
    pytest.mark.skipif(shutil.which("octave") is None, reason="needs Octave: apt-get install octave"),
]
PARAMETERS = "struct('modes', 24)"


@pytest.fixture
def octave(url, tmp_path):
    """Runs lines in Octave with the package on the path; returns what they print and the variable ``out``."""

    def run(lines, address=url, **variables):
        scipy.io.savemat(tmp_path / "in.mat", variables)
        script = f"addpath('{MATLAB}'); load('in.mat'); service = steradian.service('{address}', '');\n{lines}\n"
        (tmp_path / "script.m").write_text(script + "if exist('out', 'var'), save('-v6', 'out.mat', 'out'); end\n")
        environment = os.environ | {"TMPDIR": str(tmp_path)}
        command = ["octave", "--no-gui", "--norc", "--quiet", "script.m"]
        ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=380)
        assert ran.returncode == 0, ran.stdout + ran.stderr
        assert not [path for path in tmp_path.iterdir() if path.name.startswith("oct-")], "nothing is left behind"
        out = tmp_path / "out.mat"
        return ran.stdout, scipy.io.loadmat(out, simplify_cells=True)["out"] if out.exists() else None

    return run


def test_the_example_finds_its_ball(octave):
    """The folder's example is a walk of under thirty lines: depth as said, amplitude as much as the square sees."""
    lines = (MATLAB / "ball.m").read_text()
    assert len(lines.splitlines()) < 30
    said, _ = octave(lines.replace("service = steradian.service();", ""))
    place = [float(part) for part in re.search(r"brightest at (\S+), (\S+), (\S+) mm", said).groups()]
    assert np.abs(np.array(place) - (0, 0, 3.0)).max() < 0.05
    direct, iterative = map(float, re.search(r"amplitude (\S+) direct, (\S+) iterative", said).groups())
    half = 2.4  # of the square; its share of the half space below the ball
    seen = 2 / np.pi * np.arcsin(half**2 / (half**2 + 3.0**2))
    assert direct == pytest.approx(seen, abs=0.03)
    assert iterative > direct, "the iterative image fills in what the aperture does not see"
    assert "succeeded" in said


def test_k_waves_own_variables_mean_the_same_as_positions(octave):
    """A binary mask on a plane of constant x, k-Wave's p(t, y, z), and positions give one image."""
    traces, positions = recordings.ball()
    count = 24
    mask = np.zeros((3, count, count), bool)
    mask[0] = True
    in_k_waves_order = traces.reshape(count, count, -1).transpose(1, 0, 2).reshape(count**2, -1)  # y runs fastest
    lines = f"""
        kgrid = struct('dt', dt, 'dx', pitch, 'dy', pitch, 'dz', pitch);
        quiet = {{'SoundSpeed', 1500, 'Quiet', true}};
        sensor.mask = mask;
        one = steradian.upload(service, traces, positions, dt, quiet{{:}});
        two = steradian.upload(service, struct('p', by_mask), sensor, kgrid, quiet{{:}});
        three = steradian.upload(service, permute(cube, [3 1 2]), [], kgrid, quiet{{:}}, 'Order', 'time, y, z');
        how = {{'Parameters', {PARAMETERS}, 'Quiet', true}};
        out.one = steradian.reconstruct(service, one, how{{:}});
        out.two = steradian.reconstruct(service, two, how{{:}});
        out.three = steradian.reconstruct(service, three.id, how{{:}}, 'Axes', 'kwave');
        """
    _, out = octave(
        lines,
        traces=traces,
        positions=positions,
        by_mask=in_k_waves_order,
        mask=mask,
        cube=traces.reshape(count, count, -1),
        dt=recordings.INTERVAL,
        pitch=recordings.PITCH,
    )
    p, x, y, z = (out["one"][name] for name in "pxyz")
    assert p.dtype == np.float32
    assert p.shape == (len(x), len(y), len(z))
    i, j, k = np.unravel_index(p.argmax(), p.shape)
    assert np.abs(np.array([x[i], y[j], z[k]]) - (0.3e-3, -0.15e-3, recordings.DEPTH)).max() < 1e-4
    np.testing.assert_allclose(out["two"]["p"], p, atol=1e-6 * p.max())
    np.testing.assert_allclose(out["three"]["p"], p.transpose(2, 0, 1), atol=1e-6 * p.max())
    np.testing.assert_allclose(out["three"]["x"], z)
    np.testing.assert_allclose(out["three"]["y"], x)


def test_a_line_of_sensors_gives_an_image(octave):
    """Two-dimensional data come back as depth by place, with one axis empty."""
    traces, positions = recordings.ball(centre=(0.3e-3, 0.0))
    row = positions[:, 1] == 0
    lines = f"""
        scan = steradian.upload(service, traces, positions, dt, 'SoundSpeed', 1500, 'Quiet', true);
        out = steradian.reconstruct(service, scan, 'Parameters', {PARAMETERS}, 'Quiet', true);
        """
    _, image = octave(lines, traces=traces[row], positions=positions[row][:, :1], dt=recordings.INTERVAL)
    i, k = np.unravel_index(image["p"].argmax(), image["p"].shape)
    assert image["y"].size == 0
    assert abs(image["x"][i] - 0.3e-3) < 1e-4
    assert abs(image["z"][k] - recordings.DEPTH) < 1e-4


@pytest.mark.parametrize(
    ("call", "identifier", "words"),
    [
        ("steradian.upload(service, ones(3, 40), zeros(4, 2), 1e-8)", "invalid_input", "3 rows; allowed: 4"),
        ("steradian.upload(service, ones(4, 40), eye(4, 2), 1e-8, 'Speed', 2)", "invalid_input", "no option Speed"),
        ("steradian.reconstruct(service, 's0', 'Axes', 'zyx')", "invalid_input", "'xyz' or 'kwave'"),
        ("steradian.reconstruct(service, 's0')", "not_found", "s0"),
        ("steradian.upload(service, nan(4, 40), eye(4, 2) * 1e-4, 1e-8)", "invalid_input", "sound_speed is missing"),
        ("steradian.upload(steradian.service('http://127.0.0.1:9', ''), 1, 1, 1)", "unreachable", "127.0.0.1:9"),
    ],
)
def test_matlab_error_contains_problem_identifier_and_message(octave, call, identifier, words):
    """Identifier and message are those of the problem, whoever found it."""
    said, _ = octave(f"try, {call}; catch e, printf('%s | %s', e.identifier, e.message); end")
    assert f"steradian:{identifier} | " in said
    assert words in said
