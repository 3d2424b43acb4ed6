"""Kinds of problems: one table that the answers, their addresses below ``/problems/`` and the documentation share.

``python -m steradian.api.problem_kinds > docs/problems.md`` writes the list for people.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

ROOT: Final = "/problems"


@dataclass(frozen=True)
class ProblemKind:
    """What a kind of problem is called, means and asks for.

    Attributes
    ----------
    status
        HTTP status.
    title
        The same for every occurrence.
    meaning, remedy
        What has happened, and what to do about it.
    retryable
        Whether the same request may succeed later without anybody doing anything.
    """

    status: int
    title: str
    meaning: str
    remedy: str
    retryable: bool = False


PROBLEMS: Final[Mapping[str, ProblemKind]] = MappingProxyType(
    {
        "bad-request": ProblemKind(
            400,
            "The request is malformed",
            "A header or the form of the request is none that HTTP knows, such as a Range without an end or a unit.",
            "Read detail, and send the request in the form that the API's document gives.",
        ),
        "malformed-json": ProblemKind(
            400,
            "The body is no JSON",
            "The body ends too early, holds NaN or a name twice, or is no JSON at all; detail says where.",
            "Have a library write the JSON.",
        ),
        "unauthorized": ProblemKind(
            401,
            "A valid key is needed",
            "No key was sent, or one that is unknown, revoked or expired, or a ticket that was used already,"
            " or the session is over.",
            "Send Authorization: Bearer KEY; steradian key create makes one. A ticket is had anew by POST /tickets,"
            " a session by POST /session.",
        ),
        "forbidden": ProblemKind(
            403,
            "The caller may not do this",
            "The key lacks the scope, or one without a key was addressed to another host or made by another's page.",
            "Use a key with the scope that detail names; steradian key create --scope gives one.",
        ),
        "cross-site": ProblemKind(
            403,
            "No page of this service made the request",
            "It brings a session's cookie, which a browser adds to what any page has it ask, but not what a page of"
            " this service would: its origin, and the token in X-CSRF-Token where it changes something.",
            "GET /session tells the token; a program sends a key instead of the cookie.",
        ),
        "not-found": ProblemKind(
            404,
            "There is no such thing",
            "Nothing of that kind has that identifier: it never had, or was deleted.",
            "List the kind, and take an identifier from there.",
        ),
        "no-such-route": ProblemKind(
            404,
            "There is no such address",
            "No operation of the API has this address.",
            "Compare it with /docs; the API begins at /api/v1/.",
        ),
        "method-not-allowed": ProblemKind(
            405,
            "The address knows no such method",
            "The address exists, but not with this method.",
            "Use one of the methods in the Allow header.",
        ),
        "not-acceptable": ProblemKind(
            406,
            "It cannot be had in this format",
            "The Accept header allows none of the formats that there are.",
            "Accept one of those that detail lists.",
        ),
        "conflict": ProblemKind(
            409,
            "The state of things is against it",
            "The request is right, but what it is about is in a state that does not allow it; detail says which.",
            "Read it again, and decide anew.",
        ),
        "not-ready": ProblemKind(
            409,
            "It does not exist yet",
            "What was asked for will exist when a job or scan is over that still waits or runs.",
            "Ask again after Retry-After, or send Prefer: wait=50, or follow /events.",
            retryable=True,
        ),
        "lease-held": ProblemKind(
            409,
            "Another operator holds the scanner",
            "Somebody has the scanner's lease, so nobody else may have the laser fire.",
            "Wait until it is returned or has run out (GET /scanners), or send your own lease's number: Scanner-Lease.",
        ),
        "emergency-stopped": ProblemKind(
            409,
            "The emergency stop is pressed",
            "Somebody pressed the emergency stop; nothing fires until a person has released it.",
            "See that all is safe; then DELETE /scanners/{id}/emergency-stop.",
        ),
        "fault-stands": ProblemKind(
            409,
            "The fault cannot be cleared yet",
            "The scanner has latched a fault whose cause is still there: the interlock is open, the key is off, or"
            " the shutter is open. detail says which.",
            "Remove the cause, then POST /scanners/{id}/clear-fault again.",
        ),
        "resume-refused": ProblemKind(
            409,
            "The scan cannot go on here",
            "Plan, scanner or tuning are not what they were when the scan was interrupted.",
            "Put back what detail names, or stop the scan, which keeps what was measured, and begin another.",
        ),
        "has-dependents": ProblemKind(
            409,
            "Other things need it",
            "What was to be deleted is needed by the dependents.",
            "Delete those first, or all together with ?dependents=true.",
        ),
        "in-use": ProblemKind(
            409,
            "It is in use",
            "Something that waits or runs needs what was to be deleted; or a scanner's node lives.",
            "Cancel that, or wait until it is over; stop the node first.",
        ),
        "still-running": ProblemKind(
            409,
            "A process is still at it",
            "An earlier start of the job has not ended yet.",
            "Wait until it has; GET /jobs/{id}/attempts shows it.",
        ),
        "superseded": ProblemKind(
            409,
            "A newer start has begun",
            "What an earlier start of a job has to say counts no more.",
            "Nothing: the newer start goes on.",
        ),
        "data-directory-in-use": ProblemKind(
            409,
            "Another service owns the data folder",
            "Two services must not write into one data folder.",
            "End the other one, or use another folder.",
        ),
        "cancelled": ProblemKind(
            409,
            "It was cancelled",
            "Somebody asked for the work to end before it was done.",
            "Ask for it anew if it is still wanted.",
        ),
        "precondition-failed": ProblemKind(
            412,
            "It has changed since it was read",
            "The version that If-Match names is not the present one: somebody else has changed it.",
            "Read it again, and decide on what it is now.",
        ),
        "too-large": ProblemKind(
            413,
            "The body is too large",
            "The body is larger than this service takes; GET /api/v1/ tells its limits.",
            "Send less, or upload large files by POST /uploads.",
        ),
        "unsupported-media-type": ProblemKind(
            415,
            "The body is not of the right type",
            "The Content-Type is none that the operation reads.",
            "Send Content-Type: application/json (curl --json).",
        ),
        "range-not-satisfiable": ProblemKind(
            416,
            "It ends before the range",
            "The range begins behind the last byte; Content-Range tells the size.",
            "Ask for bytes that there are.",
        ),
        "invalid-input": ProblemKind(
            422,
            "Something in the request is not allowed",
            "One or more fields, parameters or headers are wrong; errors names each with what is allowed.",
            "Correct those that errors names.",
        ),
        "damaged-file": ProblemKind(
            422,
            "A file cannot be read",
            "A file is cut off, damaged, not of the expected kind, or of a newer version of this software.",
            "Send it again, or bring it into one of the formats that the documentation lists.",
        ),
        "too-many-requests": ProblemKind(
            429,
            "Too many requests",
            "The key is used more often than it may be, or too many wrong keys came from one address.",
            "Go on after Retry-After seconds.",
            retryable=True,
        ),
        "internal": ProblemKind(
            500,
            "The service failed",
            "Something went wrong that should not; the log has more under request_id.",
            "Try again once; then tell whoever runs the service the request_id.",
            retryable=True,
        ),
        "scan-failed": ProblemKind(
            502,
            "The scanner gave up",
            "The scanner or its link failed; every acknowledged A-line is kept.",
            "Look at the scanner's last_error and its cables; then queue the rest.",
        ),
        "scan-interrupted": ProblemKind(
            502,
            "The scan was interrupted",
            "The laser went off and stayed off, or the scanner was without power.",
            "See that all is safe; then resume the scan by its desired-state.",
        ),
        "fault-latched": ProblemKind(
            502,
            "The scanner has latched a fault",
            "The interlock opened, the key was turned off, or the hardware failed; the laser is off and every"
            " acknowledged A-line is kept. The scanner fires again only after a person has cleared the fault.",
            "Remove the cause that the scanner's fault names, POST /scanners/{id}/clear-fault, then resume the scan.",
        ),
        "scanner-unreachable": ProblemKind(
            503,
            "The scanner does not answer",
            "The scanner's port cannot be opened, or nothing answers at it; detail says why.",
            "Look at its power, its cable and the service's setting of the port, then try again.",
            retryable=True,
        ),
        "queue-unavailable": ProblemKind(
            503,
            "The queue is not open",
            "The job queue cannot be reached now; the service goes on trying.",
            "Try again after Retry-After; /readyz tells when it is open.",
            retryable=True,
        ),
        "store-unavailable": ProblemKind(
            503,
            "The store does not answer",
            "The object store or the data folder cannot be reached now, or does not have this scan or result yet.",
            "Try again after Retry-After; /readyz tells when it is back.",
            retryable=True,
        ),
        "node-unavailable": ProblemKind(
            503,
            "The scanner's node does not answer",
            "What is asked for is with the node of a scanner, which cannot be reached now.",
            "Try again after Retry-After. The emergency stop goes on trying. Retire a scanner that is no more.",
            retryable=True,
        ),
        "database-unavailable": ProblemKind(
            503,
            "The database does not answer",
            "The metadata database cannot be reached now.",
            "Try again after Retry-After; /readyz tells when it is back.",
            retryable=True,
        ),
        "too-expensive": ProblemKind(
            503,
            "It took too much time or memory",
            "What was to be worked out beside the request took longer or more memory than it may.",
            "Ask for less: fewer points, or an order of visit that is not searched for.",
        ),
        "refused": ProblemKind(
            503,
            "Too many clients listen",
            "As many event streams are open as the service serves.",
            "Close one, or try again after Retry-After.",
            retryable=True,
        ),
        "disk-full": ProblemKind(
            507,
            "The disk has no room for it",
            "It does not fit beside what waits and runs; the problem tells what is needed, there and promised.",
            "Delete what is not needed any more, cancel what waits, or ask for a smaller volume.",
        ),
    }
)
"""Each kind by its code."""


def address_of(code: str) -> str:
    """Return the address that explains a kind: the ``type`` of its problems."""
    return f"{ROOT}/{code}"


def main() -> None:
    """Write the table for people to standard output, as it is committed in ``docs/problems.md``."""
    sys.stdout.write(
        "# Problems\n\nEvery answer of 400 and above is a problem document (RFC 9457). Its `type` is an address of the"
        " service itself that explains it,\n`code` its short name, `instance` the address that was asked, and"
        " `request_id` finds it in the service's log. This list is written by\n"
        "`python -m steradian.api.problem_kinds`; a * marks what may succeed when it is tried again later.\n\n"
        "| status | code | title | what it means | what to do |\n|---|---|---|---|---|\n"
    )
    for code, kind in PROBLEMS.items():
        mark = "*" if kind.retryable else ""
        sys.stdout.write(f"| {kind.status}{mark} | `{code}` | {kind.title} | {kind.meaning} | {kind.remedy} |\n")


if __name__ == "__main__":
    main()
