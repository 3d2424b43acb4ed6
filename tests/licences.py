"""The licences of all that is installed with Steradian: ``python tests/licences.py > docs/licences.md``.

What only tests and benchmarks need is left out; versions are not named, as constraints.txt does that.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement

OURS = ("steradian", "fabry-perot-scanner", "steradian-client")
EXTRAS = {"steradian": ("export", "notebook", "store", "vessels"), "steradian-client": ("cli",)}
FREE = re.compile(
    r"\b(MIT|BSD|0BSD|Apache|ISC|PSF|PSFL|Python Software|MPL|Mozilla|LGPL|Lesser|HPND|CNRI|Zlib|CC0|Unlicense)"
)
"""What others may use, change and pass on beside code of any licence."""


HEAD = """\
# Licences of what is installed with Steradian

Written by `python tests/licences.py`; `tests/test_licences.py` compares it with what is installed. Some are needed
on one system or Python only. None of their code lies in this repository."""


def name_of(text: str) -> str:
    """Write a distribution's name as indexes do."""
    return re.sub(r"[-_.]+", "-", text).lower()


def needed() -> dict[str, str]:
    """Return the licence of each distribution that ours need and that is installed, by its name."""
    left = [(name, extra) for name in OURS for extra in ("", *EXTRAS.get(name, ()))]
    seen, found = set(left), {}
    while left:
        name, extra = left.pop()
        try:
            made = distribution(name)
        except PackageNotFoundError:  # of another Python or system
            continue
        if name not in OURS:
            found[name] = licence_of(made.metadata)
        for line in made.requires or ():
            wanted = Requirement(line)
            if wanted.marker is None or wanted.marker.evaluate({"extra": extra}):
                more = {(name_of(wanted.name), each) for each in ("", *wanted.extras)} - seen
                seen |= more
                left += more
    return found


def licence_of(metadata) -> str:
    """Return a licence in one line: the expression, else what classifiers say, else the beginning of the text."""
    if said := metadata.get("License-Expression"):
        return said
    classified = [
        line.rpartition(" :: ")[2] for line in metadata.get_all("Classifier", ()) if line.startswith("License ::")
    ]
    named = [line for line in classified if line != "OSI Approved"]
    return ", ".join(named) or (metadata.get("License") or "unknown").strip().splitlines()[0][:60]


def page(licences: dict[str, str]) -> str:
    """Write the page."""
    rows = "\n".join(f"| {name} | {licence} |" for name, licence in sorted(licences.items()))
    return f"{HEAD}\n\n| distribution | licence |\n|---|---|\n{rows}\n"


if __name__ == "__main__":
    sys.stdout.write(page(needed()))
