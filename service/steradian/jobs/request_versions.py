"""Versions of stored job requests, and the migrations that convert earlier versions when they are read.

A job may wait while the service is upgraded, so its request outlives the models that checked it. A change of
:mod:`steradian.jobs.requests` after which a stored request would be refused, or mean something else, adds a function
to :data:`MIGRATIONS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

from steradian.core.exceptions import Conflict

Stored: TypeAlias = dict[str, Any]
KEY: Final = "form"
"""Member of a stored request that holds its form's version; requests of form 0 have none."""


def _without_options_of_other_methods(request: Stored) -> Stored:
    """Remove the options of the iterative method from a request with another method (migration from form 0)."""
    parameters = request.get("parameters")
    if not isinstance(parameters, dict) or parameters.get("method", "nedner") == "iterative":
        return request
    return request | {"parameters": {name: value for name, value in parameters.items() if name != "iterative"}}


MIGRATIONS: Final[tuple[Callable[[Stored], Stored], ...]] = (_without_options_of_other_methods,)
"""The function at place n makes a request of form n + 1 of one of form n."""
FORM: Final = len(MIGRATIONS)
"""Today's form."""


def stored(request: Mapping[str, Any]) -> Stored:
    """Return a current job request with its version number added, for storage in the database."""
    return {KEY: FORM, **request}


def asked(request: Mapping[str, Any]) -> Stored:
    """Return a stored job request without its version number, unmigrated."""
    return {name: value for name, value in request.items() if name != KEY}


def today(request: Mapping[str, Any]) -> Stored:
    """Migrate a stored job request of any version to the current version, without validation.

    Raises
    ------
    Conflict
        When a newer version of Steradian stored it.
    """
    form = request.get(KEY, 0)
    if not (isinstance(form, int) and 0 <= form <= FORM):
        known = f"this Steradian reads forms 0 to {FORM}; a newer one asked for the job and can do it"
        raise Conflict(f"the job's request has form {form!r}; {known}")
    migrated = asked(request)
    for migrate in MIGRATIONS[form:]:
        migrated = migrate(migrated)
    return migrated
