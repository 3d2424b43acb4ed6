"""The whole view stands in the address, and an address that makes no sense shows the plain view."""

import pytest

from support.page_modules import modules_of

MODULE = "volume/view_state.js"
FULL = {
    "at": [0.123456, -2.5, 3.6],
    "slab": [0, "Infinity", 1.25],
    "window": [-0.00125, 12345.6],
    "map": "cividis",
    "cut": 0.35,
    "centre": [1, 2, 3],
    "zoom": 3.5,
    "camera": [120, -40, 2],
    "clip": [0, 1, 0.25, 0.75, 0, 0.5],
    "line": {"plane": "y", "from": [-1, 2], "to": [1, 3.25]},
    "region": {"plane": "z", "from": [0, 0], "to": [1, 1]},
    "background": {"plane": "z", "from": [2, 2], "to": [3, 3]},
    "points": [[0.25, -1, 3.6], [0, 2.5, 1]],
    "against": "r01jz0000000000000000000000:3",
    "how": "blink",
    "tool": "line",
    "index": 4,
    "large": "3d",
    "depth": [0.5, 6.25],
    "smooth": "nearest",
    "gamma": 0.45,
    "log": 40,
    "overlayMap": "magenta",
    "overlayWindow": [0, 2.5],
    "opacity": [1, 0.4],
}
WHOLE = "given.view.slab = given.view.slab.map(Number);"


@pytest.fixture(scope="module")
def modules(chromium, service):
    with modules_of(chromium, service) as modules:
        yield modules


def test_a_view_comes_back_from_its_address(modules):
    """Every part of a view is the same after it has been written and read."""
    script = f"""{WHOLE} const back = m.decode('#' + m.encode(given.view));
        const same = JSON.stringify(back) === JSON.stringify({{...m.defaultView(), ...given.view}});
        return [same, back, m.encode(given.view)];"""
    same, back, text = modules.call(MODULE, script, view=FULL)
    assert same, (back, text)
    assert set(back) == set(FULL), "a part that no test knows"


def test_the_plain_view_needs_no_words(modules):
    assert modules.call(MODULE, "return m.encode(m.defaultView());") == ""


@pytest.mark.parametrize(
    "text",
    [
        "",
        "#",
        "#&&==",
        "#at=1,2",
        "#at=1,2,NaN",
        "#at=1,2,Infinity",
        "#slab=-1,0,0",
        "#window=3,1",
        "#map=<script>alert(1)</script>",
        "#map=__proto__",
        "#__proto__=1",
        "#constructor=1",
        "#zoom=0",
        "#zoom=1e99",
        "#camera=0,91,1",
        "#clip=0,1,0,1,0,2",
        "#line=w,0,0,1,1",
        "#line=x,0,0,1",
        "#points=1,2;1,2,3",
        "#points=" + ";".join(["1,2,3"] * 9),
        "#against=../../x",
        "#how=%E0%A4%A",
        "#cut=-1",
        "#large=all",
        "#depth=3,2",
        "#gamma=0",
        "#log=500",
        "#overlayMap=depth",
        "#opacity=1,2",
        "#against=r1:x",
    ],
)
def test_an_address_without_sense_is_the_plain_view(modules, text):
    assert modules.call(
        MODULE, "return JSON.stringify(m.decode(given.text)) === JSON.stringify(m.defaultView());", text=text
    )
