"""OpenAPI Link objects from responses to follow-up operations."""

from __future__ import annotations

from typing import Any, Final

ID: Final = "$response.body#/id"
CREATING_OPERATIONS: Final[dict[str, tuple[str, ...]]] = {
    "mask_create": ("mask",),
    "plan_create": ("plan",),
    "scan_create": ("scan",),
    "reconstruction_create": ("reconstruction", "job"),
    "reconstruction_quality_create": ("job",),
    "batch_create": ("batch",),
    "job_create": ("job",),
    "upload_create": ("upload",),
    "scanner_read": ("scanner",),
}
"""Operations whose answer shows one thing, and what it is."""
FOLLOW_UP_OPERATIONS: Final[dict[str, dict[str, dict[str, str]]]] = {
    "mask": {"plan_create": {"mask_id": ID}, "plan_preview": {"mask_id": ID}},
    "plan": {"scan_create": {"plan_id": ID}},
    "scan": {"reconstruction_create": {"scan_id": ID}, "batch_create": {"scan_id": ID}},
    "upload": {"job_create": {"kind": "import", "upload_id": ID}},
}
"""Operations whose body names a thing."""


def add_links(document: dict[str, Any]) -> None:
    """Add Link objects from responses that contain a resource to all operations that take its identifier."""
    operations = {one["operationId"]: one for path in document["paths"].values() for one in path.values()}
    links: dict[str, dict[str, Any]] = {}
    having: dict[str, set[str]] = {thing: set(bodies) for thing, bodies in FOLLOW_UP_OPERATIONS.items()}
    for name, operation in operations.items():
        for parameter in operation.get("parameters", ()):
            if parameter["in"] == "path" and parameter["name"].endswith("_id"):
                links[name] = {"operationId": name, "parameters": {parameter["name"]: ID}}
                having.setdefault(parameter["name"].removesuffix("_id"), set()).add(name)
    for bodies in FOLLOW_UP_OPERATIONS.values():
        links |= {name: {"operationId": name, "requestBody": body} for name, body in bodies.items()}
    for name, link in links.items():
        link["description"] = operations[name]["summary"]
    document["components"]["links"] = links
    for name, things in CREATING_OPERATIONS.items():
        found = sorted(target for thing in things for target in having[thing] if target != name)
        for status, answer in operations[name]["responses"].items():
            if status[0] == "2":
                answer["links"] = {target: {"$ref": f"#/components/links/{target}"} for target in found}
