"""Tables of the coverage study: do stated intervals hold the truth as often as they say?"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tests import Array
from tests.studies.coverage.score import Result, Row, z_of
from tests.studies.tables import number, rms, table

INSIDE = 1.96  # standard errors: the 95 % interval
OPEN = ("do not tell whether rotors", "neither 0 nor 1")  # notes of an undecided coupling
GROUPS = ("friction", "gravity", "inertia", "imu")
HEADER = ["seeds", "values", "rms z", "inside 95 %", "interval", "largest z", "mean z"]


@dataclass(frozen=True)
class Coverage:
    """How the errors of some quantity compare with those stated, over seeds."""

    seeds: int
    count: int
    rms: float
    share: float
    low: float
    high: float
    largest: float
    mean: float

    def cells(self) -> list[str]:
        """Cells of a table's row, as `HEADER`."""
        return [
            str(self.seeds),
            str(self.count),
            number(self.rms, 3),
            f"{100 * self.share:.1f} %",
            f"{100 * self.low:.0f} to {100 * self.high:.0f}",
            number(self.largest, 3),
            f"{self.mean:+.2f}",
        ]


def coverage(by_seed: Sequence[Array]) -> Coverage:
    """Summarise z by seed; values of one seed may depend on each other, seeds do not.

    The share's interval is Wilson's, for as many independent values as the spread of the seeds'
    own shares allows: at least the number of seeds, at most that of values.
    """
    kept = [z for z in by_seed if len(z)]
    z = np.concatenate(kept)
    inside = [np.abs(own) <= INSIDE for own in kept]
    share = float(np.mean(np.concatenate(inside)))
    low, high = wilson(share, independent([x.astype(float) for x in inside]))
    return Coverage(
        len(kept), len(z), rms(z), share, low, high, float(np.abs(z).max()), float(z.mean())
    )


def independent(by_seed: Sequence[Array]) -> float:
    """Number of independent values that have the same uncertainty of their mean."""
    sizes = np.array([len(x) for x in by_seed])
    values = np.concatenate(by_seed)
    mean = float(values.mean())
    off = np.array([float(np.sum(x - mean)) for x in by_seed])
    variance = float(np.sum(off**2)) / float(sizes.sum()) ** 2
    if variance == 0.0 or len(by_seed) < 2:
        return float(len(by_seed))
    return float(np.clip(mean * (1.0 - mean) / variance, len(by_seed), len(values)))


def wilson(share: float, count: float, z: float = INSIDE) -> tuple[float, float]:
    """Wilson's 95 % interval of a share of `count` values."""
    middle = share + z**2 / (2 * count)
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    scale = 1 + z**2 / count
    return float((middle - half) / scale), float((middle + half) / scale)


def tables_of(results: Sequence[Result]) -> str:
    """All tables of one rig's results."""
    subsets: dict[str, Callable[[Result], bool]] = {
        "all": lambda r: True,
        "white noise": lambda r: bool(r["noise"] == "white"),
        "coloured noise": lambda r: bool(r["noise"] == "coloured"),
        "fine encoder": lambda r: bool(r["encoder"] == "fine"),
        "coarse encoder": lambda r: bool(r["encoder"] == "coarse"),
    }
    parts = [group_table(results, subsets), parameter_table(results)]
    if any("rotor_coupling" in r["traits"] for r in results):
        parts.append(coupling_table(results))
    parts.append(problems(results))
    return "\n\n".join(part for part in parts if part)


def group_table(results: Sequence[Result], subsets: dict[str, Callable[[Result], bool]]) -> str:
    """One row per group of quantities and subset of the seeds."""
    rows = []
    for group in GROUPS:
        for label, chosen in subsets.items():
            own = [r for r in results if chosen(r)]
            if label != "all" and len(own) in (0, len(results)):
                continue
            z = [z_of([x for x in r["rows"] if x["group"] == group]) for r in own]
            if any(len(x) for x in z):
                rows.append([f"{group}, {label}", *coverage(z).cells()])
            good = [x for x, r in zip(z, own, strict=True) if r["verdicts"].get(group)]
            if label == "all" and 0 < len(good) < len(own):
                rows.append([f"{group}, verdict good", *coverage(good).cells()])
    return table(["group", *HEADER], rows)


def parameter_table(results: Sequence[Result]) -> str:
    """One row per parameter, joint's surface or IMU's axis."""
    names = list(dict.fromkeys((x["group"], x["name"]) for r in results for x in r["rows"]))
    names.sort(key=lambda one: GROUPS.index(one[0]))
    rows = []
    for group, name in names:
        z = [
            z_of([x for x in r["rows"] if (x["group"], x["name"]) == (group, name)])
            for r in results
        ]
        error = relative(
            [x for r in results for x in r["rows"] if (x["group"], x["name"]) == (group, name)]
        )
        rows.append([f"{group}: {name}", *coverage(z).cells(), error])
    return table(["quantity", *HEADER, "median error"], rows)


def relative(rows: Sequence[Row]) -> str:
    """Median error as a share of the median truth; of mountings, deg."""
    off = np.abs([x["estimate"] - x["truth"] for x in rows])
    truth = np.abs([x["truth"] for x in rows])
    if not truth.any():
        return f"{number(float(np.median(off)))} deg"
    share = 100 * float(np.median(off) / np.median(truth))
    return f"{number(share)} %" if share < 100 else "> 100 %"


def coupling_table(results: Sequence[Result]) -> str:
    """What was decided about the rotors' coupling against what is so."""
    found = [r for r in results if "rotor_coupling" in r]
    decided = sorted({decision(r) for r in found})
    rows = []
    for truth in (False, True):
        own = [decision(r) for r in found if r["traits"]["rotor_coupling"] is truth]
        counts = [str(own.count(decision)) for decision in decided]
        rows.append(["rotors coupled" if truth else "rotors not coupled", *counts])
    return table(["truth; decided:", *decided], rows)


def decision(result: Result) -> str:
    """What was decided about the coupling, or that the stage left it open."""
    doubtful = any(words in note for note in result["notes"] for words in OPEN)
    return "left open" if doubtful else str(result["rotor_coupling"])


def problems(results: Sequence[Result]) -> str:
    """Stages that stopped, and verdicts that are poor, by seed."""
    lines = [f"- seed {r['seed']}: {r['failed']}" for r in results if "failed" in r]
    for stage in GROUPS:
        poor = [str(r["seed"]) for r in results if r["verdicts"].get(stage) is False]
        if poor:
            lines.append(f"- {stage} poor: seeds {', '.join(poor)}")
    return "\n".join(lines)
