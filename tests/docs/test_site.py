"""The documentation as a site: each link leads somewhere, nothing comes from elsewhere, generated pages are whole."""

import html
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

import steradian
from steradian.cli.app import app
from steradian.core.settings import Settings

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[2]
FETCHED = re.compile(
    r"<(?:script|img|iframe|source|video)\b[^>]*?\bsrc=[\"']?(?:https?:)?//|<link\b[^>]*?\brel=[\"']?(?:stylesheet|preconnect|preload|icon)[^>]*?\bhref=[\"']?(?:https?:)?//"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built so that a link or an anchor that leads nowhere is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr[-6000:]
    return folder


def text_of(page):
    return html.unescape(re.sub(r"<[^>]*>", "", page.read_text("utf-8")))


def test_no_page_fetches_anything_from_elsewhere(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    assert (site / "search" / "search_index.json").is_file()
    for page in pages:
        assert FETCHED.search(page.read_text("utf-8")) is None, page
    for style in site.rglob("*.css"):
        assert re.search(r"url\([\"']?(?:https?:)?//", style.read_text("utf-8")) is None, style


def test_every_public_name_of_the_library_is_described_with_its_parameters(site):
    page = (site / "reference" / "library.html").read_text("utf-8")
    for name in steradian.__all__:
        home = "steradian.quality" if name == "quality" else f"{steradian._HOMES[name]}.{name}"
        assert f'id="{home}"' in page, name
    text = text_of(site / "reference" / "library.html")
    assert "Side X of the square aperture in metres" in text
    assert re.search(r":(func|class|mod|data):", text) is None


def test_every_command_setting_and_operation_is_described(site):
    commands = text_of(site / "reference" / "command-line.html")
    for name in get_command(app).commands:
        assert f"steradian {name}" in commands
    settings = text_of(site / "reference" / "settings.html")
    assert all(f"STERADIAN_{name.upper()}" in settings for name in Settings.model_fields)
    routes = text_of(site / "reference" / "http.html")
    known = json.loads((ROOT / "docs" / "openapi.json").read_text("utf-8"))["paths"]
    assert all(path in routes for path in known)


def test_the_method_is_drawn_as_formulae(site):
    page = (site / "method.html").read_text("utf-8")
    assert page.count('display="block"') == 2
    assert "$" not in re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.DOTALL)
