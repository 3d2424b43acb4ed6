"""Two wavelengths, three times: import, series, unmixing, table, figures and export on the command line."""

import csv
import json

import nibabel
import pytest
from PIL import Image

from support.commands import run_here
from support.series_scan import SATURATION, write_scan


@pytest.mark.long
def test_recording_of_two_wavelengths_goes_from_import_to_figure(tmp_path):
    write_scan(tmp_path / "measured.h5", repeats=3)
    run_here("export", "measured.h5", "recording.hdf5", cwd=tmp_path)
    run_here("import", "recording.hdf5", "scan.h5", cwd=tmp_path)
    depths = ("--first-depth", "0.6mm", "--last-depth", "1.6mm")
    told = run_here("reconstruct", "scan.h5", "--modes", "24", *depths, "--align", cwd=tmp_path)
    assert "3 at 750 nm, 3 at 850 nm" in told
    run_here("unmix", "reconstruction", "--fluence", "uniform", "-o", "so2", cwd=tmp_path)
    report = json.loads((tmp_path / "so2" / "report.json").read_text())
    assert report["saturation"]["mean"] == pytest.approx(SATURATION, abs=0.01)
    region = "box ball -0.2:0.2,-0.2:0.2,0.9:1.1"
    run_here("measure", "reconstruction", "--region", region, "-o", "table.csv", cwd=tmp_path)
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert [row["excitation"] for row in rows] == ["7.5e-07"] * 3 + ["8.5e-07"] * 3
    assert {row["time"] for row in rows} == {""}  # an imported recording has no times of shots
    run_here("figure", "reconstruction", "--columns", "3", "-o", "series.png", cwd=tmp_path)
    saturation = ("--limits", "0:1", "--colour-map", "coolwarm", "--label", "oxygen saturation")
    run_here("figure", "so2/saturation.h5", *saturation, "-o", "so2.png", cwd=tmp_path)
    for name in ("series.png", "so2.png"):
        with Image.open(tmp_path / name) as drawn:
            assert drawn.width == 1003
    run_here("export", "reconstruction", "-o", "series.nii.gz", cwd=tmp_path)
    assert nibabel.load(tmp_path / "series.nii.gz").shape == (24, 24, 34, 6)
    out = run_here("measure", "reconstruction", "--region", region, "--fit", "step", cwd=tmp_path, code=2)
    assert "times is not known" in " ".join(out.split())
