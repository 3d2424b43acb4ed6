"""Public names: documents and examples import only names in a package's ``__all__``, and all of these exist."""

import ast
import importlib
import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("steradian", "fabry_perot", "steradian_client")
OPTIONAL = {"torch", "jax"}  # packages for a library of the same name
SOURCES = [
    path
    for pattern in (
        "README.md",
        "docs/*.md",
        "examples/**/*.py",
        "examples/**/*.ipynb",
        "driver/*.md",
        "clients/**/*.md",
    )
    for path in sorted(ROOT.glob(pattern))
] + [*sorted((ROOT / "driver/examples").glob("*/*.py")), *sorted((ROOT / "clients/python/examples").glob("*.py"))]


def code_blocks(path):
    """Return the Python code in a document, notebook or script."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    if path.suffix == ".ipynb":
        return ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    return [text]


def imported_names(code):
    """Return (module, name) for each name that code imports from one of the packages."""
    imports = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.ImportFrom) and not node.level]
    return {
        (node.module, name.name) for node in imports for name in node.names if node.module.split(".")[0] in PACKAGES
    }


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_documents_and_examples_import_only_public_names(path):
    for module, name in set().union(*map(imported_names, code_blocks(path)), set()):
        if module.split(".")[-1] in OPTIONAL and importlib.util.find_spec(module.split(".")[-1]) is None:
            continue
        assert name in getattr(importlib.import_module(module), "__all__", ()), f"{module}.{name} is not public"


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_of_all_packages_exist(package):
    folder = Path(importlib.import_module(package).__file__).parent
    for file in sorted(folder.rglob("__init__.py")):
        if file.parent.name in OPTIONAL and importlib.util.find_spec(file.parent.name) is None:
            continue
        module = importlib.import_module(".".join((package, *file.parent.relative_to(folder).parts)))
        for name in getattr(module, "__all__", ()):
            assert hasattr(module, name), f"{module.__name__}.{name}"
