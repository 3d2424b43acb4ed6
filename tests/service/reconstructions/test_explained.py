"""Whoever reads the API's document finds what each parameter means, and in which unit it is."""

import dataclasses

import pytest

from steradian.core.schema_descriptions import explanations
from steradian.imaging import Conditioning, Display, IterativeOptions
from steradian.reconstructions.parameters import ReconstructionParameters

SCHEMA = ReconstructionParameters.model_json_schema()


@pytest.mark.parametrize("kind", [Conditioning, Display, IterativeOptions])
def test_every_parameter_is_explained_in_the_docstring_s_words(kind):
    """No field of a plain dataclass is without a description, and none has the markup of the docstring."""
    properties = SCHEMA["$defs"][kind.__name__]["properties"]
    assert set(explanations(kind)) == {field.name for field in dataclasses.fields(kind)}
    for name, about in properties.items():
        assert about["description"] == explanations(kind)[name]
        assert len(about["description"]) > 10
        assert "`" not in about["description"]


def test_lengths_times_and_frequencies_have_units():
    """A form can tell mm, µs and MHz from a bare number."""
    units = {
        f"{part}.{name}": about["unit"]
        for part, schema in {"": SCHEMA, **SCHEMA["$defs"]}.items()
        for name, about in schema["properties"].items()
        if "unit" in about
    }
    expected = {
        "Conditioning.rim": "m",
        "Conditioning.delay": "s",
        "Conditioning.band": "Hz",
        "Display.near_field": "m",
    }
    expected |= {".depth_range": "m", ".highest_frequency": "Hz", ".sound_speed": "m/s", "Film.thickness": "m"}
    assert units.items() >= expected.items()
