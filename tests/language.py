"""Ratchet for the language of docstring summaries, which CI runs: ``python tests/language.py``.

It fails when a package has more findings than recorded in ``LIMITS``, or fewer, so that the record falls with them.
``python tests/language.py PATH...`` lists the findings below each path. CONTRIBUTING.md has the style guide.
"""

import ast
import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = (
    "service/steradian",
    "driver/fabry_perot",
    "clients/python/steradian_client",
    "benchmarks/steradian_benchmarks",
)
RULES = {
    "begins with a question word": r"^(what|who|whose|where|how|which|those|whoever)\b",
    "clause with 'what' instead of a noun": r"(?<!`)\bwhat(ever)?\b(?!-if)",
    "'who' or 'nobody' instead of a role": r"\b(who(ever|m)?|nobody|somebody|anybody|everybody|those who)\b",
    "'is no X' instead of 'is not an X'": r"\b(is|are|was|be|were) no (?!longer\b|more\b)[a-z`]",
    "causative or 'be' as an imperative": r"^(have|let|be) ",
    "vague quantity": r"\b(so many|so long|such(?! as\b))\b",
    "archaic verb": r"\b(anew|go(es|ing)? on|(be|is) (had|gone)|takes? up|put back|stands? back|tells?|told)\b",
}
LIMITS: dict[str, int] = {}
"""Accepted findings of each package; a number may only fall."""


def findings(path: Path) -> list[str]:
    """Return one line for each docstring summary of a file that breaks a rule, module docstrings included."""
    lines = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        summary = (ast.get_docstring(node) or "").split("\n\n")[0]
        broken = [rule for rule, pattern in RULES.items() if re.search(pattern, summary, re.IGNORECASE)]
        if broken:
            kind = "module" if isinstance(node, ast.Module) else node.name
            lines.append(
                f"{path}:{getattr(node, 'lineno', 1)}: {kind}: {summary.splitlines()[0]} [{'; '.join(broken)}]"
            )
    return lines


def package_of(path: Path) -> str:
    """Return the package under which findings of a source file are counted."""
    return "/".join(path.relative_to(ROOT).with_suffix("").parts[1:3])


def check() -> list[str]:
    """Return one line for each package whose number of findings is not the recorded one."""
    counts = Counter(dict.fromkeys(LIMITS, 0))
    for top in SOURCES:
        for path in sorted((ROOT / top).rglob("*.py")):
            counts[package_of(path)] += len(findings(path))
    return [
        f"{package}: {count} findings, recorded are {LIMITS.get(package, 0)}: rewrite them, or lower the record"
        for package, count in sorted(counts.items())
        if count != LIMITS.get(package, 0)
    ]


def main(paths: list[str]) -> int:
    """List findings below paths, or check the record."""
    found = [
        line
        for each in map(Path, paths)
        for path in (sorted(each.rglob("*.py")) if each.is_dir() else [each])
        for line in findings(path)
    ]
    lines = found if paths else check()
    print(*lines, sep="\n", end="\n" if lines else "")
    return int(bool(lines) and not paths)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
