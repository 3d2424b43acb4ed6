"""Directed tests on the driver as it is, and on deliberately broken ones, each of which must be found."""

from __future__ import annotations

import pytest
from driver_mutants import MUTANTS
from driver_scenarios import SCENARIOS


@pytest.mark.parametrize("name", SCENARIOS)
def test_directed(name):
    SCENARIOS[name]()


@pytest.mark.mutants
@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_is_killed_by_the_test_made_for_it_and_the_others_pass(name, monkeypatch):
    """A failed assertion is a find; a mutant that stumbles over its own code fails this test."""
    mutant = MUTANTS[name]
    mutant.apply(monkeypatch)
    killed = set()
    for scenario, run in SCENARIOS.items():
        try:
            run()
        except AssertionError:
            killed.add(scenario)
    assert mutant.killer.__name__ in killed, f"{name}: the test made for it does not notice"
    assert killed == {test.__name__ for test in (mutant.killer, *mutant.also)}
