"""No circle of imports between modules or folders, counting imports in functions and for annotations, too."""

import ast
import subprocess
import sys
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
    return grimp.build_graph("steradian", "steradian_client", "fabry_perot", "steradian_benchmarks", cache_dir=None)


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
    parts = ("steradian", "steradian.api", "steradian.scans", "steradian.reconstructions", "steradian_benchmarks")
    for parent in parts:
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
    sources = {path: path.read_text() for path in root.rglob("*.py")}
    for path in (path for path, source in sources.items() if "import_module" in source):
        for node in ast.walk(ast.parse(sources[path])):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                name = node.args[0].value if isinstance(node.args[0], ast.Constant) else "steradian"
                found |= {str(path.relative_to(root))} if name.startswith("steradian") else set()
    assert found == BY_NAME


AT_REST = {
    "steradian.runtime.supervisor": {"numpy", "sqlalchemy", "alembic", "psycopg", "h5py"},
    "steradian.api.__main__": {"alembic", "dbos", "psycopg", "h5py", "scipy", "numba", "matplotlib", "PIL"},
    "steradian.runtime.acquisition": {"alembic", "dbos", "psycopg", "h5py", "scipy", "numba", "matplotlib", "PIL"},
    "steradian.runtime.worker_entry": {"alembic", "psycopg", "h5py", "scipy", "numba", "matplotlib", "PIL"},
}
"""Libraries that an idle process of the service does without; each takes 4 to 60 MB."""


@pytest.mark.long
@pytest.mark.parametrize("module", AT_REST)
def test_process_of_the_service_imports_no_library_that_it_does_not_need_at_rest(module):
    code = "import importlib, sys; importlib.import_module(sys.argv[1]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code, module], capture_output=True, text=True, check=True)
    assert AT_REST[module] & set(done.stdout.split()) == set()
