"""No circle of imports between modules or folders, counting imports in functions and for annotations, too."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

import steradian

BY_NAME = {
    "__init__.py",  # public names, loaded when first used
    "cli/app.py",  # the module of a command
    "imaging/engines/cuda/array_backend.py",  # modules of CuPy and numba-cuda
    "reconstructions/exporting/__init__.py",  # the writer of a format
    "reconstructions/exporting/optional_imports.py",  # optional libraries
}


@pytest.fixture(scope="module")
def graph():
    """The graph of all imports."""
    return grimp.build_graph("steradian", "steradian_client", "fabry_perot", cache_dir=None)


def circle(imports):
    """Name one circle, each module importing the one before it; none is an empty text."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return " → ".join(reversed(error.args[1]))
    return ""


def test_no_modules_import_each_other(graph):
    assert circle({name: graph.find_modules_directly_imported_by(name) for name in graph.modules}) == ""


def test_no_folders_import_each_other(graph):
    """The folders beside each other, with all that is below them; single modules beside them count as themselves."""
    for parent in ("steradian", "steradian.api", "steradian.scans", "steradian.reconstructions"):
        imports = {child: set() for child in graph.find_children(parent)}
        for child in imports:
            for module in {child} | graph.find_descendants(child):
                for imported in graph.find_modules_directly_imported_by(module):
                    other = next((name for name in imports if f"{imported}.".startswith(f"{name}.")), child)
                    imports[child] |= {other} - {child}
        assert circle(imports) == "", parent


def test_only_listed_modules_import_own_modules_by_name():
    """The checks above cannot see such imports; names of other packages' modules do not matter."""
    root, found = Path(steradian.__file__).parent, set()
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                name = node.args[0].value if isinstance(node.args[0], ast.Constant) else "steradian"
                found |= {str(path.relative_to(root))} if name.startswith("steradian") else set()
    assert found == BY_NAME
