"""One function opens what Steradian has written, by its content, and says of anything else what it is not."""

import h5py
import numpy as np
import pytest

import steradian
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.imaging import VoxelAxes
from steradian.masks import equiangular_mask

MASK = steradian.equi_steradian_mask(10e-3, 3e-3, 40)
PLAN = steradian.ScanPlan(mask=MASK, samples=64)
LINES = [(np.arange(n) - 2) * 1e-4 for n in (4, 5, 6)]
VOLUME = steradian.Volume(np.ones((4, 5, 6), np.float32), VoxelAxes(*LINES), (1e-4,) * 3, 1500.0)
FLAT = steradian.Volume(np.ones((4, 6), np.float32), VoxelAxes(LINES[0], None, LINES[2]), (1e-4,) * 2, 1500.0)
LINE = equiangular_mask(10e-3, 2e-3, 30)


@pytest.mark.parametrize("made", [MASK, LINE, PLAN], ids=["mask", "line", "plan"])
def test_open_of_renamed_mask_or_plan_file_returns_equal_object(tmp_path, made):
    made.save(tmp_path / "made.json")
    (tmp_path / "made.json").rename(tmp_path / "anything")
    again = steradian.open(tmp_path / "anything")
    assert again == made
    assert hash(again) == hash(made)
    assert again != VOLUME
    assert repr(again) == repr(made) == str(made)


@pytest.mark.parametrize("made", [VOLUME, FLAT], ids=["volume", "image"])
def test_volumes_come_back_from_their_file_and_from_the_folder_of_a_reconstruction(tmp_path, made):
    made.save(tmp_path / "folder" / "volume.h5")
    for path in (tmp_path / "folder", str(tmp_path / "folder" / "volume.h5")):
        again = steradian.open(path)
        np.testing.assert_array_equal(again.values, made.values)
        assert (again.spacing, again.sound_speed, again.origin) == (made.spacing, 1500.0, made.origin)


@pytest.mark.parametrize("name", ["a.nii.gz", "a.nrrd", "a.vtkhdf", "a.tif", "a.zarr", "a.png", "a.h5"])
def test_volume_save_chooses_format_by_extension_and_leaves_no_extra_file(tmp_path, name):
    VOLUME.save(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("made", [MASK, PLAN, VOLUME], ids=["mask", "plan", "volume"])
def test_an_unknown_ending_is_refused_and_named(tmp_path, made):
    for name in ("a.docx", "a"):
        with pytest.raises(InvalidInput, match=r"file is a.*\.(json|nii)"):
            made.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("made", [MASK, LINE, PLAN, VOLUME, FLAT], ids=["mask", "line", "plan", "volume", "image"])
def test_everything_plots_into_given_axes_or_its_own_and_shows_itself_in_a_notebook(made):
    from matplotlib import pyplot

    figure, axes = pyplot.subplots()
    assert (made.plot("z", axes) if made in (VOLUME, FLAT) else made.plot(axes)) is axes
    own = made.plot()
    assert own.figure is not figure
    assert own.get_xlabel()
    pyplot.close("all")
    shown = made._repr_html_()
    assert 'src="data:image/png;base64,' in shown
    assert len(shown) < 400_000


def test_the_depth_points_down_and_voxels_lie_where_their_axes_say():
    from matplotlib import pyplot

    values = np.zeros((4, 5, 6), np.float32)
    values[3, 1, 5] = 1.0
    image = steradian.Volume(values, VOLUME.axes, VOLUME.spacing)
    for axis, (across, up), downwards in (("x", (1, 5), True), ("y", (3, 5), True), ("z", (3, 1), False)):
        axes = image.plot(axis)
        shown = axes.images[0]
        row, column = np.unravel_index(np.asarray(shown.get_array()).argmax(), shown.get_array().shape)
        left, right, bottom, top = shown.get_extent()
        rows, columns = shown.get_array().shape
        x = left + (column + 0.5) / columns * (right - left)
        y = bottom + (row + 0.5) / rows * (top - bottom)  # rows from the bottom: origin is lower
        lines = {"x": (LINES[1], LINES[2]), "y": (LINES[0], LINES[2]), "z": (LINES[0], LINES[1])}[axis]
        np.testing.assert_allclose([x, y], [1e3 * lines[0][across], 1e3 * lines[1][up]], atol=1e-9)
        assert (bottom > top) is downwards
    pyplot.close("all")


def test_open_of_unsupported_or_damaged_file_raises_matching_error(tmp_path):
    with pytest.raises(NotFound):
        steradian.open(tmp_path / "none.h5")
    with pytest.raises(NotFound):
        steradian.open(tmp_path)
    wrong = {"text": b"hello", "list.json": b"[1, 2]", "half.json": b'{"positions": [', "other.json": b'{"a": 1}'}
    for name, content in wrong.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DamagedFile, match=name):
            steradian.open(tmp_path / name)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["p"] = np.zeros(3)
    with pytest.raises(DamagedFile, match=r"no format.*steradian import"):
        steradian.open(tmp_path / "other.h5")
    VOLUME.save(tmp_path / "volume.h5")
    whole = (tmp_path / "volume.h5").read_bytes()
    (tmp_path / "volume.h5").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DamagedFile):
        steradian.open(tmp_path / "volume.h5")
    MASK.save(tmp_path / "mask.csv")
    with pytest.raises(InvalidInput, match="read_mask"):
        steradian.open(tmp_path / "mask.csv")
