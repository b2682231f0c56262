"""The entries of docs/reference/effects.md, from the registry: `python -m
tests.unit.docs.effects`.
"""

import math
import sys
from collections.abc import Iterator
from itertools import product

import numpy as np

from seqid_cli.effects.effect import Effect, Setting
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "effects.md"
# Any geared arm will do: units and names of parameters do not depend on it.
ROBOT = ROOT / "sample_logs" / "six_joint" / "robot.toml"
JOINT = 2
GENERATED = "## All effects"  # from here on the page is the registry's
REMARKS = {  # by what is true of an effect
    "change": (
        "a constant one that was there when the model was identified hides in the"
        " model's own parameters; it shows against an earlier parameter file only; one"
        " that came between two logs is there from log `from_log` on"
    ),
    "wide": "it is looked for above the low-pass cut-off as well",
    "slow": (
        "slow noise of the torque channel looks alike: it counts only where it holds"
        " from one ten-second stretch to the next"
    ),
    "timing": "it shifts torque in time, as a wrong clock does",
}


def rewritten(text: str) -> str:
    robot = load_robot(ROBOT)
    parts = [text.partition(GENERATED)[0] + _overview()]
    for family in dict.fromkeys(effect.family for effect in CATALOGUE.values()):
        parts.append(f"## Family: {family}\n")
        parts += [_entry(e, robot) for e in CATALOGUE.values() if e.family == family]
    return "\n".join(parts)


def _overview() -> str:
    rows = "".join(
        f"| {_links((effect.name,))} | {effect.family} | {_where(effect)} | {title} |\n"
        for effect in CATALOGUE.values()
        for title in [_docstring(effect).splitlines()[0].replace("|", "\\|")]
    )
    return (
        f"{GENERATED}\n\n| name | family | of | what it is |\n|---|---|---|---|\n{rows}"
    )


def _entry(effect: Effect, robot: Robot) -> str:
    facts = [("Of", _where(effect)), ("Parameters", _parameters(effect, robot))]
    if effect.settings:
        facts.append(("Settings", "; ".join(_setting(s) for s in effect.settings)))
    facts += [
        ("Not told apart from", _links(effect.alike)),
        ("To separate", effect.separate_by),
    ]
    if remarks := [text for name, text in REMARKS.items() if getattr(effect, name)]:
        facts.append(("Note", "; ".join(remarks)))
    lines = "".join(f"- **{name}**: {text}\n" for name, text in facts)
    return f"### {effect.name}\n\n{_docstring(effect)}\n\n{lines}"


def _docstring(effect: Effect) -> str:
    return (sys.modules[type(effect).__module__].__doc__ or "").strip()


def _where(effect: Effect) -> str:
    if effect.arm:
        return "the whole arm"
    return "a joint, or all joints alike" if effect.shared else "a joint"


def _links(names: tuple[str, ...]) -> str:
    return ", ".join(f"[{name}](#{name})" for name in names)


def _parameters(effect: Effect, robot: Robot) -> str:
    found: dict[str, str] = {}
    joint = None if effect.arm else JOINT
    for settings in _settings(effect):
        size = len(effect.coefficients(settings))
        for value in effect.values(robot, joint, settings, np.ones(size), np.eye(size)):
            found[value.name] = value.unit
    text = "; ".join(f"`{name}` [{_unit(unit)}]" for name, unit in found.items())
    return text or "none, nothing is fitted"


def _settings(effect: Effect) -> Iterator[dict[str, float]]:
    for values in product(*map(_corners, effect.settings)):
        yield {s.name: value for s, value in zip(effect.settings, values, strict=True)}


def _corners(setting: Setting) -> list[float]:
    ends = [x for x in (setting.low, setting.high) if math.isfinite(x)]
    one = [1.0] if setting.low <= 1.0 <= setting.high else []
    return sorted({*ends, *one, *setting.usual})


def _setting(setting: Setting) -> str:
    ends = (("from", setting.low), ("up to", setting.high))
    limits = " ".join(f"{word} {end:g}" for word, end in ends if math.isfinite(end))
    usual = (
        f"usually {' or '.join(f'{x:g}' for x in setting.usual)}"
        if setting.usual
        else ""
    )
    remarks = ", ".join(part for part in (limits, usual) if part)
    return f"`{setting.name}` [{_unit(setting.unit)}]" + (
        f", {remarks}" if remarks else ""
    )


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
