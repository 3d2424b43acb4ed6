"""Depths that are asked for: as many slices as they take count, also below the samples' own number of slices."""

import pytest

from steradian.api.use_cases.image_size import count_slices
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.parameters import ReconstructionParameters


def test_layer_without_speed_is_refused_by_its_field_where_the_plan_states_none():
    layers = ReconstructionParameters.create(medium=[{"sound_speed": 1480, "thickness": 1e-3}, {}])
    plan = {"samples": 100, "sampling_interval": 1e-8}
    with pytest.raises(InvalidInput, match=r"^parameters.medium.1.sound_speed is missing; .*the recording states none"):
        count_slices(plan, layers)
    assert count_slices(plan | {"sound_speed": 2960}, layers) == 133  # 67.6 above the boundary, 64.9 below


def test_reconstruction_of_more_depth_than_a_volume_may_have_is_refused_by_its_range(http, scan_with_alines):
    about = {"scan_id": scan_with_alines["scan"]["id"], "parameters": {"modes": 32, "depth_range": [0.0, 0.9]}}
    answer = http.post("/reconstructions", json=about)
    assert answer.status_code == 422, answer.text
    assert "depth_range" in answer.text, answer.text
    assert "a volume of at most 16777216 bytes" in answer.text, answer.text
    about["parameters"] = {"modes": 32, "depth_range": [0.0, 20e-3]}  # a record that begins late may reach there
    assert http.post("/reconstructions", json=about).status_code == 202
    fast_below = [{"sound_speed": 300, "thickness": 1e-5}, {"sound_speed": 12000}]  # slices as far apart as of 300 m/s
    about["parameters"] = {"modes": 32, "medium": fast_below}
    answer = http.post("/reconstructions", json=about)
    assert answer.status_code == 422, answer.text
    assert "a volume of at most 16777216 bytes" in answer.text, answer.text
    about["parameters"] = {"modes": 32, "conditioning": {"delay": 0.5}}
    answer = http.post("/reconstructions", json=about)
    assert answer.status_code == 422, answer.text
    assert "at most 0.0005 (s)" in answer.text
