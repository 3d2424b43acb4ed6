"""Files from strangers: what could reach outside, exhaust memory or run code is refused, naming what."""

import pickle
import subprocess
import sys
import textwrap
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from steradian.errors import DamagedFile, InvalidInput, SteradianError
from steradian.scans.importing import import_scan
from steradian.scans.opening import open_recording


class Poisoned:
    """An open file of some format, and what its datasets are called there."""

    def __init__(self, file, traces, places, number):
        self.file, self.traces, self.places, self.number = file, traces, places, number

    def replace(self, name, **options):
        del self.file[name]
        return self.file.create_dataset(name, **options)

    @property
    def like(self):
        """Shape of the A-lines, to be there again."""
        return self.file[self.traces].shape


FORMATS = {
    "matlab": (foreign.matlab_positions, "sensor_data", "positions", "dt"),
    "own": (foreign.own_scan, "alines/samples", "mask/positions", "fired"),
    "ipasc": (
        foreign.ipasc_by_pacfish,
        "binary_time_series_data",
        "meta_data_device/detectors/0000000003/detector_position",
        "meta_data/ad_sampling_rate",
    ),
    "kwave": (foreign.kwave_index_mask, "p", "sensor_mask_index", "dt"),
}


def external_link(it):
    del it.file[it.traces]
    it.file[it.traces] = h5py.ExternalLink("secret.h5", "/a")


def external_link_deep_inside(it):
    it.file.create_group("a/b/c")["d"] = h5py.ExternalLink("secret.h5", "/a")


def soft_link(it):
    it.file["elsewhere"] = h5py.SoftLink(f"/{it.places}")


def dangling_soft_link(it):
    it.file["elsewhere"] = h5py.SoftLink("/none/../secret.h5")


def nested_groups(it):
    group = it.file.id
    for _ in range(20_000):
        group = h5py.h5g.create(group, b"a")


def virtual_dataset(it):
    shape = it.like
    layout = h5py.VirtualLayout(shape, "f4")
    layout[...] = h5py.VirtualSource("secret.h5", "a", shape)
    del it.file[it.traces]
    it.file.create_virtual_dataset(it.traces, layout)


def external_storage(it):
    shape = it.like
    it.replace(it.traces, shape=shape, dtype="f4", external=[("secret.h5", 0, 4 * int(np.prod(shape)))])


def external_places(it):
    kept = it.file[it.places][()]
    it.replace(it.places, shape=kept.shape, dtype=kept.dtype, external=[("secret.h5", 0, kept.nbytes)])


def external_number(it):
    """The library's lower level: h5py itself drops the option where the dataset is a scalar."""
    kind, space = it.file[it.number].id.get_type(), it.file[it.number].id.get_space()
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_external(b"secret.h5", 0, 8)
    del it.file[it.number]
    group, _, name = it.number.rpartition("/")
    h5py.h5d.create(it.file[group or "/"].id, name.encode(), kind, space, made)


def object_references(it):
    it.replace(it.places, data=[[it.file[it.number].ref]], dtype=h5py.ref_dtype)


def region_references(it):
    it.replace(it.places, data=[[it.file[it.traces].regionref[:]]], dtype=h5py.regionref_dtype)


def variable_strings(it):
    it.replace(it.places, data=[["a"] * 96] * 2, dtype=h5py.string_dtype())


def variable_numbers(it):
    it.replace(it.places, shape=(2, 96), dtype=h5py.vlen_dtype("f8"))


def compound(it):
    it.replace(it.places, data=np.zeros((2, 96), [("a", "f8"), ("b", "f8")]))


def complex_numbers(it):
    it.replace(it.traces, data=np.zeros((128, 96), "c8"))


def absurd_shape(it):
    it.replace(it.traces, shape=(1 << 30, 1 << 30), dtype="f8", chunks=(1, 1024))


def absurd_rank(it):
    it.replace(it.traces, data=np.zeros((2,) * 12))


def nothing_stored(it):
    it.replace(it.traces, shape=(60_000, 1000), dtype="f4", chunks=(1000, 100))


def absurd_chunk(it):
    it.replace(it.traces, shape=(1 << 15, 1 << 13), dtype="f8", chunks=(1 << 13, 1 << 13))


def tiny_chunks(it):
    it.replace(it.traces, shape=(1 << 12, 1 << 13), dtype="f8", chunks=(1, 1), fillvalue=1.0)


def compression_bomb(it):
    it.replace(it.traces, data=np.zeros((65536, 96), "f8"), chunks=(4096, 96), compression="gzip")


def inflating_chunk(it):
    """A chunk that says 48 kB and inflates to 32 MB; only looking inside tells."""
    shape = it.like
    made = it.replace(it.traces, shape=shape, dtype="f4", chunks=shape, compression="gzip")
    made.id.write_direct_chunk((0,) * len(shape), zlib.compress(bytes(32 << 20), 9))


def chunk_of_noise(it):
    shape = it.like
    made = it.replace(it.traces, shape=shape, dtype="f4", chunks=shape, compression="gzip")
    made.id.write_direct_chunk((0,) * len(shape), b"no gzip at all")


def strange_filter(it):
    it.replace(it.traces, data=np.zeros(it.like, "f4"), compression="lzf")


def group_for_data(it):
    del it.file[it.traces]
    it.file.create_group(it.traces)


def not_finite(it):
    it.file[it.traces][(0,) * len(it.like)] = np.inf


def beyond_float32(it):
    it.replace(it.traces, data=np.full(it.like, 1e300))


def beyond_use(it):
    """Fits into float32, but its square does not."""
    it.replace(it.traces, data=np.full(it.like, 2.5e38, "f4"))


def several_numbers_for_one(it):
    it.replace(it.number, data=np.zeros((3, 3)))


POISONS = {
    external_link: "link to another file",
    external_link_deep_inside: "a/b/c/d is a link to another file",
    soft_link: "soft link",
    dangling_soft_link: "soft link",
    nested_groups: "32 groups deep",
    virtual_dataset: "virtual",
    external_storage: "another file",
    external_places: "another file",
    external_number: "another file",
    object_references: "references",
    region_references: "references",
    variable_strings: "text",
    variable_numbers: "variable length",
    compound: "expected real numbers",
    complex_numbers: "expected real numbers",
    absurd_shape: "allowed: at most",
    absurd_rank: "1 to 5 axes",
    nothing_stored: "200 times",
    absurd_chunk: "chunks",
    tiny_chunks: "chunks",
    compression_bomb: "200 times",
    inflating_chunk: "inflates",
    chunk_of_noise: "gzip",
    strange_filter: "lzf",
    group_for_data: "no dataset|has no variable|nothing that a scan file|0 cuboids",
    not_finite: "finite|checksum",
    beyond_float32: "finite|float64",
    beyond_use: "finite|checksum",
    several_numbers_for_one: "sampling_interval|expected one finite number",
}


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("poison", POISONS, ids=lambda poison: poison.__name__)
def test_a_poisoned_hdf5_file_of_any_format_is_refused_with_what_is_wrong(tmp_path, poison, kind):
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


def _poisoned_zip(path, name, data, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for other, value in {"dt": np.array(1e-8), "dx": np.array(1e-4), "c": np.array(1500.0)}.items():
            with archive.open(f"{other}.npy", "w") as member:
                np.save(member, value)
        with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
            member.write(data)
    return path


def _header(shape, kind="<f4"):
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


class Trap:
    """Writes a file when it is unpickled."""

    def __reduce__(self):
        return Path.touch, (Path("trapped"),)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("pickle.npy", _header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
        ("truncated.npy", _header((96, 128)) + b"123", "truncated"),
        ("longer.npy", _header((2, 2)) + bytes(17), "more than"),
        ("absurd.npy", _header((1 << 40, 1 << 40)), "shape"),
        ("negative.npy", _header((-5, 16)), "shape"),
        ("flat.npy", _header((16,)) + bytes(64), "points and time"),
        ("structured.npy", _header((2,), [("a", "<f8")]) + bytes(16), "kind"),
        ("header.npy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "no .npy"),
        ("open.npy", b"\x93NUMPY\x01\x00\x40\x00" + b"{'descr': ('<f4'".ljust(63) + b"\n", "no .npy"),
        ("words.csv", b"1,2,3\n4,five,6\n", "neither"),
        ("ragged.csv", b"1,2,3\n4,5\n", "row 2"),
        ("empty.csv", b"# nothing\n", "no numbers"),
        ("late.csv", b"1,2,3\n" * 1000 + b"1,2,x\n", "not a table of numbers"),
        ("pickle.bin", pickle.dumps([Trap()]), "neither"),
        ("none.h5", b"\x89HDF\r\n\x1a\n" + bytes(500), "HDF5"),
        ("none.zip", b"PK\x03\x04" + bytes(500), ".npz"),
    ],
)
def test_a_poisoned_array_is_refused_and_never_unpickled(tmp_path, monkeypatch, name, data, words):
    """Pickles, lying headers and broken tables end in one clear error."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(data)
    about = foreign.describe(tmp_path, sampling_interval=1e-8, sound_speed=1500.0, grid={"interval": [1e-4]})
    with pytest.raises((DamagedFile, InvalidInput), match=words):
        import_scan(tmp_path / name, tmp_path / "scan.h5", description=about)
    assert not (tmp_path / "trapped").exists()
    assert not (tmp_path / "scan.h5").exists()


def _mat5(path, **variables):
    from scipy.io import savemat

    savemat(path, {"dt": foreign.DT, "c": foreign.SPEED, "positions": foreign.grid()} | variables, do_compression=True)
    return path


def _function_handle(path):
    """A variable whose class is that of a function handle; nothing here can write a real one."""
    from scipy.io import savemat

    savemat(path, {"sensor_data": foreign.expected(foreign.grid())})
    data = bytearray(path.read_bytes())
    data[128 + 16] = 16  # the first byte of the flags of the first variable: its class
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: _mat5(path, other=np.zeros((3, 3))), "has no variable 'sensor_data'; it holds dt, c, positions"),
        (lambda path: _mat5(path, sensor_data=np.array([1, "a"], object)), "sensor_data is a cell"),
        (lambda path: _mat5(path, sensor_data={"p": np.zeros((3, 3))}), "sensor_data is a struct"),
        (lambda path: _mat5(path, sensor_data="words"), "sensor_data is a char"),
        (lambda path: _mat5(path, sensor_data=np.zeros((96, 128), complex)), "no real numbers"),
        (lambda path: _mat5(path, sensor_data=np.zeros((96, 65536))), "200 times"),
        (lambda path: _mat5(path, sensor_data=np.zeros(0)), "shape"),
        (lambda path: _mat5(path, sensor_data=np.full((96, 128), np.nan)), "finite"),
        (_function_handle, "sensor_data is a function"),
    ],
)
def test_a_matlab_file_of_more_than_numbers_is_refused(tmp_path, write, words):
    """Cells, structures, functions, texts and bombs where numbers belong: named; what to do instead is said."""
    source = write(tmp_path / "a.mat")
    with pytest.raises((DamagedFile, InvalidInput), match=words):
        import_scan(source, tmp_path / "new" / "scan.h5")
    assert not list((tmp_path / "new").iterdir())


def test_what_else_a_matlab_file_holds_is_nobodys_business(tmp_path):
    """Cells, structures and texts of the user's own are not read."""
    notes = {"notes": np.array([1, "a"], object), "about": {"when": 3}, "name": "film"}
    source = _mat5(tmp_path / "a.mat", sensor_data=foreign.expected(foreign.grid()), **notes)
    assert import_scan(source, tmp_path / "scan.h5").points == len(foreign.grid())


def test_a_positions_file_that_lies_about_its_size_is_refused_unread(tmp_path):
    """Neither 8 EB nor a pickle is taken from a file that a description names."""
    source, _ = foreign.npy_time_first(tmp_path)
    about = {"sampling_interval": 1e-8, "sound_speed": 1500.0, "axes": "time, point", "positions": "where.npy"}
    for data in (_header((1 << 60, 2)), _header((1 << 20, 2)), _header((96,), "|O") + pickle.dumps([Trap()])):
        (tmp_path / "where.npy").write_bytes(data)
        with pytest.raises(DamagedFile, match=r"where\.npy"):
            import_scan(source, tmp_path / "scan.h5", description=foreign.describe(tmp_path, **about))


def test_poisoned_archives_are_refused(tmp_path):
    """A zip bomb, a pickle in a zip, a member that ends early and an endless one."""
    for data, words in [
        (_header((1 << 11, 64, 64)) + bytes(1 << 25), "200 times"),
        (_header((1,), "|O") + pickle.dumps([Trap()]), "kind object"),
        (_header((64, 4, 4)) + bytes(100), "end after"),
        (_header((64, 4, 4)) + bytes(64 * 4 * 4 * 4 + 400), "end after"),
    ]:
        source = _poisoned_zip(tmp_path / "a.npz", "p", data)
        with pytest.raises(DamagedFile, match=words):
            import_scan(source, tmp_path / "scan.h5")
        assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


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
        [sys.executable, "-c", textwrap.dedent(code)], cwd=tmp_path, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 80
