"""Line counts by package for two commits.

    python benchmarks/package_sizes.py [BEFORE [AFTER]]

prints the lines of Python files of each installed package, and of what is not installed (default: HEAD~1, HEAD).
"""

import subprocess
import sys
from collections import Counter

INSTALLED = {
    "service/steradian/": "steradian",
    "driver/fabry_perot/": "fabry_perot",
    "clients/python/steradian_client/": "steradian_client",
}
"""Folders whose Python files are installed."""


def git(*words: str) -> bytes:
    """Return the standard output of a git command."""
    return subprocess.run(["git", *words], check=True, capture_output=True).stdout  # noqa: S607


def package_of(path: str) -> str:
    """Return the row of a file: an installed package and its folder, or the top folder of what is not installed."""
    for folder, package in INSTALLED.items():
        if path.startswith(folder):
            first, *rest = path.removeprefix(folder).split("/")
            return f"{package}.{first}" if rest else package
    return f"({path.split('/')[0]})"


def lines_at(commit: str) -> Counter[str]:
    """Return the number of lines of Python files by package at a commit."""
    lines: Counter[str] = Counter()
    for path in git("ls-tree", "-r", "--name-only", commit).decode().splitlines():
        if path.endswith(".py"):
            lines[package_of(path)] += git("show", f"{commit}:{path}").count(b"\n")
    return lines


def main() -> None:
    """Print the table."""
    before, after = (*sys.argv[1:3], *("HEAD~1", "HEAD")[len(sys.argv) - 1 :])[:2]
    counts = lines_at(before), lines_at(after)
    rows = sorted({*counts[0], *counts[1]}, key=lambda row: (row.startswith("("), row))
    print(f"{'lines of Python in':40}{before:>12}{after:>12}{'change':>9}")
    for row in rows:
        print(f"{row:40}{counts[0][row]:12,}{counts[1][row]:12,}{counts[1][row] - counts[0][row]:+9,}")
    for title, rows_of in (
        ("installed", lambda row: not row.startswith("(")),
        ("outside tests", lambda row: row != "(tests)"),
        ("tests", lambda row: row == "(tests)"),
    ):
        sums = [sum(count for row, count in lines.items() if rows_of(row)) for lines in counts]
        print(f"{title:40}{sums[0]:12,}{sums[1]:12,}{sums[1] - sums[0]:+9,}")


if __name__ == "__main__":
    main()
