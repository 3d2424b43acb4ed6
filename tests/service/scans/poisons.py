"""Ways to make an HDF5 recording of any format dangerous, and the words with which each is refused."""

import sys
import zlib
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import foreign


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
    group_for_data: "no dataset|has no variable|unknown in a scan file|0 cuboids",
    not_finite: "finite|checksum",
    beyond_float32: "finite|float64",
    beyond_use: "finite|checksum",
    several_numbers_for_one: "sampling_interval|expected one finite number",
}
