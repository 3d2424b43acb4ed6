"""Absorption spectra against a second published table, and their errors."""

from math import log

import numpy as np
import pytest

from steradian import InvalidInput
from steradian.spectroscopy import CHROMOPHORES, Chromophore, chromophore, read_chromophore

# SIMPA 1.0.0, absorption_spectra_data: 1/cm, haemoglobin of 150 g/L whole blood, to three digits
NANOMETRES = (650, 700, 750, 800, 850, 900, 930, 950, 690, 710)
WHOLE_BLOOD = {
    "oxyhaemoglobin": (1.97, 1.55, 2.77, 4.37, 5.67, 6.42, 6.54, 6.45, 1.48, 1.68),
    "deoxyhaemoglobin": (20.1, 9.61, 7.52, 4.08, 3.7, 4.08, 4.09, 3.22, 11.0, 8.25),
}
WATER = {700: 0.006, 750: 0.026, 800: 0.02, 850: 0.043, 900: 0.068, 930: 0.173}
FAT = {700: 0.00323, 750: 0.00972, 800: 0.00403, 850: 0.00637, 900: 0.04633, 930: 0.131}


@pytest.mark.parametrize("name", WHOLE_BLOOD)
def test_haemoglobin_agrees_with_a_second_table_within_one_per_cent(name):
    found = 150 / 64_500 * chromophore(name).at(1e-9 * np.array(NANOMETRES)) / 100
    np.testing.assert_allclose(found, WHOLE_BLOOD[name], rtol=0.01)


@pytest.mark.parametrize(("name", "table"), [("water", WATER), ("lipid", FAT)])
def test_water_and_lipid_agree_with_a_second_table_within_one_per_cent(name, table):
    found = chromophore(name).at(1e-9 * np.array(list(table))) / 100
    np.testing.assert_allclose(found, list(table.values()), rtol=0.01)


def test_melanin_is_the_power_law_of_melanosomes():
    np.testing.assert_allclose(chromophore("melanin").at([532e-9, 700e-9]) / 100, [553, 213.5], rtol=0.01)


def test_isosbestic_point_of_haemoglobin_is_near_798_nm_and_icg_has_its_peak_near_805_nm():
    light = np.arange(760e-9, 860e-9, 1e-9)
    oxygenated, deoxygenated = (chromophore(name).at(light) for name in ("HbO2", "Hb"))
    assert light[np.argmin(abs(oxygenated - deoxygenated))] == pytest.approx(798e-9, abs=2e-9)
    assert light[np.argmax(chromophore("ICG").at(light))] == pytest.approx(805e-9, abs=6e-9)


@pytest.mark.parametrize("name", CHROMOPHORES)
def test_wavelength_outside_a_table_is_refused_with_the_tables_range(name):
    with pytest.raises(InvalidInput, match=f"wavelength is 300 nm; allowed: .* nm, the table of {name}"):
        chromophore(name).at([800e-9, 300e-9])


def test_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(InvalidInput, match=r"chromophore is haem.*oxyhaemoglobin, deoxyhaemoglobin, water"):
        chromophore("haem")


def test_spectrum_is_read_from_csv_with_heading_and_unit(tmp_path):
    path = tmp_path / "dye.csv"
    path.write_text("nm,extinction\n700,1000\n710,2000\n\n720,500\n")
    dye = read_chromophore(path)
    assert dye.name == "dye"
    np.testing.assert_allclose(dye.at([700e-9, 705e-9, 720e-9]), 100 * log(10) * np.array([1000, 1500, 500]))
    path.write_text("700;0.1\n710;0.2\n")
    np.testing.assert_allclose(read_chromophore(path, unit="volume fraction").at(705e-9), 15.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("700,1\n710,x\n720,1\n", "line 2 is 710,x"),
        ("700,1\n", "at least two rows"),
        ("700,1\n690,2\n", "wavelengths.*rising"),
        ("700,1\n710,-2\n", "absorption.*none negative"),
        ("0.7,1\n0.71,2\n", "wavelengths.*between 100 nm and 10 µm"),
    ],
)
def test_wrong_spectra_are_refused(tmp_path, text, told):
    path = tmp_path / "dye.csv"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=told):
        read_chromophore(path)


def test_spectrum_of_two_lengths_is_refused():
    with pytest.raises(InvalidInput, match="one value for each"):
        Chromophore("dye", np.array([7e-7, 8e-7]), np.ones(3))
