"""A page that shows the OpenAPI document without loading anything from elsewhere."""

from __future__ import annotations

import html
import json
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse, Response

from steradian.api.headers import POLICY
from steradian.api.security import V1

router = APIRouter()


@router.get("/", include_in_schema=False)
def read_start(request: Request) -> Response:
    """Point to the documentation: a browser is led there, anybody else is told where it is."""
    if "text/html" in request.headers.get("accept", ""):
        return RedirectResponse("/docs")
    return JSONResponse({"name": "steradian", "docs": "/docs", "openapi": "/openapi.json", "api": V1})


@router.get("/docs", include_in_schema=False)
def show_documents(request: Request) -> HTMLResponse:
    """Show the API to a person; everything the page needs is in it."""
    document = request.app.openapi()
    parts = [
        _operation(method, path, operation)
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
    ]
    page = f"""<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Steradian API</title><style>
body{{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}}
code,pre{{font:14px/1.4 ui-monospace,monospace}}pre{{background:#f4f4f4;padding:.6rem;overflow:auto}}
summary{{cursor:pointer;padding:.3rem 0}}summary code{{font-weight:600}}table{{border-collapse:collapse}}
td,th{{text-align:left;padding:.1rem 1rem .1rem 0;vertical-align:top}}</style></head><body>
<h1>Steradian API {html.escape(document["info"]["version"])}</h1>
<p>{html.escape(document["info"]["summary"])}. For machines: <a href="/openapi.json">openapi.json</a>.
Every answer of 400 and above is a problem document (RFC 9457).</p>{"".join(parts)}</body></html>"""
    return HTMLResponse(page, headers={"Content-Security-Policy": f"{POLICY}; style-src 'unsafe-inline'"})


def _operation(method: str, path: str, operation: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><td><code>{html.escape(p['name'])}</code></td><td>{p['in']}{', required' if p.get('required') else ''}"
        f"</td><td>{html.escape(p.get('description', ''))}</td></tr>"
        for p in operation.get("parameters", [])
    )
    answers = "".join(
        f"<tr><td><code>{status}</code></td><td>{html.escape(answer.get('description', ''))}</td></tr>"
        for status, answer in operation["responses"].items()
    )
    body = operation.get("requestBody", {}).get("content", {}).get("application/json", {})
    examples = [e["value"] for e in body.get("examples", {}).values()] if "examples" in body else []
    shown = "".join(f"<pre>{html.escape(json.dumps(example))}</pre>" for example in examples)
    head = f"<code>{method.upper()} {html.escape(path)}</code> {html.escape(operation.get('summary', ''))}"
    return (
        f"<details><summary>{head}</summary><p>{html.escape(operation.get('description', ''))}</p>"
        f"<table>{rows}</table>{shown}<table>{answers}</table></details>"
    )
