"""Numbers on the page: one minus (U+2212) everywhere, in texts and in fields, and none before a zero."""

import pytest

from support.page_modules import modules_of


@pytest.fixture(scope="module")
def modules(chromium, service):
    with modules_of(chromium, service) as modules:
        yield modules


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ("m.signed(-1.25, 1)", "−1.3"),
        ("m.signed(-0.04, 1)", "0.0"),
        ("m.figure(-1234.5)", "−1,235"),
        ("m.figure(-0.00012)", "−1.20 × 10⁻⁴"),
        ("m.decimalText(-1.3550000001)", "−1.355"),
        ("m.decimalText(-0)", "0"),
        ("m.decimalText(NaN)", ""),
        ("m.count(-1234)", "−1,234"),
        ("m.percent(-0.05)", "−5\u00a0%"),
        ("m.degrees(-0.5)", "−29°"),
        ("m.mm(-0.000001)", "0.00\u00a0mm"),
        ("m.length(-0.0012)", "−1.2\u00a0mm"),
    ],
)
def test_text_of_number_has_typographic_minus(modules, call, text):
    assert modules.call("units.js", f"return {call};") == text


@pytest.mark.parametrize(
    ("typed", "number"), [("−1.5", -1.5), ("-1.5", -1.5), (" 2,5 ", 2.5), ("1e-3", 1e-3), ("", None), ("a", None)]
)
def test_field_of_number_accepts_either_minus(modules, typed, number):
    script = """const field = m.decimalInput({}); field.value = given.typed; field.dispatchEvent(new Event("input"));
        const read = m.decimalOf(field); return [Number.isFinite(read) ? read : null, field.validity.valid];"""
    assert modules.call("decimal_input.js", script, typed=typed) == [number, number is not None]


def test_field_of_number_shows_typographic_minus_unless_it_is_typed_in(modules):
    script = """const field = m.decimalInput({}); document.body.append(field); m.showDecimal(field, -1.25);
        const shown = field.value; field.focus(); m.showDecimal(field, 7); return [shown, field.value];"""
    assert modules.call("decimal_input.js", script) == ["−1.25", "−1.25"]
