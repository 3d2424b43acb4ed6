"""The commands, run as a person runs them: real files, real exit codes; in processes where these tell something."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.main import get_command

from fabry_perot.simulator.named_phantoms import NAMES
from steradian.cli import scan
from steradian.cli.app import app
from steradian.cli.console import duration, frequency, length, speed
from steradian.quality import correlation
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.opening import open_recording
from support.commands import run_here

DATA = Path(__file__).parents[2] / "data"


def run(*arguments, cwd, code=0):
    """Run ``steradian …`` and check its exit code; returns both outputs."""
    done = subprocess.run(
        [sys.executable, "-m", "steradian", *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr + done.stdout


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Mask, plan, scan and reconstruction, one command after the other."""
    folder = tmp_path_factory.mktemp("walk")
    run_here("mask", "equi-steradian", "--aperture", "6mm", "--depth", "2mm", "--count", "100", cwd=folder)
    run_here("plan", "mask.json", "--samples", "512", cwd=folder)
    run("scan", "plan.json", "--simulator-speed", "50", cwd=folder)
    run("reconstruct", "scan.h5", "--modes", "32", "--output", "out", cwd=folder)
    return folder


@pytest.mark.long
def test_each_command_leaves_its_file(walk):
    """Mask, plan, scan file, volume, projections and report lie where the commands say."""
    assert {path.name for path in walk.iterdir()} == {"mask.json", "plan.json", "scan.h5", "out"}
    assert {path.name for path in (walk / "out").iterdir()} == {
        "volume.h5",
        "mip-x.png",
        "mip-y.png",
        "mip-depth.png",
        "mip-z.png",
        "report.json",
    }
    assert (walk / "out" / "mip-z.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.walk
def test_the_identifiers_link_volume_scan_plan_and_mask(walk):
    """A volume's provenance names the plan and the mask that the commands printed."""
    with h5py.File(walk / "out" / "volume.h5") as file:
        provenance = json.loads(file.attrs["provenance"])
    recording = open_recording(walk / "scan.h5")
    assert provenance == recording.provenance
    assert provenance["simulated"] == "True"


@pytest.mark.long
def test_kwave_data_are_reconstructed_like_the_truth(tmp_path):
    """Data of another project's simulation give the true projection (correlation 0.971 with every second sensor)."""
    run_here("reconstruct", DATA / "yarn_kwave_slice.npz", "--modes", "64", "--output", "yarn", cwd=tmp_path)
    volume = read_volume(tmp_path / "yarn" / "volume.h5")
    assert volume.values.shape == (64, 64, 256)
    with np.load(DATA / "yarn_kwave_slice.npz") as data:
        assert correlation(volume.mip("z"), data["p0_mip"]) > 0.965


def test_a_line_of_sensors_gives_an_image_of_a_plane(tmp_path):
    """A 2-D recording is told by its shape; the image [x, z] resembles the true tree around the point of interest."""
    with np.load(DATA / "tree_kwave_slice.npz") as data:
        columns = np.searchsorted(data["sensors"], data["equispaced"])
        np.savez(tmp_path / "line.npz", p=data["traces"][columns].T, dt=data["dt"], dx=16 * data["dx"], c=data["c"])
        dx, truth = float(data["dx"]), data["p0"].T
    run_here("reconstruct", "line.npz", "--modes", "512", "--output", "tree", cwd=tmp_path)
    image = read_volume(tmp_path / "tree" / "volume.h5")
    assert image.names == ("x", "z")
    assert image.spacing == pytest.approx((dx, 1.6e-8 * 1500))
    depths = np.arange(256) * dx
    found = np.array([np.interp(depths, image.axes.z, line) for line in image.values])
    x, z = np.mgrid[-256:256, :256]
    assert correlation(found, truth[256:768], x**2 + (z - 128) ** 2 < 100**2) > 0.65
    assert (tmp_path / "tree" / "mip-y.png").is_file()


@pytest.mark.long
def test_killed_scan_file_keeps_acknowledged_alines(walk, tmp_path):
    """Kill -9 in the middle of a scan: the file opens, and holds a part of the scan that can be reconstructed."""
    plan = walk / "plan.json"
    command = [sys.executable, "-m", "steradian", "scan", plan, "--simulator-speed", "1", "--output", "part.h5"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        stored = _wait_for_alines(tmp_path / "part.h5", 10)
        process.send_signal(signal.SIGKILL)
        process.wait()
    finally:
        process.kill()
        process.wait()
    recording = open_recording(tmp_path / "part.h5")
    assert stored <= len(recording.traces) < recording.planned
    run_here("reconstruct", "part.h5", "--modes", "32", cwd=tmp_path)


@pytest.mark.long
def test_ctrl_c_ends_scan_with_code_130_and_keeps_file(walk, tmp_path):
    """Ctrl-C is no crash: exit code 130, no traceback, the A-lines so far are in the file."""
    command = [sys.executable, "-m", "steradian", "scan", walk / "plan.json", "--simulator-speed", "0.2"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    heard = signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background have it ignored
    process = subprocess.Popen(command, cwd=tmp_path, **pipes)
    signal.signal(signal.SIGINT, heard)
    _wait_for_alines(tmp_path / "scan.h5", 5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=250)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert len(open_recording(tmp_path / "scan.h5").traces) >= 5


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["mask", "equi-steradian", "--aperture", "6mm", "--depth=-2mm", "--count", "99"], 2, ["depth", "> 0"]),
        (["mask", "grid", "--aperture", "6mm", "--per-axis", "41", "--interval", "1mm"], 2, ["interval", "at most"]),
        (["mask", "grid", "--aperture", "six", "--count", "41", "--interval", "1mm"], 2, ["six"]),
        (["plan", "none.json"], 3, ["none.json"]),
        (["plan", "text.json"], 3, ["text.json", "JSON"]),
        (["scan", "none.json"], 3, ["none.json"]),
        (["reconstruct", "none.h5"], 3, ["none.h5"]),
        (["reconstruct", "text.json"], 3, ["neither"]),
        (["reconstruct", "truncated.h5"], 3, ["truncated.h5"]),
        (["reconstruct", "nan.npz"], 2, ["traces", "nan"]),
        (["reconstruct", "shape.npz"], 3, ["shape (8, 4, 5, 2)"]),
    ],
)
def test_bad_input_is_one_clear_line(walk, tmp_path, arguments, code, words):
    """Bad input ends with its own exit code and a line that names what and the allowed range, never a traceback."""
    (tmp_path / "text.json").write_text("no json")
    (tmp_path / "truncated.h5").write_bytes((walk / "scan.h5").read_bytes()[:5000])
    np.savez(tmp_path / "nan.npz", p=np.full((64, 4, 4), np.nan, np.float32), dt=2e-8, dx=1e-4, c=1500.0)
    np.savez(tmp_path / "shape.npz", p=np.zeros((8, 4, 5, 2), np.float32), dt=2e-8, dx=1e-4, c=1500.0)
    said = run_here(*arguments, cwd=tmp_path, code=code)
    for word in words:
        assert word in said


def test_refused_command_exits_with_code_3(tmp_path):
    """The exit code of the process itself, and nothing of Python's."""
    assert "none.json" in run("plan", "none.json", cwd=tmp_path, code=3)


@pytest.mark.long
def test_every_command_ends_with_output_paths_and_sizes(walk, tmp_path):
    """The last line names each file with the size that the system gives for it, in units that a person reads."""
    mask, plan, scan, out = walk / "mask.json", walk / "plan.json", walk / "scan.h5", walk / "out"
    for words, made in (
        (["mask", "grid", "--aperture", "6mm", "--count", "4", "--interval", "1mm", "-o", "grid.json"], ["grid.json"]),
        (["mask", "show", mask, "--plot", "mask.png"], [mask, "mask.png"]),
        (["plan", mask, "--samples", "512", "-o", "plan.json", "--plot", "plan.png"], ["plan.json", "plan.png"]),
        (["scan", plan, "--simulator-speed", "50", "-o", "scan.h5"], ["scan.h5"]),
        (["scan", "resume", "scan.h5"], ["scan.h5"]),
        (["scan", "check", "scan.h5"], ["scan.h5"]),
        (["reconstruct", scan, "--modes", "32", "-o", "image"], ["image/volume.h5", "image"]),
        (["what-if", scan, "what-if", "--mask", mask, "--modes", "32", "--method", "iterative"], ["what-if"]),
        (["sound-speed", scan, "speed", "--steps", "3"], ["speed"]),
        (["export", scan, "scan.ipasc.h5"], ["scan.ipasc.h5"]),
        (["export", out / "volume.h5", "pictures", "-f", "png"], ["pictures"]),
        (["import", "scan.ipasc.h5", "again.h5"], ["again.h5"]),
    ):
        last = run_here(*words, cwd=tmp_path).splitlines()[-1]
        for path in made:
            size = re.search(rf"{re.escape(str(path))} \((?:\d+ files?, )?([\d.]+) ([kMG]?)B\)", last)
            assert size, last
            path = tmp_path / path
            files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
            total = sum(file.stat().st_size for file in files)
            assert float(size[1]) * {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}[size[2]] == pytest.approx(total, rel=0.01)


def test_help_lists_the_commands_in_the_order_of_the_work():
    said = run_here("--help", cwd=os.getcwd()).partition("Commands")[2]
    places = [said.index(f" {name} ") for name in ("mask", "plan", "scan", "reconstruct", "export", "demo", "serve")]
    assert places == sorted(places)


@pytest.mark.parametrize("command", [[], ["mask"], ["plan"], ["scan", "run"], ["benchmark"]])
def test_help_imports_neither_numerical_libraries_nor_other_commands(command):
    """Help and mistyped options are answered at once; a command imports its libraries when it runs."""
    code = "import sys; from steradian.cli import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *command, "--help"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules = set(done.stderr.split())
    assert modules & {"numpy", "h5py", "sqlalchemy", "fabry_perot", "steradian.masks"} == set()
    assert ("steradian.cli.export" in modules) == (command == [])


def test_scan_help_lists_every_phantom_of_the_simulated_scanner():
    assert f"looks at: {', '.join(NAMES)}, or" in " ".join(scan.Phantom.__metadata__[0].help.split())


def test_every_option_shows_its_unit_the_same_way():
    """An option that takes a quantity shows its kind in angle brackets, as numbers and paths are shown."""
    kinds, shown = {kind.__name__ for kind in (length, duration, frequency, speed)}, set()
    commands = [get_command(app)]
    for command in commands:
        commands += [command.get_command(None, name) for name in getattr(command, "commands", {})]
        for option in command.params:
            assert option.metavar is None or option.metavar[0] == "<" or option.metavar.isupper(), option.name
            about = option.help or "" if option.param_type_name == "option" else ""
            words = {word.strip(".,;()") for word in about.split()}
            assert not words & {"m/s", "Hz", "metres"} or option.metavar, option.name
            shown.add(str(option.metavar).strip("<>"))
    assert kinds <= shown


def test_help_of_every_command_speaks_of_the_task():
    """Each command's help says what it does."""
    for command in (["mask"], ["mask", "equi-steradian"], ["plan"], ["scan"], ["reconstruct"], ["demo"], ["serve"]):
        said = run_here(*command, "--help", cwd=os.getcwd())
        assert "Usage" in said
        assert len(said) > 200


def _wait_for_alines(path, count):
    """Wait until a running scan's file holds ``count`` A-lines; returns how many there are."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if path.is_file():
            with h5py.File(path, "r") as file:
                stored = int(np.sum(file["alines/status"][:]))
            if stored >= count:
                return stored
        time.sleep(0.05)
    raise AssertionError(f"{path} does not grow")
