"""Regions as JSON and as text."""

import json

import pytest

from steradian import InvalidInput
from steradian.core.exceptions import DamagedFile, NotFound
from steradian.quality import (
    AboveThreshold,
    Box,
    Ellipsoid,
    Polygon,
    read_regions,
    region_from_json,
    region_from_text,
    region_to_json,
    write_regions,
)

BOX = Box("vessel", ((-2e-4, 2e-4), (-1e-3, 1e-3), (1.9e-3, 2.1e-3)))
REGIONS = [
    BOX,
    Ellipsoid("tumour", (0.0, 0.0, 2e-3), (1e-3, 1e-3, 5e-4)),
    Polygon("painted", "z", ((0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3)), (1e-3, 2e-3)),
    AboveThreshold("bright", BOX, 0.5),
]
BESIDE = Box("beside", ((2e-3, 3e-3), (-1e-3, 1e-3), (1.9e-3, 2.1e-3)))


def test_regions_are_read_as_they_were_written(tmp_path):
    write_regions(tmp_path / "regions.json", REGIONS, BESIDE)
    assert read_regions(tmp_path / "regions.json") == (REGIONS, BESIDE)
    write_regions(tmp_path / "plain.json", REGIONS)
    assert read_regions(tmp_path / "plain.json") == (REGIONS, None)


def test_texts_in_millimetres_are_regions():
    texts = (
        "box vessel -0.2:0.2,-1:1,1.9:2.1",
        "ellipsoid tumour 0,0,2 1,1,0.5",
        "polygon painted z 0,0;1,0;0,1 1:2",
        "above 0.5 box vessel -0.2:0.2,-1:1,1.9:2.1",
    )
    for text, expected in zip(texts, REGIONS, strict=True):
        found, wanted = region_to_json(region_from_text(text)), region_to_json(expected)
        assert json.dumps(_rounded(found)) == json.dumps(_rounded(wanted | {"name": found["name"]}))


def _rounded(said):
    if isinstance(said, dict):
        return {name: _rounded(value) for name, value in said.items()}
    if isinstance(said, list):
        return [_rounded(value) for value in said]
    return round(said, 9) if isinstance(said, float) else said


@pytest.mark.parametrize("text", ["", "box", "box a 0:1,2", "cone a 0:1", "polygon a z 0,0,0;1,1 1:2", "above box a"])
def test_texts_of_no_region_are_refused_with_the_forms(text):
    with pytest.raises(InvalidInput, match=r"region is .*allowed: box NAME"):
        region_from_text(text)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"kind": "cone", "name": "a"}, r"region\.kind is cone; allowed: box, ellipsoid"),
        ({"kind": "box", "name": ""}, r"region\.name"),
        ({"kind": "box", "name": "a"}, r"region\.ranges is missing"),
        ({"kind": "box", "name": "a", "ranges": [[0, 1, 2]]}, "region a is .*numbers in metres"),
        ({"kind": "ellipsoid", "name": "a", "centre": "abc", "radii": [1]}, "region a is"),
        ({"kind": "above-threshold", "name": "a", "share": 0.5, "within": 3}, "region a is"),
    ],
)
def test_objects_of_no_region_are_refused_with_field(said, told):
    with pytest.raises(InvalidInput, match=told):
        region_from_json(said)


def test_thresholds_within_each_other_have_a_limit():
    said = region_to_json(BOX)
    for _ in range(9):
        said = {"kind": "above-threshold", "name": "a", "share": 0.5, "within": said}
    with pytest.raises(InvalidInput, match="at most 8"):
        region_from_json(said)


def test_files_of_another_kind_are_refused(tmp_path):
    path = tmp_path / "a.json"
    with pytest.raises(NotFound):
        read_regions(path)
    for text in ("{", "[]", '{"format": "steradian-regions", "version": 2}'):
        path.write_text(text)
        with pytest.raises(DamagedFile):
            read_regions(path)
    path.write_text('{"format": "steradian-regions", "version": 1, "regions": [], "background": "beside"}')
    with pytest.raises(InvalidInput, match="background is beside; allowed: none"):
        read_regions(path)
