"""Catalogue of problem types: status, title, meaning, remedy and retryability.

``python -m steradian.api.errors.catalog > docs/problems.md`` writes the list for people.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

ROOT: Final = "/problems"


@dataclass(frozen=True)
class ProblemType:
    """Problem type (RFC 9457): status, title, meaning and remedy.

    Attributes
    ----------
    status
        HTTP status.
    title
        Short title, the same for every occurrence.
    meaning, remedy
        What has happened, and what to do about it.
    retryable
        Whether the same request may succeed later without any intervention.
    """

    status: int
    title: str
    meaning: str
    remedy: str
    retryable: bool = False


PROBLEM_TYPES: Final[Mapping[str, ProblemType]] = MappingProxyType(
    {
        "bad-request": ProblemType(
            400,
            "Malformed request",
            "A header or the request line does not have a valid form, such as a Range header without an end or a unit.",
            "Read detail, and send the request in the form that the OpenAPI document gives.",
        ),
        "malformed-json": ProblemType(
            400,
            "Malformed JSON body",
            "The body is not valid JSON: it is truncated, contains NaN, or repeats a name in an object; detail"
            " gives the position.",
            "Serialize the body with a JSON library.",
        ),
        "unauthorized": ProblemType(
            401,
            "Authentication required",
            "The request has no API key, or the key is unknown, revoked or expired, or the session has ended.",
            "Send Authorization: Bearer KEY; create a key with steradian key create. Request a new session with"
            " POST /session.",
        ),
        "forbidden": ProblemType(
            403,
            "Permission denied",
            "The API key lacks the required scope, or a request without a key was sent to another host name or by"
            " a page of another site.",
            "Use a key with the scope that detail names; steradian key create --scope creates one.",
        ),
        "cross-site": ProblemType(
            403,
            "Cross-site request rejected",
            "The request has a session cookie, but not the proof that a page of this service sends with it: its"
            " own Origin header, and the X-CSRF-Token header where the request changes something.",
            "Read the token with GET /session. Programs should send an API key instead of the cookie.",
        ),
        "not-found": ProblemType(
            404,
            "Resource not found",
            "No resource of this kind has this identifier: it never existed or was deleted.",
            "List the collection to get valid identifiers.",
        ),
        "no-such-route": ProblemType(
            404,
            "No such endpoint",
            "No operation of the API has this path.",
            "Compare the path with /docs; all paths of the API begin with /api/v1/.",
        ),
        "method-not-allowed": ProblemType(
            405,
            "Method not allowed",
            "The endpoint exists but does not support this method.",
            "Use one of the methods in the Allow header.",
        ),
        "not-acceptable": ProblemType(
            406,
            "No acceptable representation",
            "The Accept header excludes every available format.",
            "Accept one of the formats that detail lists.",
        ),
        "conflict": ProblemType(
            409,
            "Conflict with the current state",
            "The request is valid, but the current state of the resource does not allow it; detail names the state.",
            "Read the resource again, then decide whether to send another request.",
        ),
        "not-ready": ProblemType(
            409,
            "Result not ready",
            "The requested result is produced by a job or scan that is still queued or running.",
            "Retry after Retry-After seconds, or send Prefer: wait=50, or subscribe to /events.",
            retryable=True,
        ),
        "lease-held": ProblemType(
            409,
            "Scanner leased by another client",
            "Another client holds the scanner's lease, so only that client may start the laser.",
            "Wait until the lease is released or expires (GET /scanners), or send your own lease's number in the"
            " Scanner-Lease header.",
        ),
        "emergency-stopped": ProblemType(
            409,
            "Emergency stop active",
            "The emergency stop was pressed; the laser stays off until a person releases the stop.",
            "Check that the setup is safe; then send DELETE /scanners/{id}/emergency-stop.",
        ),
        "fault-stands": ProblemType(
            409,
            "Fault cannot be cleared yet",
            "The cause of the scanner's latched fault is still present: the interlock is open, the key switch is"
            " off, or the shutter is open. detail names it.",
            "Remove the cause, then send POST /scanners/{id}/clear-fault again.",
        ),
        "resume-refused": ProblemType(
            409,
            "Scan cannot be resumed",
            "The plan, scanner or tuning differs from the one in use when the scan was interrupted.",
            "Restore what detail names; or stop the scan, which keeps the measured A-lines, and start another scan.",
        ),
        "has-dependents": ProblemType(
            409,
            "Resource has dependents",
            "Other resources depend on the resource that was to be deleted.",
            "Delete the dependents first, or delete all together with ?dependents=true.",
        ),
        "in-use": ProblemType(
            409,
            "Resource in use",
            "A queued or running job or scan needs the resource that was to be deleted, or the scanner's node is"
            " still running.",
            "Cancel that job or scan, or wait until it has ended; stop the node first.",
        ),
        "still-running": ProblemType(
            409,
            "Previous attempt still running",
            "An earlier attempt of the job has not ended yet.",
            "Wait until the attempt has ended; GET /jobs/{id}/attempts lists the attempts.",
        ),
        "superseded": ProblemType(
            409,
            "Superseded by a newer attempt",
            "A newer attempt of the job is running, so reports of this attempt are ignored.",
            "No action is needed: the newer attempt continues.",
        ),
        "data-directory-in-use": ProblemType(
            409,
            "Data folder in use by another service",
            "Only one service at a time may write to a data folder.",
            "Stop the other service, or use another folder.",
        ),
        "cancelled": ProblemType(
            409,
            "Cancelled",
            "The job or scan was cancelled before it was complete.",
            "Submit the request again if the result is still needed.",
        ),
        "precondition-failed": ProblemType(
            412,
            "Precondition failed: resource was modified",
            "The resource was modified after it was read: its version is not the one in If-Match.",
            "Read the resource again and repeat the change.",
        ),
        "too-large": ProblemType(
            413,
            "Request body too large",
            "The body exceeds the limit of this service; GET /api/v1/ returns the limits.",
            "Send a smaller body, or upload large files with POST /uploads.",
        ),
        "unsupported-media-type": ProblemType(
            415,
            "Unsupported media type",
            "The endpoint does not accept this Content-Type.",
            "Send Content-Type: application/json (curl --json).",
        ),
        "range-not-satisfiable": ProblemType(
            416,
            "Range not satisfiable",
            "The requested range begins after the last byte; Content-Range gives the size.",
            "Request a range within the size.",
        ),
        "invalid-input": ProblemType(
            422,
            "Invalid input",
            "One or more fields, parameters or headers are invalid; errors lists each with its allowed values.",
            "Correct the fields that errors lists.",
        ),
        "damaged-file": ProblemType(
            422,
            "File cannot be read",
            "The file is truncated, damaged, of an unexpected type, or was written by a newer version of this"
            " software.",
            "Upload the file again, or convert it to one of the formats in the documentation.",
        ),
        "too-many-requests": ProblemType(
            429,
            "Too many requests",
            "The API key exceeded its rate limit, or too many invalid keys came from one address.",
            "Retry after Retry-After seconds.",
            retryable=True,
        ),
        "internal": ProblemType(
            500,
            "Internal server error",
            "An unexpected error occurred; the log has the details under request_id.",
            "Retry once; then report request_id to the operator of the service.",
            retryable=True,
        ),
        "scan-failed": ProblemType(
            502,
            "Scan failed",
            "The scanner or its link failed; all acknowledged A-lines are stored.",
            "Check the scanner's last_error and its cables; then resume the scan.",
        ),
        "scan-interrupted": ProblemType(
            502,
            "Scan interrupted",
            "The laser was switched off and stayed off, or the scanner lost power.",
            "Check that the setup is safe; then resume the scan through its desired-state.",
        ),
        "fault-latched": ProblemType(
            502,
            "Scanner fault latched",
            "The interlock opened, the key switch was turned off, or the hardware failed; the laser is off and"
            " all acknowledged A-lines are stored. The laser stays off until a person clears the fault.",
            "Remove the cause that the scanner's fault names, send POST /scanners/{id}/clear-fault, then resume"
            " the scan.",
        ),
        "scanner-unreachable": ProblemType(
            503,
            "Scanner unreachable",
            "The scanner's port cannot be opened, or the scanner does not answer; detail gives the reason.",
            "Check the scanner's power, its cable and the configured port, then retry.",
            retryable=True,
        ),
        "queue-unavailable": ProblemType(
            503,
            "Job queue unavailable",
            "The job queue cannot be reached; the service keeps retrying.",
            "Retry after Retry-After seconds; /readyz reports when the queue is available.",
            retryable=True,
        ),
        "store-unavailable": ProblemType(
            503,
            "Array store unavailable",
            "The object store or the data folder cannot be reached, or does not contain this scan or result yet.",
            "Retry after Retry-After seconds; /readyz reports when the store is available.",
            retryable=True,
        ),
        "node-unavailable": ProblemType(
            503,
            "Scanner node unavailable",
            "The node that serves this scanner cannot be reached.",
            "Retry after Retry-After seconds. An emergency stop is retried by the service until delivered."
            " Decommission scanners that no longer exist.",
            retryable=True,
        ),
        "database-unavailable": ProblemType(
            503,
            "Database unavailable",
            "The metadata database cannot be reached.",
            "Retry after Retry-After seconds; /readyz reports when the database is available.",
            retryable=True,
        ),
        "shutting-down": ProblemType(
            503,
            "Service shutting down",
            "The service ended before the request was complete; a change may have been applied or not.",
            "Retry after Retry-After seconds, with the same Idempotency-Key.",
            retryable=True,
        ),
        "too-expensive": ProblemType(
            503,
            "Computation limit exceeded",
            "The computation for this request exceeded its limit of time or memory.",
            "Request less: fewer points, or a visit order without optimization.",
        ),
        "refused": ProblemType(
            503,
            "Too many event streams",
            "The maximum number of event streams is open.",
            "Close a stream, or retry after Retry-After seconds.",
            retryable=True,
        ),
        "disk-full": ProblemType(
            507,
            "Insufficient storage",
            "The result does not fit on the disk without its reserve; the problem gives the bytes needed and"
            " available.",
            "Delete resources that are no longer needed, or request a smaller volume.",
        ),
    }
)
"""Each kind by its code."""


def problem_type_uri(code: str) -> str:
    """Return the URI of a problem type: the ``type`` of its problem documents."""
    return f"{ROOT}/{code}"


def main() -> None:
    """Write the table of problem types as Markdown to standard output, for ``docs/problems.md``."""
    sys.stdout.write(
        "# Problems\n\nEvery response with a status of 400 or above is a problem document (RFC 9457). Its `type`"
        " is a URL of"
        " the service\nthat explains the problem, `code` is a short name for programs, `instance` is the"
        " requested path,"
        " and\n`request_id` identifies the entry in the service's log. This list is generated by\n"
        "`python -m steradian.api.errors.catalog`; a * marks problems after which the same request may succeed"
        " later.\n\n"
        "| status | code | title | meaning | remedy |\n|---|---|---|---|---|\n"
    )
    for code, kind in PROBLEM_TYPES.items():
        mark = "*" if kind.retryable else ""
        sys.stdout.write(f"| {kind.status}{mark} | `{code}` | {kind.title} | {kind.meaning} | {kind.remedy} |\n")


if __name__ == "__main__":
    main()
