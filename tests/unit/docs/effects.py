"""The catalogue of effects as a page, from the registry: `python -m tests.unit.docs.effects`."""

import math
import sys
from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np

from seqid_cli.model.effects.effect import Effect, Setting
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT

PAGE = ROOT / "docs" / "effects.md"
# Any geared arm will do: units and names of parameters do not depend on it.
ROBOT = ROOT / "sample_logs" / "six_joint" / "robot.toml"
JOINT = 2

INTRODUCTION = """\
# Effects

What `seqid diagnose` looks for and `seqid refine` can add to a model. The page is made from the
catalogue in `seqid_cli/model/effects/` by `python -m tests.unit.docs.effects`. How they are
searched is in [discovery.md](discovery.md), how often they are found in
[effects_study.md](effects_study.md).

An effect is a torque that is added to the model of its joint:

    tau_measured = tau_model + tau_effect.

Symbols, unless an entry says otherwise: `q`, `v` (or `dq`), `ddq` are position, velocity and
acceleration of the joint [rad, rad/s, rad/s^2]; `tau` torques at the joint [N m], positive along
+q; `s(v)` is the direction of motion, -1 to 1, smooth through zero; `t` time [s]; `T` temperature
[degC] or a time constant [s]; `'` a derivative by time. At a sliding joint read m for rad and N for
N m. A setting is a number that the torque is not linear in; it is searched.

*Not told apart from* lists what can look the same whatever the motion. What your own logs do not
tell apart stands in `confusable_with` of the diagnosis, which is decided anew each time. *To
separate* is the text of `separate_by`.
"""

# What joins two effects whatever the motion, by pair.
INSEPARABLE: Mapping[tuple[str, str], str] = {
    ("asymmetric_friction", "torque_bias"): (
        "wherever the joint slides, more friction one way is an offset; held still it carries"
        " anything within its friction, whose middle is shifted alike. Only the part that grows"
        " with the speed differs. Record ten seconds with the brakes on or the motors off"
    ),
    ("torque_bias", "spring"): (
        "an offset is a spring of no stiffness. A spring can be"
        " shown by sweeps over the whole range, an offset by itself cannot"
    ),
    ("load_dependent_friction", "gear_efficiency"): (
        "equal losses both ways are load-dependent friction. Losses that differ by half can be"
        " shown, equal ones cannot; take the simpler name, both predict alike"
    ),
    ("quadratic_drag", "nonlinear_viscous"): (
        "powers of 1.5 to 2.5 differ from a square by a few hundredths of its torque once viscous"
        " friction is free. A cubic or a root can be shown, a square cannot; both predict alike"
    ),
    ("time_skew", "actuator_lag"): (
        "they are the same to first order, and what is left is above the arm's bandwidth. Log the"
        " measured current beside the commanded one. Torque that is early is no lag"
    ),
}

# What a person sees in the residual, and what may be behind it.
SYMPTOMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "wrong at low speed, in the direction of motion",
        ("stribeck", "presliding_hysteresis", "nonlinear_viscous"),
    ),
    (
        "grows with the speed faster or slower than the model",
        ("quadratic_drag", "nonlinear_viscous"),
    ),
    (
        "grows with the load, changes sign with the direction",
        ("load_dependent_friction", "gear_efficiency"),
    ),
    ("grows with the torque, same in both directions", ("torque_constant", "torque_saturation")),
    ("larger in one direction", ("asymmetric_friction", "gear_efficiency", "torque_bias")),
    ("friction falls while the arm warms up", ("thermal_friction", "drift")),
    (
        "changes sign with the direction, its size goes with the position",
        ("position_dependent_friction", "load_dependent_friction", "torque_ripple"),
    ),
    ("friction is another than weeks ago", ("friction_change", "thermal_friction")),
    ("constant, also at rest", ("torque_bias", "payload", "base_tilt")),
    ("creeps over minutes", ("drift", "thermal_friction")),
    ("follows the position slowly, once per turn or less", ("spring", "payload", "base_tilt")),
    ("repeats with the motor's angle", ("torque_ripple", "encoder_eccentricity")),
    ("keeps its frequency, whatever the speed", ("periodic_disturbance",)),
    ("spikes at reversals of the velocity", ("presliding_hysteresis", "stribeck", "time_skew")),
    ("spikes where the load changes its sign", ("backlash",)),
    ("looks like the slope of the torque", ("time_skew", "actuator_lag", "joint_elasticity")),
    ("proportional to the joint's own acceleration", ("rotor_inertia", "payload")),
    ("depends on the speed of a neighbour", ("transmission_coupling", "rotor_inertia")),
    ("a burst in several joints that does not repeat", ("external_contact",)),
)


def page(catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
    """Return the whole page as Markdown."""
    robot = load_robot(ROBOT)
    parts = [INTRODUCTION, _symptoms(catalogue), _inseparable(), _overview(catalogue)]
    families = dict.fromkeys(effect.family for effect in catalogue.values())
    for family in families:
        parts.append(f"## Family: {family}\n")
        parts += [_entry(e, robot) for e in catalogue.values() if e.family == family]
    return "\n".join(parts)


def _symptoms(catalogue: Mapping[str, Effect]) -> str:
    covered = {name for _, names in SYMPTOMS for name in names}
    if covered != set(catalogue):
        odd = ", ".join(sorted(covered ^ set(catalogue)))
        message = f"SYMPTOMS and the catalogue differ by {odd}"
        raise ValueError(message)
    rows = "".join(f"| {seen} | {_links(names)} |\n" for seen, names in SYMPTOMS)
    return (
        "## By what the residual looks like\n\n"
        "A first guess; `seqid diagnose` decides on numbers.\n\n"
        "| residual | look at |\n|---|---|\n" + rows
    )


def _inseparable() -> str:
    """Pairs that stay open, and why."""
    rows = "".join(f"| {_links(pair)} | {why} |\n" for pair, why in INSEPARABLE.items())
    return (
        "## Pairs that no motion settles\n\n"
        "[`seqid plan discriminate`](plan.md#two-effects-apart) says so beforehand: its verdict is"
        " poor, with the chance that is left for either truth.\n\n"
        "| pair | why, and what to record |\n|---|---|\n" + rows
    )


def _overview(catalogue: Mapping[str, Effect]) -> str:
    rows = "".join(
        f"| {_links((effect.name,))} | {effect.family} | {_where(effect)} | {_title(effect)} |\n"
        for effect in catalogue.values()
    )
    return "## All effects\n\n| name | family | of | what it is |\n|---|---|---|---|\n" + rows


def _entry(effect: Effect, robot: Robot) -> str:
    lines = [f"### {effect.name}\n", _docstring(effect) + "\n"]
    facts = [("Of", _where(effect)), ("Parameters", _parameters(effect, robot))]
    if effect.settings:
        facts.append(("Settings", "; ".join(_setting(s) for s in effect.settings)))
    facts.append(("Not told apart from", _links(effect.alike)))
    facts.append(("To separate", effect.separate_by))
    if remarks := "; ".join(_remarks(effect)):
        facts.append(("Note", remarks))
    lines += [f"- **{name}**: {text}" for name, text in facts]
    return "\n".join(lines) + "\n"


def _docstring(effect: Effect) -> str:
    return (sys.modules[type(effect).__module__].__doc__ or "").strip()


def _title(effect: Effect) -> str:
    return _docstring(effect).splitlines()[0].replace("|", "\\|")


def _where(effect: Effect) -> str:
    if effect.arm:
        return "the whole arm"
    return "a joint, or all joints alike" if effect.shared else "a joint"


def _links(names: tuple[str, ...]) -> str:
    return ", ".join(f"[{name}](#{name})" for name in names)


def _parameters(effect: Effect, robot: Robot) -> str:
    """Every parameter that some setting brings, with its unit at a revolute joint."""
    found: dict[str, str] = {}
    joint = None if effect.arm else JOINT
    for settings in _settings(effect):
        size = len(effect.coefficients(settings))
        for value in effect.values(robot, joint, settings, np.ones(size), np.eye(size)):
            found[value.name] = value.unit
    text = "; ".join(f"`{name}` [{_unit(unit)}]" for name, unit in found.items())
    return text or "none, nothing is fitted"


def _settings(effect: Effect) -> Iterator[dict[str, float]]:
    axes = [_corners(setting) for setting in effect.settings]
    for values in product(*axes):
        yield {s.name: value for s, value in zip(effect.settings, values, strict=True)}


def _corners(setting: Setting) -> list[float]:
    ends = [x for x in (setting.low, setting.high) if math.isfinite(x)]
    one = [1.0] if setting.low <= 1.0 <= setting.high else []
    return sorted({*ends, *one, *setting.usual})


def _setting(setting: Setting) -> str:
    ends = [_end(setting.low, "from"), _end(setting.high, "up to")]
    limits = " ".join(end for end in ends if end)
    usual = f"usually {' or '.join(f'{x:g}' for x in setting.usual)}" if setting.usual else ""
    remarks = ", ".join(part for part in (limits, usual) if part)
    return f"`{setting.name}` [{_unit(setting.unit)}]" + (f", {remarks}" if remarks else "")


def _end(limit: float, word: str) -> str:
    return f"{word} {limit:g}" if math.isfinite(limit) else ""


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit


def _remarks(effect: Effect) -> Iterator[str]:
    if effect.change:
        yield (
            "a constant one that was there when the model was identified hides in the model's own"
            " parameters; it shows against an earlier parameter file only"
        )
    if effect.wide:
        yield "it is looked for above the low-pass cut-off as well"
    if effect.slow:
        yield (
            "slow noise of the torque channel looks alike: it counts only where it holds from one"
            " ten-second stretch to the next"
        )
    if effect.timing:
        yield "it shifts torque in time, as a wrong clock does"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
