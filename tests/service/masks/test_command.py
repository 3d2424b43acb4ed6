"""``steradian mask`` makes any arrangement and tells what it promises."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian import InvalidInput
from steradian.cli.mask import app
from steradian.drawing.mpl_style import page, save
from steradian.masks import read_mask

COMMANDS = [
    ["equi-steradian", "--aperture", "10mm", "--depth", "3mm", "--count", "100", "--offset-x", "1mm"],
    ["equiangular", "--aperture", "10mm", "--depth", "3mm", "--count", "20"],
    ["grid", "--aperture", "10mm", "--per-axis", "8", "--interval", "1mm", "--centred"],
    ["grid", "--aperture", "10mm", "--count", "60", "--depth", "3mm"],
    ["hexagonal", "--aperture", "10mm", "--interval", "1mm"],
    ["hexagonal", "--aperture", "10mm", "--count", "60", "--depth", "3mm", "--offset-x", "1mm"],
    ["random", "--aperture", "10mm", "--count", "30", "--seed", "4"],
    ["poisson-disc", "--aperture", "10mm", "--spacing", "1mm"],
    ["poisson-disc", "--aperture", "10mm", "--count", "60", "--depth", "3mm"],
    ["combined", "--aperture", "10mm", "--point", "2mm,0,3mm,80", "--point=-2mm,0,2mm,60"],
]


def run(*words):
    """Run the command; its errors come through as exceptions."""
    return CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0] + command[3])
def test_each_arrangement_has_a_command(command, tmp_path):
    """Each writes a mask file of its kind and tells the weight ratio."""
    result = run(*command, "-o", tmp_path / "mask.json")
    assert result.exit_code == 0, result.output
    assert "weight ratio" in result.output
    assert read_mask(tmp_path / "mask.json").arrangement["arrangement"] == command[0]


def test_mask_command_prints_neighbouring_counts(tmp_path):
    """Asking 1,625 gives 1,605, the nearer of 1,605 and 1,669; asking a grid for 2,000 gives 2,025."""
    words = ("--aperture", "13.56mm", "--depth", "3.6mm", "-o", tmp_path / "mask.npy", "--count")

    def told(arrangement, count):
        return " ".join(run(arrangement, *words, count).output.split())

    assert "1605 (asked 1625; slices end on the rim with 1605 and 1669)" in told("equi-steradian", 1625)
    assert np.load(tmp_path / "mask.npy").shape == (1605, 3)
    assert "2025 (asked 2000; squares near it: 1936, 2025 and 2116)" in told("grid", 2000)
    assert np.load(tmp_path / "mask.npy").shape == (2025, 3)
    assert "asked" not in told("random", 2000)


def test_spacing_is_one_thing_in_table_and_picture(tmp_path):
    """The least and the greatest distance to the nearest sensor."""
    from steradian.masks.metrics import spacing_map

    told = run(
        "equi-steradian", "--aperture", "10mm", "--depth", "3mm", "--count", 300, "-o", tmp_path / "a.json"
    ).output
    low, high = re.search(r"spacing +(\d+) to (\d+) µm", told).groups()
    shown = 1e6 * spacing_map(read_mask(tmp_path / "a.json"))
    assert (round(shown.min()), round(shown.max())) == (int(low), int(high))


def test_a_picture_of_an_unknown_kind_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(InvalidInput, match=r"plot.*x\.bmp.*png"):
        run(*COMMANDS[0], "-o", tmp_path / "mask.json", "--plot", tmp_path / "x.bmp")
    with pytest.raises(InvalidInput, match=r"file.*x\.bmp.*png"):
        save(page(400, 0.5), tmp_path / "x.bmp")
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_points_subset_and_show_work_on_files(tmp_path):
    """A table becomes a mask, a part of it another, and a picture is drawn."""
    (tmp_path / "lab.csv").write_text("x_mm,y_mm\n1,2\n-3,0.5\n0,0\n2,2\n")
    assert run("points", tmp_path / "lab.csv", "--aperture", "10mm", "-o", tmp_path / "a.json").exit_code == 0
    assert "2 of 4" in run("subset", tmp_path / "a.json", "--every", "2", "-o", tmp_path / "b.json").output
    assert "spacing" in run("show", tmp_path / "b.json", "--plot", tmp_path / "b.png").output
    assert (tmp_path / "b.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("command", "field"),
    [
        (["grid", "--aperture", "1mm", "--per-axis", "8", "--interval", "1mm"], "interval"),
        (["grid", "--aperture", "1mm"], "count"),
        (["hexagonal", "--aperture", "1mm", "--count", "9", "--interval", "1mm"], "count"),
        (["poisson-disc", "--aperture", "1mm"], "count"),
        (["combined", "--aperture", "10mm", "--point", "2mm,0"], "point"),
        (["hexagonal", "--aperture", "10mm", "--interval", "0"], "interval"),
        (["equiangular", "--aperture", "1cm", "--depth", "1mm", "--count", "9", "--snap-count", "8"], "snap"),
    ],
)
def test_bad_options_are_named(command, field, tmp_path):
    """What is out of range is refused with its name and nothing is written."""
    with pytest.raises(InvalidInput) as refused:
        run(*command, "-o", tmp_path / "mask.json")
    assert refused.value.field == field
    assert not list(tmp_path.iterdir())
