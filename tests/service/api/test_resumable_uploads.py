"""Partial files of resumable uploads: where the next bytes may begin."""

import pytest

from steradian.api.http.resumable_uploads import Part
from steradian.core.exceptions import Conflict


@pytest.mark.parametrize("offset", [0, 3, 5])
def test_part_at_another_offset_than_its_size_is_refused(tmp_path, offset):
    part = Part.begin(tmp_path, "u1", 10)
    with part.open(0) as file:
        file.write(b"four")
    with pytest.raises(Conflict, match=f"Upload-Offset is {offset}; allowed: 4"), part.open(offset):
        pass
    with part.open(4) as file:
        file.write(b"more")
    assert Part.find(tmp_path, "u1").offset == 8


def test_part_that_another_request_writes_is_refused(tmp_path):
    part = Part.begin(tmp_path, "u1", 10)
    with part.open(0), pytest.raises(Conflict, match="another request"), part.open(0):
        pass
