"""``/docs``: Swagger UI served from local files."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter
from fastapi.responses import FileResponse, HTMLResponse, Response

from steradian.api.http.conditional import ReadPreconditionsDep, etag_of_file
from steradian.api.http.security_headers import POLICY
from steradian.core.exceptions import NotFound

router = APIRouter(include_in_schema=False)
PAGE_POLICY: Final = f"{POLICY}; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'"
"""What the page may do: run its two scripts, ask this service, and show what it has or draws itself."""
_START: Final = """window.addEventListener("load", () => SwaggerUIBundle({
  url: "openapi.json", dom_id: "#docs", deepLinking: true, docExpansion: "none", filter: true,
  displayRequestDuration: true, tryItOutEnabled: true, validatorUrl: null, defaultModelsExpandDepth: 0,
}));
"""
"""Begins the page; a key that is entered there is kept as long as the page is open, nowhere else."""
_PAGE: Final = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Steradian API</title>
<link rel="icon" href="docs/favicon.png"><link rel="stylesheet" href="docs/swagger-ui.css">
<script src="docs/swagger-ui-bundle.js"></script><script src="docs/start.js"></script></head>
<body><div id="docs"></div><noscript>For machines: <a href="openapi.json">openapi.json</a></noscript></body></html>
"""
_FILES: Final = {"swagger-ui-bundle.js": "text/javascript", "swagger-ui.css": "text/css", "favicon.png": "image/png"}


@router.get("/docs")
def show_documents() -> HTMLResponse:
    """Return the interactive documentation page of the API."""
    return HTMLResponse(_PAGE, headers={"Content-Security-Policy": PAGE_POLICY})


@router.get("/docs/start.js")
def read_start_script() -> Response:
    """Return the script that starts Swagger UI; a separate file, because the page policy forbids inline scripts."""
    return Response(_START, media_type="text/javascript")


@router.get("/docs/{name}")
def read_page_file(name: str, conditions: ReadPreconditionsDep) -> Response:
    """Return a file of the documentation page from the wheel of ``fastapi-offline``; raises :class:`NotFound`."""
    if name not in _FILES:
        raise NotFound("static file", name)
    path = _folder() / name
    etag = etag_of_file(path)
    conditions.tag(etag)
    return FileResponse(path, media_type=_FILES[name], headers={"ETag": etag})


def _folder() -> Path:
    found: Any = importlib.util.find_spec("fastapi_offline")
    return Path(found.origin).parent / "static"
