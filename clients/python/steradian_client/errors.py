"""Exception classes of the client.

ClientError
├── ConnectionFailed  no service answers at that address, or the connection broke off
├── CorruptTransfer   what came is not what was sent: another length or checksum
├── ServiceError      the service answered with a problem (RFC 9457): status, code, detail, request id
│   ├── Unauthorized      401: a key is needed, or the one sent is unknown
│   ├── Forbidden         403: the key does not allow this
│   ├── NotFound          404
│   ├── Conflict          409: it does not fit the present state
│   │   ├── NotReady          it will exist once a job or scan is over
│   │   └── HasDependents     what was to be deleted is needed: ``dependents``
│   ├── PreconditionFailed 412: it has changed since it was read
│   ├── InvalidInput      422: a value is outside its allowed range: ``errors``
│   ├── RateLimited       429
│   └── DiskFull          507
└── JobFailed         the scan, reconstruction, job or batch waited for ended otherwise than hoped
"""

from __future__ import annotations

from typing import Any


class ClientError(Exception):
    """Base class of this package's errors."""


class ConnectionFailed(ClientError):
    """The service does not answer at the given URL."""


class CorruptTransfer(ClientError):
    """The received content differs from the sent content."""


class ServiceError(ClientError):
    """Error response of the service, with the attributes of its problem document (RFC 9457).

    Attributes
    ----------
    status
        HTTP status.
    code
        Stable short name of the problem, such as ``not-found``.
    detail
        What is wrong, in a sentence.
    errors
        The fields that are wrong, each with ``pointer``, ``detail`` and, where known, its allowed range.
    dependents
        What needs the thing that was to be deleted.
    request_id
        Finds the request in the service's log.
    problem
        The whole document.
    """

    def __init__(self, status: int, problem: dict[str, Any]) -> None:
        self.status, self.problem = status, problem
        self.code = str(problem.get("code", "unknown"))
        self.detail = str(problem.get("detail") or problem.get("title") or "no detail")
        self.errors: list[dict[str, Any]] = list(problem.get("errors") or [])
        self.dependents: list[str] = list(problem.get("dependents") or [])
        self.request_id = str(problem.get("request_id", ""))
        super().__init__(f"{self.detail} ({status} {self.code})")

    @staticmethod
    def of(status: int, problem: dict[str, Any]) -> ServiceError:
        """Create the exception for a problem document, chosen by its code, otherwise by its status."""
        kind = _BY_CODE.get(str(problem.get("code"))) or _BY_STATUS.get(status, ServiceError)
        return kind(status, problem)


class Unauthorized(ServiceError):
    """The API key is missing, unknown, revoked or expired."""


class Forbidden(ServiceError):
    """The API key does not permit this request."""


class NotFound(ServiceError):
    """A resource with this identifier does not exist."""


class Conflict(ServiceError):
    """The request conflicts with the present state of the resource."""


class NotReady(Conflict):
    """The requested result does not exist until its job or scan has ended."""


class HasDependents(Conflict):
    """The resource cannot be deleted, because the resources in ``dependents`` need it."""


class PreconditionFailed(ServiceError):
    """The resource has changed since it was read."""


class InvalidInput(ServiceError):
    """A value is outside its allowed range."""


class RateLimited(ServiceError):
    """The API key exceeds its request rate."""


class DiskFull(ServiceError):
    """The service's disk has too little free space for the request."""


_BY_CODE: dict[str, type[ServiceError]] = {"not-ready": NotReady, "has-dependents": HasDependents}
_BY_STATUS: dict[int, type[ServiceError]] = {
    401: Unauthorized,
    403: Forbidden,
    404: NotFound,
    409: Conflict,
    412: PreconditionFailed,
    422: InvalidInput,
    429: RateLimited,
    507: DiskFull,
}


class JobFailed(ClientError):
    """A scan, reconstruction, job or batch failed or was cancelled.

    Attributes
    ----------
    identifier, state
        What did not end well, and how it ended.
    error
        Why, if it is known.
    """

    def __init__(self, identifier: str, state: str, error: str | None) -> None:
        self.identifier, self.state, self.error = identifier, state, error
        super().__init__(f"{identifier} is {state}" + (f": {error}" if error else ""))
