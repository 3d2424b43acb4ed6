"""A scanner as the service tells it, with the fields that a test wants to be otherwise."""

IDLE = {
    "connection": "connected",
    "holder": None,
    "state": "idle",
    "laser": "off",
    "shutter": "closed",
    "interlock": "closed",
    "key": "on",
    "fault": None,
    "looked_at": "2026-01-01T00:00:00Z",
    "age": 0.1,
    "look_interval": 0.2,
    "last_error": None,
    "emergency_stop": None,
    "lease": None,
}
"""What a real scanner says that does nothing."""


def scanner_of(service, **fields):
    """What ``service`` tells of its scanner, which does nothing but for what is given."""
    return service.get("/scanners/scanner-0").json() | IDLE | fields


def tell_of(page, *scanners, **how):
    """Have the service tell the page of these scanners from now on, whatever it knows."""
    page.unroute("**/api/v1/scanners")
    page.route("**/api/v1/scanners", lambda route: route.fulfill(json={"items": list(scanners)}, **how))
