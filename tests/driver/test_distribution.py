"""The driver alone: a distribution that names what it needs, shares no file with the service's, and has no circle."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "driver" / "fabry_perot"


def project(folder: Path) -> dict:
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))


def requirements(folder: Path) -> set[str]:
    return {re.match(r"[\w-]+", line)[0] for line in project(folder)["project"]["dependencies"]}


def imported() -> set[str]:
    """Names of the top-level packages that any module of the driver imports, the standard library's left out."""
    names = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(str(node.module).partition(".")[0])
    return names - sys.stdlib_module_names - {"fabry_perot"}


def test_driver_distribution_requirements_equal_imports():
    where = packages_distributions()
    assert {where[name][0] for name in imported()} == requirements(ROOT / "driver")


def test_no_file_belongs_to_two_distributions_and_one_brings_the_other():
    wheels = [project(folder)["tool"]["hatch"]["build"]["targets"]["wheel"] for folder in (ROOT, ROOT / "driver")]
    assert [[Path(name).name for name in wheel["packages"]] for wheel in wheels] == [["steradian"], ["fabry_perot"]]
    assert project(ROOT / "driver")["project"]["name"] in requirements(ROOT)
    assert not set(project(ROOT)["project"]["scripts"]) & set(project(ROOT / "driver")["project"]["scripts"])


def test_the_tested_set_of_packages_names_no_folder_of_a_machine():
    for name in ("constraints.txt", "constraints-ci.txt"):
        assert "file:" not in (ROOT / name).read_text(encoding="utf-8")
