"""What the library refuses: numbers in other units, nonsense, and images that do not fit into the memory."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.core.system_resources import available_memory, cgroup_memory_headroom, cpu_count
from steradian.imaging import (
    Acquisition,
    ElasticFilm,
    ImageGrid,
    InverseFilter,
    Iterative,
    ReconstructionPlan,
    Window,
    kaiser_bessel,
    reconstruct,
)
from steradian.masks import equi_steradian_mask, equiangular_mask
from support.flat import flat_fit, flat_operator, flat_plan, flat_reconstruct

MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 100)
TRACES = np.random.default_rng(0).standard_normal((MASK.count, 64)).astype(np.float32)
COMMON: dict[str, Any] = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "aperture": MASK.aperture, "modes": 16}
OFF_UNIT: dict[str, Any] = {
    "positions": 1e3 * MASK.positions,
    "aperture": 1e3 * MASK.aperture,
    "sampling_interval": 8,
    "sound_speed": 1.5,
    "modes": "64",
    "threads": -3,
}


@pytest.mark.parametrize(
    ("field", "change", "says"),
    [
        ("aperture", {"aperture": 13.56}, r"aperture is 13\.56; allowed: > 0, at most 1 \(m\)"),
        ("aperture", {"aperture": "13.56e-3"}, "at most 1"),
        ("aperture", {"aperture": None}, "at most 1"),
        ("dt", {"sampling_interval": 8}, r"is 8; allowed: at least 1e-10, at most 1e-05 \(s\)"),
        ("dt", {"sampling_interval": 125e6}, r"at most 1e-05 \(s\)"),
        ("sound_speed", {"sound_speed": 1.5}, r"is 1\.5; allowed: at least 300, at most 6000 \(m/s\)"),
        ("sound_speed", {"sound_speed": "1500"}, "is '1500'"),
        ("weights[0]", {"weights": -MASK.weights[0] + 0 * MASK.weights}, r"at least 0 \(m²\)"),
        ("weights[7]", {"weights": np.where(np.arange(MASK.count) == 7, np.nan, MASK.weights)}, "is nan"),
        (
            "weights",
            {"weights": 1e6 * MASK.weights},
            r"a sum of 144.* 1e-07 to 4 times the aperture's 0\.000183874 m²",
        ),
        ("weights", {"weights": MASK.weights / MASK.weights.sum()}, "a sum of 1;"),
        ("weights", {"weights": ["a"] * MASK.count}, "one weight a sensor"),
        ("modes", {"modes": "64"}, "is '64'; allowed: a whole number from 2 to 4,096"),
        ("modes", {"modes": np.inf}, "a whole number from 2"),
        ("modes", {"modes": 60000}, "is 60000; allowed: a whole number from 2 to 4,096"),
        ("threads", {"threads": -3}, "from 1"),
        ("threads", {"threads": "two"}, "from 1"),
        ("tolerance", {"tolerance": "high"}, r"at least 1e-12, at most 0\.1 \(relative\)"),
        ("tolerance", {"tolerance": 0.2}, r"at least 1e-12, at most 0\.1 \(relative\)"),
        ("upsampling", {"upsampling": 17}, "a whole number from 1 to 16"),
        ("time_padding", {"time_padding": 17}, r"at least 1, at most 16 \(times\)"),
        ("max_frequency", {"highest_frequency": -1.0}, "a frequency above 0 Hz"),
        ("depth_step", {"method": "iterative", "depth_step": 1e-4}, "uses no other"),
        ("t0", {"time_zero": "0"}, r"is .0.; allowed: at least -0\.0005, at most 0\.0005 \(s\)"),
        ("t0", {"time_zero": 1e300}, r"at most 0\.0005 \(s\)"),
        ("aperture", {"aperture": 1e-300}, "1e-06 to 1 m"),
        ("traces", {"scale": 1e300}, "beyond the range of the working precision"),
        ("traces", {"scale": 1e33}, "beyond the range of the working precision"),  # its sums would overflow
        ("depth", {"depth_range": 5e-3}, "two depths in metres"),
        ("depth", {"depth_range": (0.0, 5.0)}, "two depths in metres"),
        ("scale", {"scale": "2"}, "a finite factor"),
        ("dtype", {"dtype": "float32", "tolerance": 1e-9}, "float64 or None for a tolerance below 5e-06"),
        ("time_padding", {"method": "iterative", "time_padding": 2.0}, "uses no other"),
        (
            "correction.max_gain",
            {"method": "iterative", "correction": InverseFilter(ElasticFilm(), 20.0)},
            "uses no other",
        ),
        ("correction", {"correction": ElasticFilm()}, "is ElasticFilm; allowed: an InverseFilter"),
    ],
)
def test_invalid_parameter_is_refused_with_field_and_allowed_values(
    field: str, change: dict[str, Any], says: str
) -> None:
    with pytest.raises(InvalidInput, match=says) as caught:
        flat_reconstruct(TRACES, MASK.positions, **{**COMMON, **change})
    assert caught.value.field == field


def test_positions_in_millimetres_are_refused_also_beside_an_aperture_in_millimetres() -> None:
    for aperture in (13.56, 13.56e-3):
        with pytest.raises(InvalidInput, match=r"sensors\[\d+\] is .*±0\.5 m about the middle, in metres"):
            flat_reconstruct(TRACES, 1e3 * MASK.positions, **{**COMMON, "aperture": aperture})


@pytest.mark.parametrize("method", ["nedner", "linear", "nearest", "iterative"])
def test_transposed_traces_are_refused_with_hint(method: Any) -> None:
    """HDF5 of MATLAB comes so, and the count of samples must not be taken from the sensors."""
    says = f"one row for each of the {MASK.count} sensors; this has a column for each: transpose it"
    with pytest.raises(InvalidInput, match=says):
        flat_reconstruct(TRACES.T, MASK.positions, **COMMON, method=method)


@pytest.mark.parametrize("field", OFF_UNIT)
@pytest.mark.parametrize("way", ["plan", "operator", "fit"])
def test_plan_operator_and_fit_refuse_the_same(way: str, field: str) -> None:
    given = {"positions": MASK.positions, **COMMON, field: OFF_UNIT[field]}
    ways: dict[str, Callable[[], object]] = {
        "plan": lambda: flat_plan(samples=64, **given),
        "operator": lambda: flat_operator(samples=64, **given),
        "fit": lambda: flat_fit(TRACES, **given),
    }
    with pytest.raises(InvalidInput) as caught:
        ways[way]()
    renamed = {"positions": "sensors", "sampling_interval": "dt"}
    assert caught.value.field.partition("[")[0] == renamed.get(field, field)


@pytest.mark.parametrize("method", ["nedner", None, ElasticFilm(), {"iterations": 3}])
def test_reconstruct_and_plan_reject_values_that_are_not_methods(method: Any) -> None:
    acquisition = Acquisition(TRACES, MASK, dt=8e-9, sound_speed=1500.0)
    with pytest.raises(InvalidInput, match="Nufft, Ner, LinearKappa, NearestKappa, Gridded, Iterative") as caught:
        reconstruct(acquisition, ImageGrid(16), method)
    assert caught.value.field == "method"
    for other in (method, Iterative()):
        with pytest.raises(InvalidInput, match=r"Gridded; Iterative is for reconstruct\(\)"):
            ReconstructionPlan(acquisition.geometry, ImageGrid(16), other)


def test_equivalent_parameter_types_give_same_image() -> None:
    image = flat_reconstruct(TRACES, MASK.positions, weights=MASK.weights, **COMMON).values
    forms: list[dict[str, Any]] = [
        {"dtype": np.float32},
        {"dtype": np.dtype("float32")},
        {"modes": np.int64(16)},
        {"modes": (16.0, 16)},
        {"sampling_interval": np.float32(8e-9)},
        {"aperture": np.array([MASK.aperture] * 2)},
        {"threads": np.int32(1)},
        {"weights": MASK.weights.tolist()},
    ]
    for form in forms:
        same = flat_reconstruct(TRACES, MASK.positions, **{"weights": MASK.weights, **COMMON, **form}).values
        np.testing.assert_allclose(same, image, atol=1e-4 * np.abs(image).max())


@pytest.mark.long
@pytest.mark.parametrize("method", ["nedner", "iterative"])
def test_mask_argument_equals_explicit_positions_weights_aperture(method: Any) -> None:
    common = {name: value for name, value in COMMON.items() if name != "aperture"}
    whole = flat_reconstruct(
        TRACES, MASK.positions, aperture=MASK.aperture, weights=MASK.weights, method=method, **common
    ).values
    np.testing.assert_array_equal(flat_reconstruct(TRACES, MASK, method=method, **common).values, whole)
    line = equiangular_mask(13.56e-3, 3.6e-3, 50)
    image = flat_reconstruct(TRACES[: line.count], line, method=method, **common)
    assert image.names == ("x", "z")


def test_weights_that_miss_the_rim_or_reach_beyond_it_are_areas() -> None:
    axis = (np.arange(4) - 1.5) * 1e-3  # an aperture that ends at the sensors: cells reach half a pitch beyond it
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    common = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "modes": 16}
    for aperture in (3e-3, 4e-3, 40e-3):
        flat_reconstruct(TRACES[:16], grid, aperture=aperture, weights=np.full(16, 1e-6), **common)


def test_a_window_wider_than_a_spectrums_repeated_ends_is_refused() -> None:
    with pytest.raises(InvalidInput, match="width is 60; allowed: a whole number from 2 to 48"):
        kaiser_bessel(30, 2.0)


@pytest.mark.parametrize(
    ("field", "made"),
    [
        ("width", lambda: Window("semicircle", 1, 2.0, 10.0)),
        ("width", lambda: Window("semicircle", 5.5, 2.0, 10.0)),  # type: ignore[arg-type]
        ("oversampling", lambda: Window("kaiser-bessel", 6, 0.9, 10.0)),
        ("oversampling", lambda: Window("kaiser-bessel", 6, 1.0, 10.0)),
        ("oversampling", lambda: kaiser_bessel(3, 0.0)),
        ("beta", lambda: Window("kaiser-bessel", 6, 2.0, -3.0)),
        ("beta", lambda: Window("kaiser-bessel", 6, 2.0, np.nan)),
        ("half_width", lambda: kaiser_bessel(np.nan, 2.0)),
    ],
)
def test_a_window_that_is_none_is_refused(field: str, made: Callable[[], Window]) -> None:
    with pytest.raises(InvalidInput) as caught:
        made()
    assert caught.value.field == field


CHILD = """
import resource, numpy as np
resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
from steradian import (
    Acquisition, Compute, ForwardOperator, ImageGrid, InvalidInput, Iterative, ReconstructionPlan, reconstruct
)
rng = np.random.default_rng(0)
positions, traces = (rng.random((40, 2)) - 0.5) * 0.01, rng.standard_normal((40, 1024)).astype(np.float32)
a, cpu = Acquisition(traces, positions, dt=8e-9, sound_speed=1500.0, aperture=0.01), Compute(device="cpu")
ways = {
    "reconstruct": lambda grid: reconstruct(a, grid, compute=cpu),
    "plan": lambda grid: ReconstructionPlan(a.geometry, grid, compute=cpu),
    "operator": lambda grid: ForwardOperator(a.geometry, grid, compute=cpu),
    "fit": lambda grid: reconstruct(a, grid, Iterative(), compute=cpu),
}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for name, way in ways.items():
    for grid in (ImageGrid(4096), ImageGrid(4096, depth=(0.0, 0.0))):
        try:
            way(grid)
        except InvalidInput as error:
            print(name, error)
print("grown by", (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10, "MiB")
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="the limit of an address space is Linux's")
def test_an_image_that_the_memory_cannot_hold_is_refused_with_both_numbers_before_anything_is_taken() -> None:
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    *refusals, grown = done.stdout.splitlines()
    assert [line.split()[0] for line in refusals] == [
        w for w in ("reconstruct", "plan", "operator", "fit") for _ in "ab"
    ]
    for line in refusals:
        assert "modes is 4096 × 4096; allowed: what the available" in line
        there, needed = (int(part.split()[0]) for part in (line.split("the available ")[1], line.split("at least ")[1]))
        assert there < 6 << 30 < needed
    assert int(grown.split()[2]) < 64


def test_prime_modes_exceeding_memory_limit_are_refused() -> None:
    line: dict[str, Any] = {**COMMON, "samples": 64, "memory_limit": 4 << 30}
    with pytest.raises(InvalidInput, match="memory_limit"):
        flat_plan(MASK.positions[:, 0], **{**line, "modes": 4096, "lateral_padding": 65_521 / 4096})
    flat_plan(MASK.positions[:, 0], **{**line, "modes": 4096, "lateral_padding": 16})


def test_available_memory_is_plausible() -> None:
    there = available_memory()
    assert there is not None
    assert 1 << 20 < there < 1 << 50


@pytest.mark.parametrize(
    ("told", "files", "room"),
    [
        (
            "0::/batch/job\n",  # the group of a batch system is the narrower one; what files take is given back
            {
                "batch/memory.max": "8000",
                "batch/memory.current": "7000",
                "batch/memory.stat": "anon 1\ninactive_file 500\nactive_file 250\n",
                "batch/job/memory.max": "max",
                "batch/job/memory.current": "100",
            },
            [1750],
        ),
        (
            "5:cpu:/\n4:memory:/docker/abc\n",  # seen from within a container only the root is there
            {
                "memory/memory.limit_in_bytes": "5000",
                "memory/memory.usage_in_bytes": "4000",
                "memory/memory.stat": "inactive_file 1\ntotal_inactive_file 300\ntotal_active_file 0\n",
            },
            [1300],
        ),
        ("0::/\n", {}, []),
    ],
    ids=["version 2", "version 1", "none"],
)
def test_the_room_of_control_groups_is_read_as_the_kernel_writes_it(
    tmp_path: Path, told: str, files: dict[str, str], room: list[int]
) -> None:
    (tmp_path / "mine").write_text(told)
    for name, content in files.items():
        (tmp_path / "groups" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "groups" / name).write_text(content)
    assert list(cgroup_memory_headroom(tmp_path / "mine", tmp_path / "groups")) == room


@pytest.mark.parametrize(
    ("told", "files", "most"),
    [
        ("0::/batch/job\n", {"batch/cpu.max": "100000 100000", "batch/job/cpu.max": "max 100000"}, 1),
        ("0::/job\n", {"job/cpu.max": "50000 100000"}, 1),
        ("3:cpu,cpuacct:/job\n", {"cpu/job/cpu.cfs_quota_us": "100000", "cpu/job/cpu.cfs_period_us": "100000"}, 1),
        ("3:cpu:/job\n", {"cpu/job/cpu.cfs_quota_us": "-1", "cpu/job/cpu.cfs_period_us": "100000"}, None),
        ("0::/\n", {}, None),
    ],
    ids=["version 2, outer", "less than one", "version 1", "version 1, no limit", "none"],
)
def test_cpu_count_respects_cgroup_limits(tmp_path: Path, told: str, files: dict[str, str], most: int | None) -> None:
    (tmp_path / "mine").write_text(told)
    for name, content in files.items():
        (tmp_path / "groups" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "groups" / name).write_text(content + "\n")
    assert cpu_count(tmp_path / "mine", tmp_path / "groups") == (most or len(os.sched_getaffinity(0)))
