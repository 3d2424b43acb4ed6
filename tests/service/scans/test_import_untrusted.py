"""Files from strangers: what could reach outside, exhaust memory or run code is refused, naming what."""

import subprocess
import sys
import textwrap
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign
from poisons import FORMATS, POISONS, Poisoned

from steradian.core.exceptions import DamagedFile, InvalidInput, SteradianError
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("poison", POISONS, ids=lambda poison: poison.__name__)
def test_import_of_malicious_hdf5_file_is_refused_without_leftovers(tmp_path, poison, kind):
    """The error names the thing and no folder; nothing is left behind, and no other file is read."""
    write, *names = FORMATS[kind]
    source, description = write(tmp_path)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["a"] = np.ones((128, 96), "f4")
    with h5py.File(source, "r+") as file:
        poison(Poisoned(file, *names))
    folder = tmp_path / "scans"
    with pytest.raises((DamagedFile, InvalidInput), match=POISONS[poison]) as refusal:
        import_scan(source, folder / "scan.h5", description=description)
    assert str(tmp_path) not in str(refusal.value)
    assert not folder.exists() or list(folder.iterdir()) == []


def test_a_ring_of_groups_is_walked_once(tmp_path):
    """A group that holds itself is no way to keep the walk from ending."""
    source, _ = foreign.matlab_positions(tmp_path)
    with h5py.File(source, "r+") as file:
        file["ring/back"] = file.create_group("ring/on")
        file["ring/on/home"], file["root"] = file["ring"], file["/"]
    assert import_scan(source, tmp_path / "scan.h5").points == len(foreign.grid())


def test_any_flipped_or_missing_byte_is_an_error_or_no_harm(tmp_path):
    """Truncated and damaged files of every kind either import or end in an error of ours."""
    rng = np.random.default_rng(5)
    for write in (foreign.matlab_positions, foreign.kwave_index_mask, foreign.npz_with_positions, foreign.npy_fortran):
        folder = tmp_path / write.__name__
        folder.mkdir()
        source, description = write(folder)
        whole = source.read_bytes()
        for attempt in range(12):
            data = bytearray(whole[: rng.integers(len(whole))] if attempt % 2 else whole)
            for place in rng.integers(0, len(data), 3 if len(data) else 0):
                data[place] ^= int(rng.integers(1, 256))
            source.write_bytes(data)
            scan = folder / f"{attempt}.h5"
            try:
                import_scan(source, scan, description=description)
                open_recording(scan)
            except SteradianError:
                assert not scan.exists()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc, which Linux has")
def test_memory_stays_bounded_by_blocks(tmp_path):
    """100 MB of A-lines with time first, a chunk a time step, pass within 80 MB beyond what the libraries take."""
    points, samples = 25_600, 1024
    with h5py.File(tmp_path / "big.h5", "w") as file:
        for name, value in {"Nx": 4, "Ny": 160, "Nz": 160, "Nt": samples, "dt": 2e-8, "c_ref": 1500.0}.items():
            file[name] = np.full((1, 1, 1), value)
        for name in ("dx", "dy", "dz"):
            file[name] = np.full((1, 1, 1), 1e-4)
        places = 1 + 4 * np.arange(points)
        file["sensor_mask_index"] = places.astype("u8").reshape(1, 1, -1)
        p = file.create_dataset("p", (1, samples, points), "f4", chunks=(1, 1, points))
        row = np.random.default_rng(1).normal(size=points).astype("f4")
        for step in range(samples):
            p[0, step] = row
    code = """
        from pathlib import Path
        from steradian.scans.importing import import_scan
        import steradian.scans.importing.kwave, scipy.spatial
        def peak():  # of this program alone, unlike getrusage, which remembers the one that started it
            return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
        before = peak()
        import_scan(Path("big.h5"), Path("scan.h5"))
        print(peak() - before)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=tmp_path, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 80
