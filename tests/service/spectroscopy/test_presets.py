"""Unmixing presets in PATATO's format."""

import numpy as np
import pytest

from steradian import InvalidInput
from steradian.spectroscopy import UnmixingPreset, read_patato_preset

NANOMETRES = 1e-9 * np.array([680.0, 700.0, 730.0, 760.0, 800.0, 850.0, 900.0, 930.0])


def preset(tmp_path, text):
    path = tmp_path / "preset.json"
    path.write_text(text)
    return read_patato_preset(path)


def test_range_of_wavelengths_selects_those_within(tmp_path):
    found = preset(
        tmp_path,
        '{"RESOLUTION_REDUCE": 3, "WAVELENGTH_RANGE": [700, 900], "SPECTRA": ["Hb", "HbO2"], "SO2": true}',
    )
    assert found.chromophores == ("deoxyhaemoglobin", "oxyhaemoglobin")
    assert found.non_negative
    assert found.select(NANOMETRES).tolist() == [1, 2, 3, 4, 5, 6]


def test_listed_wavelengths_and_the_sign_are_taken(tmp_path):
    found = preset(
        tmp_path, '{"WAVELENGTHS": [730.0, 760.0, 800.0], "SPECTRA": ["Hb", "HbO2", "Melanin"], "NONNEG": false}'
    )
    assert found.chromophores[2] == "melanin"
    assert not found.non_negative
    assert found.select(NANOMETRES).tolist() == [2, 3, 4]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "preset is preset.json; allowed: JSON"),
        ("[]", "SPECTRA"),
        ('{"SPECTRA": ["Hb", "gold"]}', "SPECTRA is gold"),
        ('{"SPECTRA": ["Hb"], "WAVELENGTH_RANGE": [900, 700]}', "WAVELENGTH_RANGE.*rising"),
        ('{"SPECTRA": ["Hb"], "WAVELENGTHS": [7e-7]}', "WAVELENGTHS.*nm"),
    ],
)
def test_wrong_presets_are_refused_with_their_field(tmp_path, text, told):
    with pytest.raises(InvalidInput, match=told):
        preset(tmp_path, text)


def test_wavelength_that_the_series_lacks_is_named():
    with pytest.raises(InvalidInput, match="wavelength is 770 nm"):
        UnmixingPreset(("oxyhaemoglobin",), wavelengths=(7.7e-7,)).select(NANOMETRES)
    with pytest.raises(InvalidInput, match="at least 2 for"):
        UnmixingPreset(("oxyhaemoglobin", "water"), wavelength_range=(6.9e-7, 7.1e-7)).select(NANOMETRES)
