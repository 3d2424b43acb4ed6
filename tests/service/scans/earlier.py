"""Making scan files of earlier versions out of today's."""

import google_crc32c
import h5py


def as_version_2(path):
    """Take out what the second version did not have."""
    with h5py.File(path, "r+") as file:
        alines = file["alines"]
        for name in ("averages", "time_zero_s", "dc_v", "gain_db"):
            del alines[name]
        for row in alines["status"][:].nonzero()[0]:
            alines["crc32c"][row] = google_crc32c.value(alines["samples"][row].tobytes())
        file.attrs["schema_version"] = 2


def as_version_1(path):
    """Take out what the first version did not have."""
    as_version_2(path)
    with h5py.File(path, "r+") as file:
        del file["run"], file["plan/frame_excitation"]
        for name in ("scanner_model", "tuning_map", "geometry_crc32c"):
            del file.attrs[name]
        for name in ("frames", "document"):
            del file["plan"].attrs[name]
        file.attrs["schema_version"] = 1
