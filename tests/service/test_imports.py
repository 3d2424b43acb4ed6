"""No circle of imports, between modules or between folders: whatever is imported can be read and tested before."""

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest


@pytest.fixture(scope="module")
def graph():
    """Who imports whom at run time, also inside functions; imports for annotations alone do not count."""
    return grimp.build_graph(
        "steradian", "steradian_client", "fabry_perot", exclude_type_checking_imports=True, cache_dir=None
    )


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
