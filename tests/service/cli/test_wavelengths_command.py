"""``steradian wavelengths``: a laser's list to the best set, and its errors."""

import pytest
import typer
from typer.testing import CliRunner

from steradian import InvalidInput
from steradian.cli.wavelengths import parse_wavelengths, wavelengths

app = typer.Typer()
app.command()(wavelengths)


def run(*words):
    """Run the command; its errors come through as exceptions."""
    return CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)


def test_best_set_is_printed_beside_even_spacing():
    told = run("--from", "700:900:20", "--count", 3, "--depth", "2mm").output
    assert told.count(" nm") >= 2
    assert "sO2 ±" in told
    assert "Evenly spaced" in told


def test_list_and_range_are_parsed_to_metres():
    assert parse_wavelengths("700:720:10") == pytest.approx([7e-7, 7.1e-7, 7.2e-7])
    assert parse_wavelengths("700,755.5") == pytest.approx([7e-7, 7.555e-7])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--from", "700-900"), "from is 700-900"),
        (("--from", "900:700:5"), "from is 900:700:5"),
        (("--count", 1), "count is 1"),
        (("--depth", "-1mm"), "depth is -0.001"),
        (("--chromophore", "gold"), "chromophore is gold"),
        (("--from", "300:400:5"), "wavelength is 300 nm"),
    ],
)
def test_wrong_options_name_field_and_value(words, told):
    with pytest.raises(InvalidInput, match=told):
        run(*words)
