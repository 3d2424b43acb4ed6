"""Requests that mean harm, a row each: who asks what, and the problem with which it is refused.

A row more is a line more; ``{mask}``, ``{scan}`` and the like stand for things that are there.
"""

from dataclasses import dataclass, field

from steradian.api.middleware.authentication import PUBLIC, SCOPES, V1
from steradian.security.keys import Scope

from .conftest import EQUI, MAX_BODY, MAX_POINTS

PAGES = (V1, "/metrics", "/problems")
FORWARDED = {"X-Forwarded-For": "192.0.2.1"}
"""Makes nobody of the owner of the machine, who needs no key."""
JSON = {"Content-Type": "application/json"}
GRID = '{"arrangement":"grid","aperture":0.011,"count":3,"interval":1e-3'
"""The beginning of a mask as JSON."""
HUGE = "1" + 400 * "0"
NOUNS = {"mask": "masks", "plan": "plans", "scan": "scans", "reconstruction": "reconstructions", "batch": "batches"}
NOUNS |= {"job": "jobs", "upload": "uploads", "scanner": "scanners"}
NOBODY = dict.fromkeys([*(f"{noun}_id" for noun in NOUNS), "name", "path", "number"], "none")
"""Identifiers of nothing, for the addresses of the table of scopes."""


@dataclass(frozen=True)
class Attack:
    """One row.

    Attributes
    ----------
    name
        What is tried.
    key
        Which of the keys is sent; None: none.
    says
        Pointer of the field that the problem names; None: any.
    """

    name: str
    method: str
    path: str
    status: int
    code: str
    headers: dict = field(default_factory=dict)
    more: dict = field(default_factory=dict)
    key: str | None = None
    says: str | None = None


def row(name, method, path, status, code, headers=None, *, key=None, says=None, **more):
    """A row; an address of neither service nor pages is one of the API."""
    path = path if path.startswith(PAGES) else f"{V1}{path}"
    return Attack(name, method, path, status, code, headers or {}, more, key, says)


def body(name, content, status=422, code="invalid-input", path="/masks", headers=JSON, method="POST"):
    return row(name, method, path, status, code, headers, content=content)


def without_a_key():
    """Every route, with each kind of key that is none."""
    for method, path in sorted(SCOPES, key=str):
        for key in (None, "wrong", "unknown", "malformed", "expired", "revoked"):
            name = f"{method} {path} with {key or 'no'} key"
            sent = FORWARDED if key is None else {}
            yield row(name, method, path.format(**NOBODY), 401, "unauthorized", sent, key=key)


def with_another_scope():
    """Every route, with each scope that does not open it."""
    for (method, path), need in sorted(SCOPES.items(), key=str):
        for scope in Scope:
            if need is not PUBLIC and scope not in {need, Scope.ADMIN}:
                name = f"{method} {path} with the scope {scope}"
                yield row(name, method, path.format(**NOBODY), 403, "forbidden", key=scope)


def with_authority_of_its_own():
    admin = "?scope=admin&principal=admin&need=read&key=x&scopes=admin"
    yield row("scopes in the query", "POST", f"/masks{admin}", 403, "forbidden", key="read")
    yield row("a key in the query", "GET", "/scans?key={key:admin}", 401, "unauthorized", FORWARDED)
    basic = {"Authorization": "Basic YWRtaW46YWRtaW4="}
    yield row("another scheme", "GET", "/scans", 401, "unauthorized", basic)
    twice = {"Authorization": "Bearer {key:read}, Bearer {key:admin}"}
    yield row("two keys in one header", "POST", "/masks", 401, "unauthorized", twice)
    yield row("a body before the key", "POST", "/masks", 401, "unauthorized", FORWARDED, content=b"{")
    yield row("a body before the scope", "POST", "/masks", 403, "forbidden", key="read", content=b"{")
    yield row("what exists is not told", "GET", "/nowhere", 401, "unauthorized", FORWARDED)
    yield row("a key in the query of a stream", "GET", "/events?ticket={key:admin}", 401, "unauthorized", FORWARDED)


def by_a_foreign_page():
    """Rebound names and requests that a page of another origin makes in the browser of the machine's owner."""
    hosts = ["evil.example", "[::1", "127.0.0.1:port", "", "localhost.evil.example", "127.0.0.1.evil.example"]
    hosts += ["evil.example@localhost", "localhost@evil.example", "0x7f.0.0.1", "2130706433", "127.1", "localhost."]
    for host in hosts:
        for method, path in (("GET", "/scans"), ("POST", "/masks")):
            yield row(f"{method} to the host {host!r}", method, path, 403, "forbidden", {"Host": host}, json=EQUI)
    origins = ["https://evil.example", "http://[", "null", "http://localhost:1", "file://"]
    foreign = [{"Origin": origin} for origin in origins]
    foreign += [{"Sec-Fetch-Site": site} for site in ("cross-site", "same-site", "nonsense")]
    for sent in foreign:
        said = "; ".join(sent.values())
        yield row(f"a mask by a page of {said}", "POST", "/masks", 403, "forbidden", sent, json=EQUI)
        stop = "/scanners/scanner-0/emergency-stop"
        yield row(f"the emergency stop by a page of {said}", "POST", stop, 403, "forbidden", sent)
        yield row(f"a deletion by a page of {said}", "DELETE", "/masks/{mask}", 403, "forbidden", sent)
    for site in ("cross-site", "same-site"):
        silent = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
        yield row(f"scans read by a {site} page", "GET", "/scans", 403, "forbidden", silent)
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        simple = {"Content-Type": kind}
        yield row(f"a form's {kind}", "POST", "/masks", 415, "unsupported-media-type", simple, content=GRID + "}")
    for header in (
        *("Forwarded", "X-Forwarded-For", "X-Forwarded-Host", "X-Forwarded-Proto", "X-Forwarded-Prefix", "Via"),
        *("X-Real-IP", "X-Client-IP", "True-Client-IP", "X-Original-For", "X-Envoy-External-Address", "CF-Ray"),
    ):
        for method, path in (("GET", "/scans"), ("POST", "/masks"), ("GET", "/metrics")):
            proxied = {header: "for=127.0.0.1"}
            yield row(f"{method} {path} through a proxy that says {header}", method, path, 401, "unauthorized", proxied)


def to_other_places():
    """Traversal, and names made of what no name is made of."""
    climbs = ["..%2F..%2Fsteradian.sqlite", "%2Fetc%2Fpasswd", "....%2F%2Fidentity"]
    strange = ["..%5C..%5Cidentity", "%00", "%ff%fe", "x%00y", "𝟏" * 64, "é" * 64, "%E2%80%AE", "a" * 64]
    strange += ["%3Cscript%3E", "%0d%0aX-Evil:1"]
    nowhere, nothing = (404, "no-such-route"), (404, "not-found")
    for name, refusal in [(name, nowhere) for name in climbs] + [(name, nothing) for name in strange]:
        for noun in NOUNS.values():
            yield row(f"{noun} {name[:40]}", "GET", f"/{noun}/{name}", *refusal)
    for name in climbs:
        yield row(f"deleting the upload {name}", "DELETE", f"/uploads/{name}", *nowhere)
        yield row(f"a file of a job called {name}", "GET", f"/jobs/{{job}}/files/{name}", *nowhere)
    for name in ("../../identity", "/etc/passwd", "u1\n", "u" * 1000):
        about = {"kind": "import", "upload_id": name}
        yield row(f"an import of the upload {name[:20]!r}", "POST", "/jobs", 422, "invalid-input", json=about)
    for name in ("../x", "a/b", "nifti; rm -rf /"):
        about = {"kind": "export", "scan_id": "{scan}", "format": name}
        yield row(f"an export to the format {name}", "POST", "/jobs", 422, "invalid-input", json=about)
    yield row("a page beside the problems", "GET", "/problems/..%2F..%2Fidentity", *nowhere)
    page = {"Accept": "text/html"}
    yield row("a problem with a script", "GET", "/problems/%3Cscript%3E", *nothing, page)


def too_large():
    points = "[" + ",".join(["[0,0]"] * (MAX_BODY // 6 + 1)) + "]"
    about = '{"arrangement":"points","aperture":0.01,"positions":%s}'
    yield body("more bytes than are taken", b"[" * (MAX_BODY + 1), 413, "too-large")
    yield body("as many without saying so", iter([b"[" * 9000] * 3), 413, "too-large")
    stop = "/scanners/scanner-0/emergency-stop"
    yield body("a reason of 5 kB for the stop", b'{"reason":"' + b"x" * 5000 + b'"}', 413, "too-large", stop)
    yield body("positions of more bytes than are taken", about % points, 413, "too-large")
    for count in (MAX_POINTS + 1, 10**9, 10**30):
        grid = '{"arrangement":"equi-steradian","aperture":0.01356,"depth":0.0036,"count":%d}'
        yield body(f"a mask of {count:.0e} points", grid % count)
    yield body("10,000 levels of JSON", "[" * 10_000, 400, "malformed-json")
    yield body("10,000 levels of objects", '{"a":' * 2500, 400, "malformed-json")
    yield body("a number of 5,000 digits", GRID.replace("3", "9" * 5000, 1) + "}", 400, "malformed-json")
    for name in ("limit=1000000000", "limit=-1", "limit=0", "limit=x", "cursor=%00", "after=x", "cursor=" + "x" * 3000):
        status, code = (404, "not-found") if "%00" in name else (422, "invalid-input")
        yield row(f"a list with {name[:30]}", "GET", f"/masks?{name}", status, code)
    for size in (10**6, 10**12):
        about = {"scan_id": "{over}", "parameters": {"modes": size}}
        yield row(f"a volume of {size:.0e} modes", "POST", "/reconstructions", 422, "invalid-input", json=about)
    sweep = {"scan_id": "{over}", "vary": {"modes": list(range(2, 4000, 2))}}
    yield row("a sweep of 1,999 volumes", "POST", "/batches", 422, "invalid-input", json=sweep)
    labels = {"labels": {"a": "x" * 10_000}}
    yield row("a label of 10 kB", "PATCH", "/scans/{scan}", 422, "invalid-input", json=labels)
    labels = {"labels": {str(number): "x" for number in range(1000)}}
    yield row("a thousand labels", "PATCH", "/scans/{scan}", 422, "invalid-input", json=labels)


def malformed():
    """Bodies that are none, and values made to hurt."""
    yield body("nothing", "")
    yield body("NaN", '{"arrangement":"grid","aperture":NaN,"count":3,"interval":1e-3}')
    yield body("Infinity", '{"arrangement":"grid","aperture":Infinity,"count":3,"interval":1e-3}')
    for name, text in {
        "half an object": "{",
        "a key twice": GRID + ',"aperture":0.012}',
        "nul": GRID + ',"a":"\\u0000"}',
        "half a pair": GRID + ',"a":"\\ud800"}',
        "a pair the wrong way round": GRID + ',"a":"\\udc00\\ud800"}',
        "a comment": GRID + " /* x */}",
        "a second document": GRID + "}{}",
        "XML": '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><x>&a;</x>',
    }.items():
        yield body(name, text, 400, "malformed-json")
    yield body("bytes that are no text", b'{"arrangement":"\xff\xfe"}', 400, "malformed-json")
    for name, text in {
        "a list": "[]",
        "null": "null",
        "a text": '"grid"',
        "an unknown arrangement": '{"arrangement":"__class__"}',
        "an unknown member": GRID + ',"__proto__":{}}',
        "position 1e400": f'{{"arrangement":"points","aperture":0.01,"positions":[[{HUGE},0]]}}',
        "aperture 1e400": f'{{"arrangement":"points","aperture":{HUGE},"positions":[[0,0]]}}',
        "positions that are no list": '{"arrangement":"points","aperture":0.01,"positions":false}',
        "the smallest spacing": '{"arrangement":"poisson-disc","aperture":0.01,"spacing":5e-324}',
        "the smallest interval": '{"arrangement":"hexagonal","aperture":0.01,"interval":5e-324}',
        "a negative count": '{"arrangement":"grid","aperture":0.011,"count":-3,"interval":1e-3}',
        "a text for a number": '{"arrangement":"grid","aperture":"0.011; DROP TABLE masks","count":3}',
    }.items():
        yield body(name, text)
    for state in ("running; abort", "", None, {"state": "running"}, "RUNNING"):
        wish = {"state": state}
        yield row(f"the state {state!r}", "PUT", "/scans/{scan}/desired-state", 422, "invalid-input", json=wish)
    for name in ("'; DROP TABLE scans; --", "%", "{scan}' OR '1'='1"):
        where = f"/scans?state={name}"
        yield row(f"scans in the state {name}", "GET", where, 422, "invalid-input")
    yield row("a parameter nobody knows", "GET", "/scans?path=/etc/passwd", 422, "invalid-input")


def booleans_for_numbers():
    """Each names a field of another kind: of a model, of a union, in a model within one, in a list, in an array."""
    mask, reconstruction = {"mask_id": "{mask}"}, {"scan_id": "{over}"}
    equi = {"arrangement": "equi-steradian", "aperture": 0.01356, "depth": 0.0036, "count": 100}
    for path, pointer, about in (
        ("/masks", "aperture", equi | {"aperture": True}),
        ("/masks", "count", equi | {"count": True}),
        ("/masks", "offset/0", equi | {"offset": [False, 0]}),
        ("/masks", "positions", {"arrangement": "points", "aperture": 0.01, "positions": [[0, 0], [True, 0]]}),
        ("/masks/preview", "depth", equi | {"depth": True}),
        ("/plans", "samples", mask | {"samples": True}),
        ("/plans/preview", "motion/settle", mask | {"motion": {"settle": False}}),
        ("/designs/preview", "pulse_rate", {"arrangement": equi, "pulse_rate": True}),
        ("/designs/budget", "duration", {"duration": True, "depth": 0.002, "vessel": 1e-4, "noise": 20}),
        ("/designs/point-spread", "point/2", {"arrangement": equi, "point": [0, 0, True]}),
        ("/reconstructions", "parameters/modes", reconstruction | {"parameters": {"modes": True}}),
        ("/reconstructions", "priority", reconstruction | {"priority": True}),
        ("/batches", "priority", reconstruction | {"vary": {"modes": [8]}, "priority": True}),
    ):
        name = f"a boolean for {pointer} of {path}"
        yield row(name, "POST", path, 422, "invalid-input", says=f"#/{pointer}", json=about)
    lease = {"holder": "ada", "seconds": True}
    where = "/scanners/scanner-0/lease"
    yield row("a boolean for a lease's seconds", "PUT", where, 422, "invalid-input", says="#/seconds", json=lease)
    change = {"priority": True}
    where = "/reconstructions/{job}"
    yield row("a boolean for a priority", "PATCH", where, 422, "invalid-input", says="#/priority", json=change)


def by_headers():
    for digits in ("1" * 5000, "\xb2", "-1"):  # of this scan: another's is not a version of it, whatever its digits
        tag = {"If-Match": f'"{{scan}}-{digits}"'}
        what = {"json": {"labels": {"a": "b"}}}
        yield row(f"the version {digits[:5]}", "PATCH", "/scans/{scan}", 412, "precondition-failed", tag, **what)
    plan = {"json": {"plan_id": "{plan}"}}
    yield row("a scan without an idempotency key", "POST", "/scans", 422, "invalid-input", **plan)
    for name, key in {"too long": "k" * 500, "of spaces": "a b c", "empty": ""}.items():
        sent = {"Idempotency-Key": key}
        yield row(f"an idempotency key that is {name}", "POST", "/scans", 422, "invalid-input", sent, **plan)
    again = {"Idempotency-Key": "used-by-another-body"}
    other = {"plan_id": "{plan}", "labels": {"other": "body"}}
    yield row("a used idempotency key with another body", "POST", "/scans", 422, "invalid-input", again, json=other)
    yield row("a type that is not there", "GET", "/masks/{mask}/points", 406, "not-acceptable", {"Accept": "x/evil"})
    for method in ("PROPFIND", "TRACE", "CONNECT", "M-SEARCH"):
        yield row(f"the method {method}", method, "/masks", 405, "method-not-allowed")


def against_order():
    """What is well formed and not this caller's to do."""
    lease, held = "/scanners/scanner-0/lease", (409, "lease-held")
    taken = {"holder": "mallory", "seconds": 60}
    yield row("a lease of another's scanner", "PUT", lease, *held, json=taken, key="operate")
    wish, paused = {"state": "running"}, "/scans/{paused}/desired-state"
    yield row("firing under another's lease", "PUT", paused, *held, json=wish, key="operate")
    plan, sent = {"plan_id": "{plan}"}, {"Idempotency-Key": "mallory"}
    yield row("a scan under another's lease", "POST", "/scans", *held, sent, json=plan, key="operate")
    yield row("deleting a mask that is in use", "DELETE", "/masks/{mask}", 409, "in-use")
    yield row("deleting a plan that is in use", "DELETE", "/plans/{plan}?dependents=true", 409, "in-use")


ATTACKS = [
    attack
    for group in (
        without_a_key,
        with_another_scope,
        with_authority_of_its_own,
        by_a_foreign_page,
        to_other_places,
        too_large,
        malformed,
        booleans_for_numbers,
        by_headers,
        against_order,
    )
    for attack in group()
]

RAW = {
    "two hosts": b"GET /api/v1/scans HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
    "no host": b"GET /api/v1/scans HTTP/1.1\r\n\r\n",
    "another host in the target": b"GET http://evil.example/api/v1/scans HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "two lengths": b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 5\r\n"
    b"Content-Length: 50\r\n\r\nhello",
    "a length and chunks": b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4\r\n"
    b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /api/v1/scans HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    "a negative length": b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -5\r\n\r\n",
    "a length in words": b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: many\r\n\r\n",
    "a chunk without end": b"POST /api/v1/masks HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n"
    b"ffffffffffffffffff\r\n",
    "a header that is folded": b"GET /api/v1/scans HTTP/1.1\r\nHost: evil.example\r\n folded: x\r\n\r\n",
    "a header with nul": b"GET /api/v1/scans HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: a\x00b\r\n\r\n",
    "a header without a name": b"GET /api/v1/scans HTTP/1.1\r\nHost: 127.0.0.1\r\n: x\r\n\r\n",
    "a space before the colon": b"GET /api/v1/scans HTTP/1.1\r\nHost : evil.example\r\n\r\n",
    "a line that ends early": b"GET /api/v1/scans HTTP/1.1\nHost: evil.example\n\n",
    "a method of its own": b"DEBUG /api/v1/scans HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "no HTTP": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(64) + b"\r\n\r\n",
    "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "a version of its own": b"GET /api/v1/scans HTTP/9.9\r\nHost: 127.0.0.1\r\n\r\n",
}
"""Requests that no client's library would send: each is refused, or the connection ends."""
