"""``/problems/{type}``: documentation of a problem type as HTML or JSON."""

from __future__ import annotations

from dataclasses import asdict
from html import escape
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from steradian.api.errors.catalog import PROBLEM_TYPES, ROOT, problem_type_uri
from steradian.api.http.array_response import JSON, negotiate
from steradian.api.http.urls import address
from steradian.core.exceptions import NotFound

router = APIRouter(prefix=ROOT, include_in_schema=False)
_HTML = "text/html"


@router.get("")
def list_problems(request: Request) -> Response:
    """List all problem types (RFC 9457), as HTML or JSON."""
    every = [_as_json(code) for code in PROBLEM_TYPES]
    parts = (f'<li><a href="{one["type"]}">{one["code"]}</a> ({one["status"]}): {one["title"]}' for one in every)
    return _as_html(request, {"items": every}, "Problems", f"<ul>{''.join(parts)}</ul>")


@router.get("/{code}")
def read_problem(request: Request, code: str) -> Response:
    """Return the description of a problem type as HTML or JSON; raises :class:`NotFound`."""
    if code not in PROBLEM_TYPES:
        raise NotFound("kind of problem", code)
    kind, more = PROBLEM_TYPES[code], f'<p><a href="{address(ROOT)}">Other problems</a></p>'
    body = f"<p>{escape(kind.meaning)}</p><p>What to do: {escape(kind.remedy)}</p><p>{kind.status} {code}</p>{more}"
    return _as_html(request, _as_json(code), kind.title, body)


def _as_json(code: str) -> dict[str, Any]:
    return {"type": address(problem_type_uri(code)), "code": code} | asdict(PROBLEM_TYPES[code])


def _as_html(request: Request, told: dict[str, Any], title: str, body: str) -> Response:
    headers = {"Vary": "Accept"}
    if negotiate(request, (JSON, _HTML)) == JSON:
        return JSONResponse(told, headers=headers)
    head = f'<meta charset="utf-8"><title>{escape(title)}</title>'
    return HTMLResponse(
        f'<!doctype html><html lang="en"><head>{head}</head><body><h1>{escape(title)}</h1>{body}</body></html>',
        headers=headers,
    )
