"""What can go wrong between a client and a service, as a tree.

ClientError
├── Unreachable       no service answers at that address
├── ServiceError      the service answered with a problem (RFC 9457): status, code, detail, request id
└── JobFailed         the scan or reconstruction waited for ended otherwise than hoped
"""

from __future__ import annotations

from typing import Any


class ClientError(Exception):
    """Root of this package's errors."""


class Unreachable(ClientError):
    """No service answers at that address."""


class ServiceError(ClientError):
    """The service refused or failed; the attributes are those of its problem document.

    Attributes
    ----------
    status
        HTTP status.
    code
        Stable short name of the problem, such as ``not-found``.
    detail
        What is wrong, in a sentence.
    request_id
        Finds the request in the service's log.
    problem
        The whole document.
    """

    def __init__(self, status: int, problem: dict[str, Any]) -> None:
        self.status, self.problem = status, problem
        self.code = str(problem.get("code", "unknown"))
        self.detail = str(problem.get("detail") or problem.get("title") or "no detail")
        self.request_id = str(problem.get("request_id", ""))
        super().__init__(f"{self.detail} ({status} {self.code})")


class JobFailed(ClientError):
    """A scan or reconstruction did not end well."""

    def __init__(self, identifier: str, state: str, error: str | None) -> None:
        self.identifier, self.state, self.error = identifier, state, error
        super().__init__(f"{identifier} is {state}" + (f": {error}" if error else ""))
