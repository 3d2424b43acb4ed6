"""HDF5 files damaged by one bit of a header, which open all the same; what reading raises then is no ``OSError``."""

import h5py

# found by trying every bit of the headers of scan files: a place after the beginning of a dataset's, and the bit
NAMED_TYPE = 16, 0x01  # its dataspace is unknown: it is a type with a name; TypeError, AttributeError
SCALAR = 25, 0x01  # it has no axis; ValueError, TypeError
GROUP = 48, 0x01  # it is a group of no known kind; RuntimeError, TypeError
BITS = [NAMED_TYPE, SCALAR, GROUP]


def spoil(path, dataset, bit=NAMED_TYPE):
    """Change one bit of a file; the dataset is there afterwards, but is none or of another shape."""
    with h5py.File(path, "r") as file:
        header = h5py.h5o.get_info(file[dataset].id).addr
    at, mask = bit
    with path.open("r+b") as file:
        file.seek(header + at)
        (byte,) = file.read(1)
        file.seek(header + at)
        file.write(bytes([byte ^ mask]))
    with h5py.File(path, "r") as file:
        assert dataset in file
