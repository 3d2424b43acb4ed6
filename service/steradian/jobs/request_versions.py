"""Version of stored job requests.

A job may wait while the service is upgraded, so its request outlives the models that checked it. A change of
:mod:`steradian.jobs.requests` after which a stored request would be refused, or mean something else, increases
:data:`FORM`, and :func:`current` converts requests of earlier versions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, TypeAlias

from steradian.core.exceptions import Conflict

Stored: TypeAlias = dict[str, Any]
KEY: Final = "form"
"""Member of a stored request with the version of its form."""
FORM: Final = 1
"""Version of the requests that this program stores."""


def stored(request: Mapping[str, Any]) -> Stored:
    """Return a current job request with its version number added, for storage in the database."""
    return {KEY: FORM, **request}


def asked(request: Mapping[str, Any]) -> Stored:
    """Return a stored job request without its version number."""
    return {name: value for name, value in request.items() if name != KEY}


def current(request: Mapping[str, Any]) -> Stored:
    """Return a stored job request of a known version without its version number, without validation.

    Raises
    ------
    Conflict
        When another version of Steradian stored it.
    """
    form = request.get(KEY, FORM)
    if type(form) is not int or form != FORM:
        reader = "run the job with the Steradian that stored it"
        raise Conflict(f"{KEY} of the job's request is {form!r}; allowed: {FORM}; {reader}")
    return asked(request)
