"""What the builder of the site is told besides mkdocs.yml: pages that lie elsewhere, generated ones, and their links.

Pages link to each other as files of the repository, so that they can be read there; here each such link is turned into
one of the site. A file that is no page, a script say, is laid beside them. Formulae become MathML, which browsers draw.
"""

from __future__ import annotations

import html
import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parent))
from generated import PAGES

ROOT = Path(__file__).parents[2]
ELSEWHERE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "driver/README.md": "driver/index.md",
    "driver/PROTOCOL.md": "driver/protocol.md",
    "clients/http/README.md": "clients/http.md",
    "clients/matlab/README.md": "clients/matlab.md",
    "clients/python/README.md": "clients/python.md",
    "docs/adr": "adr/index.md",
    "driver": "driver/index.md",
    "clients/http": "clients/http.md",
    "clients/matlab": "clients/matlab.md",
    "clients/python": "clients/python.md",
}
"""Pages outside of docs, and folders that stand for one: where they are in the site."""
HERE = {place: source for source, place in reversed(ELSEWHERE.items()) if source.endswith(".md")}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
FENCE = re.compile(r"^(```.*?^```)", re.DOTALL | re.MULTILINE)
ROLE = re.compile(r":(?:func|class|mod|meth|data|attr|exc):<code>[~.]?")
BLOCK, INLINE = (
    re.compile(r'<pre class="math"><code>(.*?)</code></pre>', re.DOTALL),
    re.compile(r"\$<code>(.*?)</code>\$"),
)


def on_files(files: Files, config: Any) -> Files:
    """Add what lies elsewhere, what is generated, and the files that pages link to."""
    for source, place in ELSEWHERE.items():
        if source.endswith(".md"):
            files.append(File.generated(config, place, abs_src_path=str(ROOT / source)))
    for place, write in PAGES.items():
        files.append(File.generated(config, place, content=write()))
    for page in [file for file in files if file.is_documentation_page() and file.src_uri not in PAGES]:
        for _, _, target, _ in LINK.findall(page.content_string):
            path = _path(page.src_uri, target)
            if target and (ROOT / path).is_file() and path not in ELSEWHERE and not path.startswith("docs/"):
                place = f"files/{path}"
                if not path.endswith(".md") and files.get_file_from_path(place) is None:
                    files.append(File.generated(config, place, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turn links between files of the repository into links between pages."""

    def turned(found: re.Match[str]) -> str:
        mark, text, target, anchor = found[1], found[2], found[3], found[4] or ""
        if not target or "://" in target or page.file.src_uri in PAGES:
            return found[0]
        path = _path(page.file.src_uri, target)
        place = ELSEWHERE.get(
            path.rstrip("/"), path.removeprefix("docs/") if path.startswith("docs/") else f"files/{path}"
        )
        if files.get_file_from_path(place) is None:
            return text if (ROOT / path).exists() else found[0]  # a folder, say; else the builder complains
        return f"{mark}[{text}]({posixpath.relpath(place, posixpath.dirname(page.file.src_uri) or '.')}{anchor})"

    return "".join(part if part.startswith("```") else LINK.sub(turned, part) for part in FENCE.split(markdown))


def on_page_content(content: str, **_: Any) -> str:
    """Draw the formulae, and leave out what docstrings say of the kinds of names."""
    content = ROLE.sub("<code>", content)
    content = BLOCK.sub(lambda found: convert(html.unescape(found[1]), display="block"), content)
    return INLINE.sub(lambda found: convert(html.unescape(found[1])), content)


def _path(src_uri: str, target: str) -> str:
    """Where in the repository a link of a page of the site leads."""
    origin = HERE.get(src_uri, f"docs/{src_uri}")
    return posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
