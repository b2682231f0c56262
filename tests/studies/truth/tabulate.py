"""Tables of the study: silent wrongs and intervals, by group,
stage and imperfection.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.studies.tables import grouped, number, rms, share_within, table
from tests.studies.truth.score import HANDED_ON
from tests.studies.truth.tolerances import TOLERANCES

Row = dict[str, Any]
STAGES = ("friction", HANDED_ON, "gravity", "imu", "inertia", "simultaneous")
MODEL = ("friction", HANDED_ON, "gravity", "inertia")
INSIDE = 1.96  # stated standard errors: the 95 % interval
WRONG = 4.0  # stated standard errors, beyond which a parameter is wrong
LEVELS = ("poor", "usable", "good")


@dataclass(frozen=True, kw_only=True)
class Value:
    """One parameter, or one joint's friction: its errors over stated ones (a surface
    has many).
    """

    stage: str
    name: str
    level: str  # of the stage
    z: list[float]

    @property
    def wrong(self) -> bool:
        return rms(self.z) > WRONG

    @property
    def silent(self) -> bool:
        """Whether it is wrong although the stage says that it is good."""
        return self.wrong and self.level == "good"


def values_of(row: Row, *stages: str) -> Iterator[Value]:
    """Yield what the stages of a row say, beside the truth."""
    for stage in stages or STAGES:
        found = row["stages"].get(stage)
        if found is None:
            continue
        for p in found["parameters"]:
            z = (p["value"] - p["truth"]) / max(p["std_error"], 1e-12)
            yield Value(stage=stage, name=p["name"], level=found["level"], z=[z])
        for joint in found.get("friction", ()):
            # The surface holds a logged offset, or the file has it beside the surface.
            z = min(joint["z"], joint["z_without"], key=rms)
            yield Value(stage=stage, name=joint["joint"], level=found["level"], z=z)


def silent_wrongs(rows: Sequence[Row], *stages: str) -> list[Value]:
    return [value for row in rows for value in values_of(row, *stages) if value.silent]


def _inside(rows: Sequence[Row], level: str, *stages: str) -> str:
    z = [
        x
        for row in rows
        for v in values_of(row, *stages)
        if v.level == level
        for x in v.z
    ]
    return f"{100 * share_within(z, INSIDE):.1f} %" if z else "-"


def level_of(row: Row) -> str:
    """Return the worst level of friction, gravity and inertia; poor where a stage
    failed.

    Where an IMU sits on its link is told by few motions only, and no fault of the
    model.
    """
    if row["failed"]:
        return "poor"
    found = [row["stages"][name]["level"] for name in MODEL if name in row["stages"]]
    return min(found, key=LEVELS.index)


def _levels(rows: Sequence[Row]) -> str:
    found = [level_of(row) for row in rows]
    return ", ".join(str(found.count(level)) for level in reversed(LEVELS))


def shows(row: Row) -> bool:
    """Whether every imperfection of a row shows in its stage's own logs, or is
    declared.
    """
    return all(_shows(x) for x in row["imperfections"])


def _shows(imperfection: Row) -> bool:
    kind = imperfection["kind"]
    if kind == "warmth":
        # Without a temperature, a trial that warms up looks like friction that falls
        # with speed.
        return bool(imperfection["sizes"]["logged"])
    return imperfection["declared"] or kind not in TOLERANCES


def groups_of(rows: Sequence[Row]) -> dict[str, Sequence[Row]]:
    count = {
        number: [r for r in rows if len(r["imperfections"]) == number]
        for number in (0, 1, 3)
    }
    return {
        "clean": count[0],
        "one imperfection": count[1],
        "three at a time": count[3],
        "all": rows,
        "all that logs can show or the robot file declares": [
            row for row in rows if shows(row)
        ],
    }


def _columns(*stages: str) -> dict[str, Callable[[Sequence[Row]], str]]:
    return {
        "arms": lambda rows: str(len(rows)),
        "good, usable, poor": _levels,
        "failed": lambda rows: str(sum(bool(row["failed"]) for row in rows)),
        "silent wrongs": lambda rows: str(len(silent_wrongs(rows, *stages))),
        "arms with any": lambda rows: str(
            sum(bool(silent_wrongs([r], *stages)) for r in rows)
        ),
        "intervals that hold, good": lambda rows: _inside(rows, "good", *stages),
        "usable": lambda rows: _inside(rows, "usable", *stages),
        "poor": lambda rows: _inside(rows, "poor", *stages),
    }


def summary(rows: Sequence[Row]) -> str:
    return grouped("arms", groups_of(rows), _columns())


def by_stage(rows: Sequence[Row]) -> str:
    cells = []
    for stage in STAGES:
        some = [row for row in rows if stage in row["stages"]]
        levels = [row["stages"][stage]["level"] for row in some]
        counts = ", ".join(str(levels.count(level)) for level in reversed(LEVELS))
        silent = str(len(silent_wrongs(some, stage)))
        held = [_inside(some, level, stage) for level in reversed(LEVELS)]
        cells.append([stage, str(len(some)), counts, silent, *held])
    header = ["stage", "arms", "good, usable, poor", "silent wrongs"]
    return table([*header, "intervals that hold, good", "usable", "poor"], cells)


NUISANCES = ("delay", "offset", "asymmetry", "viscous_asymmetry", "thermal")


def nuisances(rows: Sequence[Row]) -> str:
    """A row per nuisance that a stage states: how many of its intervals hold, and how
    wrong.

    Arms with a filter are left out: it is no pure delay.
    """
    cells = []
    plain = [r for r in rows if all(x["kind"] != "filter" for x in r["imperfections"])]
    for stage in STAGES:
        for name in NUISANCES:
            some = [
                x
                for row in plain
                for x in row["stages"].get(stage, {}).get("nuisances", ())
                if x["name"] == name
            ]
            if not some:
                continue
            z = np.array(
                [(x["value"] - x["truth"]) / max(x["std_error"], 1e-12) for x in some]
            )
            sizes = [rms(z), float(np.abs(z).max())]
            share = f"{100 * share_within(z, INSIDE):.0f} %"
            cells.append(
                [f"{stage}: {name}", str(len(some)), share, *map(number, sizes)]
            )
    header = ["nuisance", "stated", "intervals that hold", "rms z", "worst z"]
    return table(header, cells) if cells else ""


def kind_of(row: Row) -> str:
    if not row["imperfections"]:
        return "none"
    return " + ".join(
        x["kind"] + ", declared" * x["declared"] for x in row["imperfections"]
    )


def by_kind(rows: Sequence[Row]) -> str:
    """A row per imperfection that is alone, and the clean arms."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if len(row["imperfections"]) < 2:
            groups.setdefault(kind_of(row), []).append(row)
    ordered = dict(
        sorted(groups.items(), key=lambda item: (item[0] != "none", item[0]))
    )
    columns = {
        "arms": lambda some: str(len(some)),
        "good, usable, poor": _levels,
        "friction, inside 95 %": lambda some: _share(some, "friction"),
        "gravity, worst z": lambda some: _worst(some, "gravity"),
        "inertia, worst z": lambda some: _worst(some, "inertia"),
        "simultaneous, worst z": lambda some: _worst(some, "simultaneous"),
        "silent wrongs": lambda some: str(len(silent_wrongs(some))),
        "bands of 95 %": _bands,
    }
    return grouped("imperfection", ordered, columns)


def _share(rows: Sequence[Row], stage: str) -> str:
    z = [x for row in rows for value in values_of(row, stage) for x in value.z]
    return f"{100 * share_within(z, INSIDE):.0f} %" if z else "-"


def _worst(rows: Sequence[Row], stage: str) -> str:
    z = [rms(value.z) for row in rows for value in values_of(row, stage)]
    return number(max(z), 2) if z else "-"


def _bands(rows: Sequence[Row], level: str = "95") -> str:
    joints = [
        j for row in rows for j in row.get("prediction", {}).get("joints", {}).values()
    ]
    shares = [joint["bands"][level] for joint in joints if level in joint["bands"]]
    return f"{100 * float(np.mean(shares)):.0f} %" if shares else "-"


def said(row: Row) -> str:
    """Return in short what the stages say that is not good."""
    parts = [f"{name} failed: {text}" for name, text in row["failed"].items()]
    for name, stage in row["stages"].items():
        if stage["level"] != "good":
            reason = (stage["reasons"] or [""])[0]
            parts.append(f"{name} {stage['level']}: {reason}")
    return "; ".join(parts).replace("|", "/").replace("\n", " ") or "good"


def fixed(rows: Sequence[Row]) -> str:
    """A row per imperfection of the fixed arm, in the order that they are given."""
    cells = []
    for row in rows:
        silent = len(silent_wrongs([row]))
        cells.append(
            [
                row["label"].partition(":")[2],
                _share([row], "friction"),
                _worst([row], "gravity"),
                _worst([row], "inertia"),
                _worst([row], "simultaneous"),
                str(silent),
                said(row),
            ]
        )
    header = [
        "imperfection",
        "friction, inside 95 %",
        "gravity, worst z",
        "inertia, worst z",
    ]
    return table([*header, "simultaneous, worst z", "silent wrongs", "now"], cells)


def tables(rows: Sequence[Row]) -> str:
    parts = [summary(rows), by_stage(rows), by_kind(rows), nuisances(rows)]
    return "\n\n".join(part for part in parts if part)
