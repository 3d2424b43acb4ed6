"""The scan file is what its document says, and files of other versions are refused."""

import re
import subprocess
import sys
from pathlib import Path
from shutil import which

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from steradian.core.exceptions import DamagedFile
from steradian.masks import equi_steradian_mask, multi_beam_mask
from steradian.masks.multi_beam import read_beams
from steradian.plans import ScanPlan
from steradian.scans.exporting import export_scan
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.file.tail import ScanTail
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file

DOCUMENT = Path(__file__).parents[3] / "docs" / "scan-file.md"


@pytest.fixture
def path(tmp_path, plan, alines):
    file = tmp_path / "scan.h5"
    wavelengths = np.full(plan.mask.count, 1.55e-6)
    create_scan_file(file, plan.replace(wavelengths=wavelengths, excitation=(8e-7,)), scan_id="s1", scanner="A")
    with ScanFileWriter(file) as store:
        store.append(alines)
    return file


@pytest.mark.long
def test_every_object_is_documented_with_its_type_and_every_documented_one_exists(path, tmp_path):
    rows = re.findall(r"^\| `(/[\w/]*)`(?: attributes)? \|([^|]*)\|([^|]*)\|$", DOCUMENT.read_text(), re.M)
    found = {}
    beams = tmp_path / "beams.h5"  # what only a plan of several beams has
    offsets = read_beams("2x1", 1e-3)
    several = ScanPlan.create(
        mask=multi_beam_mask(equi_steradian_mask(13.56e-3, 3.6e-3, 90), offsets),
        beams=offsets,
        samples=64,
        pulse_rate=50.0,
    )
    create_scan_file(beams, several, scan_id="s2", scanner="A")
    with h5py.File(beams) as other, h5py.File(path) as file:
        for one in (other, file):
            one.visititems(
                lambda name, item: found.__setitem__("/" + name, item.dtype.str[1:] if hasattr(item, "dtype") else "")
            )
        documented = {name: kind.split()[-1] if kind.strip() else "" for name, kind, _ in rows}
        assert set(documented) | {"/alines", "/run"} == {*found, "/"}
        for name, kind in documented.items():
            if name in found:
                assert found[name] == kind, name
        for group in ("/", "/mask", "/plan"):
            words = next(text for name, kind, text in rows if name == group)
            for attribute in file[group].attrs:
                assert f"`{attribute}`" in words, (group, attribute)


def test_datasets_are_numbers_only(path):
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: (
                None if isinstance(item, h5py.Group) else pytest.fail(name) if item.dtype.kind not in "iuf" else None
            )
        )


@pytest.mark.skipif(which("octave-cli") is None, reason="needs Octave: apt-get install octave")
def test_octave_reads_it(path):
    code = f'load("{path}"); printf("%d %d", rows(alines.samples), columns(alines.samples));'
    said = subprocess.run(["octave-cli", "--eval", code], capture_output=True, text=True, timeout=250)
    assert said.stdout in ("53 256", "256 53"), said.stderr


def test_where_it_comes_from_is_in_it(path, plan):
    with h5py.File(path) as file:
        assert file.attrs["scanner"] == "A"
        assert file.attrs["software"].startswith("steradian ")
        assert len(file.attrs["tuning_map"]) == 64
        assert f'"pulse_rate":{plan.pulse_rate}' in file["plan"].attrs["document"]
    assert list_frames(path)[0].excitation == 8e-7


def export_as_ipasc(path):
    export_scan(path, path.with_suffix(".hdf5"))


@pytest.mark.parametrize("version", [2, 0, "1", None])
@pytest.mark.parametrize("read", [read_scan, list_frames, verify_scan_file, ScanTail, export_as_ipasc])
def test_scan_file_of_unknown_version_is_refused_with_the_allowed_one(path, read, version):
    with h5py.File(path, "r+") as file:
        del file.attrs["schema_version"]
        if version is not None:
            file.attrs["schema_version"] = version
    with pytest.raises(DamagedFile, match=f"schema_version is {version}; allowed: 1$"):
        read(path)
