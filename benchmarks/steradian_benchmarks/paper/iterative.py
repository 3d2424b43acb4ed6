"""Section on iterative reconstruction, from the measurements of :mod:`.iterative_measurements`."""

from __future__ import annotations

from steradian_benchmarks.paper.iterative_measurements import DIRECT, FILTERED, ITERATIVE, measure
from steradian_benchmarks.paper.markdown import number, percent, picture, spread, table
from steradian_benchmarks.paper.sections import Claim, Section, SectionResult

IMPROVEMENT_TARGET = {
    "thresholding": "adds up direct reconstructions, cut off at their streaks, to a non-negative volume",
    "total-variation": "looks for the non-negative volume of least total variation",
}


def write(part: SectionResult) -> str:
    """Return the section on iterative reconstruction as Markdown."""
    options, cost = part["options"], part["cost"]
    rows = [[f"yarn, seed {row['seed']}", *_cells(row)] for row in part["rows"]]
    if part["kwave"] is not None:
        share = percent(part["kwave"]["points"] / part["kwave"]["of"])
        rows.append([f"k-Wave's yarn, {share} of its sensors", *_cells(part["kwave"])])
    first = part["rows"][0]
    low, high = (number(1e3 * depth, 1) for depth in part["depths"])
    return "\n".join(
        [
            f"The paper's weights are the simplest inversion of a sparse mask. From the same {part['points']:,} points"
            f" ({number(part['noise_db'], 0)} dB peak noise, c = {number(part['speed'], 0)} m/s),",
            f'`Iterative(regularisation="{options["regularisation"]}")`'
            f" {IMPROVEMENT_TARGET[options['regularisation']]} (strength {options['strength']:g},"
            f" at most {options['iterations']} iterations)",
            "whose A-lines fit; the same defaults for every row. Pearson's correlation with the initial pressure on all"
            f" voxels, depths {low}–{high} mm (k-Wave's: all of its own voxels).",
            "",
            table(
                [
                    "object",
                    "volume: direct",
                    "low-passed",
                    "iterative",
                    "z-MIP: direct",
                    "low-passed",
                    "iterative",
                ],
                rows,
            ),
            picture("iterative", "Truth, direct and iterative reconstruction: projection and a plane of the volume"),
            f"- *Cost.* Forward and adjoint product at full size take {number(cost['forward'], 2)} and"
            f" {number(cost['backward'], 2)} direct reconstructions ({part['modes']}² × {part['samples']});",
            f"  a whole run ({cost['products']} products) takes {number(cost['run'], 1)}"
            f" ({number(cost.get('run_cpu'), 1)} in processor time), because it works on one"
            f" sample in {first['thinning']}, which holds the signal's band, with the aperture",
            f"  padded until no copy is heard. Memory: at most {number(first['megabytes'], 0)} MB,"
            f" {number(first.get('outputs'), 1)} times the volume's.",
            "- *Low-passed* is the direct formula on A-lines cut where the noise takes over: the part of the gain that"
            " a filter alone gives.",
            "- *What it rests on.* Non-negative volumes, mostly empty or piecewise flat: a yarn is one. Structures"
            " finer than the band,"
            " or a wrong speed of sound, are not mended.",
            "",
        ]
    )


def _cells(row: SectionResult) -> list[str]:
    names = (DIRECT, FILTERED, ITERATIVE)
    return [number(row["images"][name][of]) for of in ("volume", "mip") for name in names]


def claims(part: SectionResult) -> list[Claim]:
    """Return the claims: volumes improve by 0.10 over direct reconstruction, projections do not deteriorate."""
    rows = [*part["rows"], *([part["kwave"]] if part["kwave"] is not None else [])]
    gains, mips = ([_gain(row, of) for row in rows] for of in ("volume", "mip"))
    low, high = (number(bound(_gain(row, "volume", (DIRECT,)) for row in rows), 2) for bound in (min, max))
    return [
        Claim(
            "Iterative reconstruction: volume's correlation with the truth at least 0.10 above that of the direct one"
            " and of the direct one low-passed",
            tuple(gain - 0.10 for gain in gains),
            f"{spread(gains, 2)} above the better of both ({low}–{high} above the unfiltered; {len(rows)} runs)",
        ),
        Claim(
            "Iterative reconstruction: z-MIP's correlation above both",
            tuple(mips),
            f"{spread(mips)} ({len(rows)} runs)",
        ),
        *_price(part),
    ]


def _price(part: SectionResult) -> list[Claim]:
    """Return the claims on the time, memory and benefit of the iterative method."""
    yarns = [row["images"][ITERATIVE]["volume"] for row in part["rows"]]
    run, outputs = part["cost"]["run"], [row["outputs"] for row in part["rows"] if "outputs" in row]
    memory = Claim(
        "Iterative reconstruction: at most 3 volumes of memory",
        tuple(3 - each for each in outputs),
        number(max(outputs, default=0), 1),
    )
    return [
        Claim("Iterative reconstruction: at most 8 direct ones' time", (8 - run,), number(run, 1)),
        *([memory] if outputs else []),  # older documents do not have it
        Claim("Iterative reconstruction: a yarn's volume to 0.985", tuple(v - 0.985 for v in yarns), spread(yarns, 3)),
    ]


def _gain(row: SectionResult, of: str, others: tuple[str, ...] = (DIRECT, FILTERED)) -> float:
    """Return the gain in correlation of the iterative method over the best other method."""
    gain: float = row["images"][ITERATIVE][of] - max(row["images"][name][of] for name in others)
    return gain


SECTION = Section("iterative", "Better volumes from the same points", measure, write, claims)
