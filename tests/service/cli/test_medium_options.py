"""Options for layers and attenuation: a ball below a boundary comes to its place; errors are one clear line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steradian.cli.medium_options import parse_medium
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Layer, Medium
from steradian.phantoms import Balls, layered_pressure
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volumes.file import read_volume
from support.commands import command, run_here

SIDE, PITCH, DT, SAMPLES = 20, 100e-6, 20e-9, 110
CENTRE = np.array([0.2e-3, -0.1e-3, 2.0e-3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball below a boundary at 1 mm of 1480 and 1700 m/s, in k-Wave's form."""
    folder = tmp_path_factory.mktemp("layers")
    axis = (np.arange(SIDE) - SIDE // 2) * PITCH
    positions = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    medium = Medium([Layer(1480.0, 1e-3), Layer(1700.0)])
    ball = Balls(CENTRE[None], np.array([90e-6]), np.ones(1))
    traces = layered_pressure(ball, positions, medium, samples=SAMPLES, sampling_interval=DT)
    p = traces.T.reshape(SAMPLES, SIDE, SIDE).astype(np.float32)
    np.savez(folder / "scan.npz", p=p, dt=DT, dx=PITCH, c=1480.0)
    return folder


def parse(layers: list[str], attenuations: list[str], sound_speed: float | None = None) -> dict[str, Any]:
    """Return the effective ``sound_speed`` and ``medium`` as a request has them."""
    parameters = ReconstructionParameters.create(**parse_medium(layers, attenuations, sound_speed))
    return parameters.model_dump(include={"sound_speed", "medium"}, exclude_none=True)


def test_layers_and_attenuation_are_the_parameters_of_a_request() -> None:
    water, tissue = {"coefficient": 2.17e-3, "power": 2.0}, {"coefficient": 0.75, "power": 1.5}
    assert parse([], []) == {}
    assert parse([], [], 1500.0) == {"sound_speed": 1500.0}
    assert parse([], ["soft-tissue"]) == {"medium": ({"attenuation": tissue},)}
    assert parse([], ["soft tissue"], 1540.0) == {"medium": ({"sound_speed": 1540.0, "attenuation": tissue},)}
    two = ({"sound_speed": 1480.0, "thickness": 2e-3}, {"sound_speed": 1580.0})
    assert parse(["1480m/s:2mm", "1580"], []) == {"medium": two}
    dense = tuple(layer | {"density": density} for layer, density in zip(two, (998.0, 1050.0), strict=True))
    assert parse(["1480m/s:2mm:998kg/m3", "1580m/s:1050kg/m³"], []) == {"medium": dense}
    lossy = two[0], two[1] | {"attenuation": tissue}
    assert parse(["1480m/s:2mm", "1580m/s"], ["none", "0.75,1.5"]) == {"medium": lossy}
    lossy = two[0] | {"attenuation": water}, two[1]
    assert parse(["1480m/s:2mm", "1580m/s"], ["water", "none"]) == {"medium": lossy}


REFUSED = [
    (["2mm"], [], None, "layer is 2mm; allowed: a speed and, but for the last layer, a thickness"),
    (["1480m/s:2mm:3mm"], [], None, "layer is 1480m/s:2mm:3mm; allowed: a speed and"),
    (["1480m/s:998"], [], None, r"layer is 1480m/s:998; allowed: thickness at least 1e-06, at most 1 \(m\)"),
    (["1480m/s:-2mm", "1580m/s"], [], None, r"layer is 1480m/s:-2mm; allowed: thickness at least 1e-06"),
    (["1mm/s"], [], None, "layer is 1mm/s; allowed: sound speed at least 300, at most 12000"),
    (["1480m/s", "1580m/s"], [], None, "medium.0.thickness is missing"),
    (["1480m/s"], [], 1500.0, "sound-speed is 1500 m/s; allowed: none beside --layer"),
    (
        [],
        ["fat"],
        None,
        "attenuation is fat; allowed: a coefficient and a power, such as .* water, soft-tissue",
    ),
    ([], ["0.75"], None, "attenuation is 0.75; allowed: a coefficient and a power"),
    ([], ["0.75,3"], None, "attenuation is 0.75,3; allowed: power at least 0, at most 2.9"),
    ([], ["nan,1"], None, "attenuation is nan,1; allowed: coefficient at least 0, at most 100"),
    (
        ["1480m/s:2mm", "1580m/s"],
        ["water"],
        None,
        "attenuation is given 1 times; allowed: once for each layer, 2",
    ),
]


@pytest.mark.parametrize(("layers", "attenuations", "sound_speed", "words"), REFUSED)
def test_wrong_text_is_refused_by_option_text_and_range(
    layers: list[str], attenuations: list[str], sound_speed: float | None, words: str
) -> None:
    with pytest.raises(InvalidInput, match=words):
        parse(layers, attenuations, sound_speed)


def test_command_refuses_a_layer_in_one_line(folder: Path) -> None:
    done = command("reconstruct", "scan.npz", "--layer", "1480m/s:-2mm", "--layer", "1580m/s", cwd=folder)
    assert done.returncode == 2
    assert done.stderr.startswith("error: layer is 1480m/s:-2mm; allowed: thickness at least 1e-06, at most 1 (m)")
    assert done.stderr.count("\n") == 1


def test_command_refuses_a_spot_in_one_line(folder: Path) -> None:
    done = command("reconstruct", "scan.npz", "--spot", "1m", cwd=folder)
    assert done.returncode == 2
    assert done.stderr == "error: film.spot.diameter is 1.0; allowed: at least 1e-07, at most 0.005 (m)\n"


@pytest.mark.long
def test_command_images_a_ball_below_a_boundary_within_a_voxel(folder: Path) -> None:
    said = run_here(
        *("reconstruct", "scan.npz", "--layer", "1480m/s:1mm", "--layer", "1700m/s", "--attenuation", "water"),
        *("--attenuation", "none", "--spot", "50um", "--spot-profile", "top-hat", "-o", "out"),
        cwd=folder,
    )
    assert "1480 m/s with 0.00217 dB/(MHz^2 cm) to 1 mm, 1700 m/s" in said
    assert "noise gain" in said
    volume = read_volume(folder / "out" / "volume.h5")
    at = np.unravel_index(volume.values.argmax(), volume.values.shape)
    found = np.array([volume.coordinates(name)[i] for name, i in zip("xyz", at, strict=True)])
    assert (np.abs(found - CENTRE) <= volume.spacing).all()
    report = json.loads((folder / "out" / "report.json").read_text())
    assert [layer["thickness"] for layer in report["parameters"]["medium"]] == [1e-3, None]
    assert report["parameters"]["film"]["spot"] == {"diameter": pytest.approx(50e-6), "profile": "top-hat"}
