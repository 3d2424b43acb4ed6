"""How the numerics are put together: no circles, nobody in another's private parts, kernels with few arguments."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import steradian.imaging

ROOT = Path(steradian.imaging.__file__).parent
SOURCES = {
    ".".join(("steradian.imaging", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}
TREES = {name: ast.parse(path.read_text()) for name, path in SOURCES.items()}
MOST_ARGUMENTS = 8
OF_NAMED_TUPLES = {"_replace", "_asdict"}  # underscored so that they are no field's name


def _imported(name: str) -> set[str]:
    found = set()
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.ImportFrom) and node.module:
            # a package stands for those of its modules that are asked for
            found |= {
                inner if (inner := f"{node.module}.{alias.name}") in TREES else node.module for alias in node.names
            }
    return {other for other in found if other in TREES and other != name}


def test_no_module_imports_itself_by_a_detour_not_even_late() -> None:
    graph = {name: _imported(name) for name in TREES if name != "steradian.imaging"}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def _private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in OF_NAMED_TUPLES


@pytest.mark.parametrize("name", TREES)
def test_imaging_modules_access_no_foreign_private_members(name: str) -> None:
    reached = []
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Attribute) and _private(node.attr):
            if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
                reached.append(f"line {node.lineno}: {ast.unparse(node)}")
        if isinstance(node, ast.ImportFrom):
            reached += [f"line {node.lineno}: {alias.name}" for alias in node.names if _private(alias.name)]
    assert not reached


@pytest.mark.parametrize("name", [name for name, path in SOURCES.items() if "steradian.core.jit" in path.read_text()])
def test_kernels_take_few_arguments(name: str) -> None:
    functions = [node for node in ast.walk(TREES[name]) if isinstance(node, ast.FunctionDef)]
    taken = {f.name: len(f.args.args) + len(f.args.posonlyargs) + len(f.args.kwonlyargs) for f in functions}
    assert {name: count for name, count in taken.items() if count > MOST_ARGUMENTS} == {}


def test_importing_the_library_needs_no_compiler() -> None:
    """Tables and plans are made without Numba; the first run imports it."""
    compilers = ("steradian.core.jit", "\ncuda: Any = importlib")
    late = {name for name, path in SOURCES.items() if any(each in path.read_text() for each in compilers)}
    for name in TREES.keys() - late:
        tops = [node for node in TREES[name].body if isinstance(node, ast.ImportFrom)]
        assert not {n.module for n in tops} & late, name
