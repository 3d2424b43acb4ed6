"""HTML shells and static files of the web page."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response
from jinja2 import Environment, PackageLoader, StrictUndefined
from werkzeug.http import parse_accept_header, parse_etags

from steradian.core.exceptions import NotFound

POLICY: Final = (
    "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'; script-src 'self';"
    " style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; font-src 'self'"
)
"""Content Security Policy of the pages: scripts, style sheets and connections of this service only."""
PAGES: Final = {
    "/design": "design",
    "/scans": "scans",
    "/scans/{identifier}": "scan",
    "/reconstructions": "reconstructions",
    "/reconstructions/{identifier}": "reconstruction",
    "/volumes": "volumes",
    "/volumes/{identifier}": "volume",
    "/data": "data",
}
"""Routes and their templates; the page's script reads the path parameters."""
CONTENT_TYPES: Final = {
    ".css": "text/css",
    ".js": "text/javascript",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}
"""Media types by file extension: systems map ``.js`` differently, and browsers run scripts of the right type only."""
_STATIC: Final = Path(__file__).parent / "static"


def make_router(version: str, lab: Path | None = None, outside: Callable[[str], str] = str) -> APIRouter:
    """Create the FastAPI router of the web pages and their static files.

    Parameters
    ----------
    version
        Software version that the pages show.
    lab
        Folder of custom scripts: each page runs the scripts directly in it, in the order of their names.
    outside
        Converts a path of this service to the client's path below a proxy. The pages themselves use relative URLs, so
        that they work below any path.
    """
    router = APIRouter(include_in_schema=False)
    templates = Environment(loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined)

    def shell(template: str, root: str) -> HTMLResponse:
        scripts = sorted(path.name for path in lab.glob("*.js")) if lab is not None else []
        text = templates.get_template(f"{template}.html").render(page=template, version=version, lab=scripts, root=root)
        return HTMLResponse(text, headers={"Content-Security-Policy": POLICY})

    @router.get("/")
    def read_start(request: Request) -> Response:
        """Return the start page to browsers, and the paths of the API to other clients."""
        if parse_accept_header(request.headers.get("accept")).quality("text/html"):
            return shell("start", "./")
        paths = {"docs": "/docs", "openapi": "/openapi.json", "api": "/api/v1"}
        return JSONResponse({"name": "steradian"} | {name: outside(path) for name, path in paths.items()})

    for address, template in PAGES.items():
        show = _template_handler(shell, template, "../" * (address.count("/") - 1) or "./")
        router.add_api_route(address, show, response_class=HTMLResponse, name=f"show_{template}")

    @router.get("/static/lab/{name:path}")
    def read_lab_file(request: Request, name: str) -> Response:
        """Return a script of the operator's ``lab`` folder, or its data; raises :class:`NotFound`."""
        if lab is None:
            raise NotFound("static file", name)
        return _file(request, lab, name)

    @router.get("/static/{name:path}")
    def read_static_file(request: Request, name: str) -> Response:
        """Return a script, style sheet or image of the web page; raises :class:`NotFound`."""
        return _file(request, _STATIC, name)

    return router


def _template_handler(
    shell: Callable[[str, str], HTMLResponse], template: str, root: str
) -> Callable[[], HTMLResponse]:
    def show() -> HTMLResponse:
        return shell(template, root)

    return show


def _file(request: Request, folder: Path, name: str) -> Response:
    """Return a static file, or 304 if the client's copy is current; raises :class:`NotFound`."""
    path, root = (folder / name).resolve(), folder.resolve()
    if path.suffix not in CONTENT_TYPES or not path.is_relative_to(root) or not path.is_file():
        raise NotFound("static file", name)
    body = path.read_bytes()
    tag = hashlib.blake2s(body, digest_size=12).hexdigest()  # files of a wheel may have equal modification times
    headers = {"ETag": f'"{tag}"'}
    if parse_etags(request.headers.get("if-none-match")).contains_weak(tag):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type=CONTENT_TYPES[path.suffix], headers=headers)
