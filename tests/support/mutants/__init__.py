"""Mutants: one deliberate fault in one function, applied to a running program, and the tests that must fail with it."""

from __future__ import annotations

import inspect
import pkgutil
import types
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

VARIABLE = "STERADIAN_TEST_MUTANT"
"""Environment variable that names the mutant of a child process."""
GROUPS = ("plans", "imaging", "jobs", "api")
SERVICE = Path(__file__).parents[2] / "service"


class Mutant(NamedTuple):
    """A replacement in the source of one function, and the tests below ``tests/service`` that find it."""

    unit: str
    before: str
    after: str
    killers: tuple[str, ...]


def of_group(group):
    """Return the mutants of a group by name."""
    return import_module(f"{__name__}.{group}").MUTANTS


def find(name):
    """Return the mutant named ``GROUP:NAME``."""
    group, _, own = name.partition(":")
    return of_group(group)[own]


def apply(mutant):
    """Exchange the code object of the function, so that modules which have imported it run the mutant, too."""
    function = _function(mutant.unit)
    function.__code__ = changed(mutant)


def changed(mutant):
    """Return the code object of the function with the fault."""
    function = _function(mutant.unit)
    file = inspect.getsourcefile(function)
    text = Path(file).read_text("utf-8")
    lines, first = inspect.getsourcelines(function)
    whole = "".join(lines)
    count = whole.count(mutant.before)
    assert count == 1, f"{mutant.unit} has {count} times: {mutant.before}"
    start = sum(map(len, text.splitlines(keepends=True)[: first - 1]))
    source = text[:start] + whole.replace(mutant.before, mutant.after) + text[start + len(whole) :]
    return _code(compile(source, file, "exec", dont_inherit=True), function.__qualname__)


def _function(unit):
    found = pkgutil.resolve_name(f"steradian.{unit}")
    found = getattr(found, "fget", None) or (found.func if isinstance(found, cached_property) else found)
    found = getattr(found, "__func__", found)
    return inspect.unwrap(found)


def _code(parent, name):
    for each in parent.co_consts:
        if isinstance(each, types.CodeType):
            if each.co_qualname == name:
                return each
            if found := _code(each, name):
                return found
    return None
