"""Checks of a robot file beyond its types; every message names the key's full path."""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from string import Formatter
from typing import Any

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.robot.formula import (
    SYMBOLS,
    Formula,
    FormulaError,
    is_coefficient,
    parse_formula,
    symbol_of,
)
from seqid_cli.robot.toml.schema import Channels, EffectEntry, ImuEntry, JointEntry, RobotFile

_Problem = tuple[str, str]  # fault, hint
_Rule = tuple[Callable[[float], bool], str]  # what a number must be, and that in words
_OF_THE_LOG = ("time", "effort", "unit", "length_unit")  # not of each joint
JOINT_CHANNELS = [n for n in Channels.__struct_fields__ if n not in _OF_THE_LOG]
SMALLEST, LARGEST = 1e-12, 1e9  # in SI units, of any constant of a drive, of any number
LEAST_AXIS = 1e-9  # length of an axis; a shorter one has no direction
MOST_JOINTS = 16  # memory grows with the third power, the time of some checks with the fourth

_POSITIVE: _Rule = (lambda x: x > 0.0, "above 0")
_NOT_TINY: _Rule = (lambda x: not 0.0 < abs(x) < SMALLEST, f"{SMALLEST:g} or more")
# What each number of a joint must be, and is, for hints.
_NUMBERS: Mapping[str, tuple[tuple[_Rule, ...], str]] = {
    "torque_constant": (
        (_POSITIVE, _NOT_TINY),
        "It is the motor-side constant in N m/A; the sign goes to gear_ratio.",
    ),
    "torque_constant_error": (
        ((lambda x: 0.0 <= x < 1.0, "at least 0 and below 1"),),
        "It is relative: 0.02 where the constant is known to 2 % (one sigma).",
    ),
    "gear_ratio": (
        ((lambda x: x != 0.0, "other than 0"), _NOT_TINY),
        "Motor turns per joint turn; 1 for a direct drive, negative if it turns back.",
    ),
    "rotor_inertia": (
        ((lambda x: x >= 0.0, "0 or more"),),
        "It is in kg m^2 on the motor side; leave it out to identify it.",
    ),
    "winding_resistance": (
        (_POSITIVE, _NOT_TINY),
        "It is the motor's resistance in ohm, both terminals.",
    ),
    "supply_voltage": ((_POSITIVE, _NOT_TINY), "It is the voltage in V at a duty cycle of 1."),
    "encoder_resolution": (
        (_POSITIVE, _NOT_TINY),
        "It is the encoder's step at the joint in rad.",
    ),
    "velocity_limit": ((_POSITIVE, _NOT_TINY), "It is the largest speed in rad/s."),
}
# What the motor's data must hold for a log of these channels.
_NEEDED = {
    "current": ("torque_constant",),
    "voltage": ("torque_constant", "winding_resistance"),
    "pwm": ("torque_constant", "winding_resistance", "supply_voltage"),
}
_WORD = re.compile(r"[a-z][a-z0-9_]{0,40}")


def nearest(word: str, known: Iterable[str]) -> str:
    """Offer the known name nearest to `word` in a sentence, empty where none is near."""
    found = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"Did you mean '{found[0]}'? " if found else ""


def check_content(path: Path, robot: RobotFile) -> tuple[Formula | None, ...]:
    """Check the values of a robot file, apart from checks that need its URDF.

    Returns the formula of each effect; None where an installed package offers the effect. Raises
    ConfigError: a value makes no sense; the message names `path` and the key.
    """
    for message, hint in _problems(robot):
        raise ConfigError(message, where=str(path), hint=hint)
    formulas: list[Formula | None] = []
    for k, effect in enumerate(robot.effect):
        known = None
        try:
            if effect.torque is not None:
                known = parse_formula(effect.torque, len(robot.joint), effect.settings)
        except FormulaError as problem:
            message = f"effect[{k}].torque {problem} (effect {effect.name!r})"
            terms = f"'c1 * sign(dq) * abs(load)'; of {', '.join(SYMBOLS)}"
            hint = f"Write a sum of terms as in {terms}."
            raise ConfigError(message, where=str(path), hint=hint) from None
        formulas.append(known)
    return tuple(formulas)


def _problems(robot: RobotFile) -> Iterator[_Problem]:
    yield from _text("name", robot.name)
    if not robot.joint:
        yield "the robot has no [[joint]]", "Add one [[joint]] table per actuated joint."
    if len(robot.joint) > MOST_JOINTS:
        hint = f"Name the joints of one serial arm; up to {MOST_JOINTS} are read."
        yield f"the robot has {len(robot.joint)} [[joint]] tables", hint
    for table in ("joint", "imu", "effect"):
        names = [entry.name for entry in getattr(robot, table)]
        for k, name in enumerate(names):
            yield from _text(f"{table}[{k}].name", name)
            first = names.index(name)
            if first < k:
                hint = f"Every {table} needs a name of its own."
                yield f"{table}[{k}].name {name!r} is already the name of {table}[{first}]", hint
    tables: list[tuple[str, str, Any]] = [("", "gravity", robot.gravity)]
    tables += [(f" (joint {j.name!r})", f"joint[{k}]", j) for k, j in enumerate(robot.joint)]
    tables += [(f" (imu {i.name!r})", f"imu[{k}]", i) for k, i in enumerate(robot.imu)]
    for named, key, value in tables:
        for place, number in _numbers(key, value):
            if not math.isfinite(number):
                hint = "Write a finite number."
                yield f"{place}{named} is {number}, not a finite number", hint
            if abs(number) > LARGEST:
                hint = f"Write it in SI units; up to {LARGEST:g} is read."
                yield f"{place}{named} is {number:g}, which no arm has", hint
    for k, joint in enumerate(robot.joint):
        named = f"joint[{k}].dh (joint {joint.name!r})"
        if robot.urdf is not None and joint.dh is not None:
            hint = "Give the geometry once: a urdf, or dh for every joint."
            yield f"both urdf and {named} are given", hint
        if robot.urdf is None and joint.dh is None:
            hint = 'Give urdf = "...", or dh = { alpha, a, d, theta0 } for every joint.'
            yield f"neither urdf nor {named} is given", hint
    yield from _text("urdf", "." if robot.urdf is None else robot.urdf)
    names = [joint.name for joint in robot.joint]
    for k, joint in enumerate(robot.joint):
        yield from _joint(f"joint[{k}]", joint)
    for k, imu in enumerate(robot.imu):
        yield from _imu(f"imu[{k}]", imu, names)
    for k, effect in enumerate(robot.effect):
        yield from _effect(f"effect[{k}]", effect, names)
    yield from _channels(robot)


def _numbers(key: str, value: Any) -> Iterator[tuple[str, float]]:
    """All numbers in a table, each with its key's full path."""
    if isinstance(value, float):
        yield key, value
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from _numbers(f"{key}.{name}", getattr(value, name))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _numbers(f"{key}[{k}]", item)


def _text(key: str, value: str) -> Iterator[_Problem]:
    if not value.strip() or not value.isprintable():
        yield f"{key} is {value!r}", "Give it a name of printable characters."


def _joint(key: str, joint: JointEntry) -> Iterator[_Problem]:
    named = f" (joint {joint.name!r})"
    for name, (rules, hint) in _NUMBERS.items():
        value = getattr(joint, name)
        for holds, said in rules if value is not None else ():
            if not holds(value):
                yield f"{key}.{name}{named} is {value:g}, must be {said}", hint
    low, high = joint.position_limits or (0.0, 1.0)
    if low >= high:
        text = f"{key}.position_limits{named} is [{low:g}, {high:g}], not in ascending order"
        yield text, "Write [lower, upper]."


def _imu(key: str, imu: ImuEntry, joints: list[str]) -> Iterator[_Problem]:
    named = f"(imu {imu.name!r})"
    if imu.after_joint not in joints:
        hint = f"{nearest(imu.after_joint, joints)}The robot's joints: {', '.join(joints)}."
        yield f"{key}.after_joint {named} names no joint: {imu.after_joint!r}", hint
    if not imu.accelerometers and not imu.gyro:
        hint = "List its accelerometers, or set gyro = true for an ordinary IMU."
        yield f"{key} {named} has neither accelerometers nor a gyro", hint
    for k, sensor in enumerate(imu.accelerometers):
        if not math.hypot(*sensor.axis) > LEAST_AXIS:
            text = f"{key}.accelerometers[{k}].axis {named} has no direction: {[*sensor.axis]}"
            yield text, "Give the direction in which the accelerometer senses."


def _effect(key: str, effect: EffectEntry, joints: list[str]) -> Iterator[_Problem]:
    named = f" (effect {effect.name!r})"
    if _WORD.fullmatch(effect.name) is None:
        yield f"{key}.name is {effect.name!r}", "Use small letters, digits and _."
    if effect.joint is not None and effect.joint not in joints:
        hint = f"{nearest(effect.joint, joints)}Joints: {', '.join(joints)}; or leave it out."
        yield f"{key}.joint is {effect.joint!r}, which is no joint{named}", hint
    for name, (low, high) in effect.settings.items():
        taken = symbol_of(name) or is_coefficient(name) or not _WORD.fullmatch(name)
        if taken or not -math.inf < low < high < math.inf:
            hint = "Write width = [lowest, highest], under a name that no symbol has."
            yield f"{key}.settings.{name} is [{low}, {high}]{named}", hint


def _channels(robot: RobotFile) -> Iterator[_Problem]:
    channels = robot.channels
    yield from _text("channels.time", "t" if channels.time is None else str(channels.time))
    for kind in JOINT_CHANNELS:
        names = getattr(channels, kind)
        if isinstance(names, str):
            yield from _pattern(f"channels.{kind}", names, len(robot.joint))
        elif names is not None:
            key, columns = f"channels.{kind}", [str(name) for name in names]
            for k, column in enumerate(columns):
                yield from _text(f"{key}[{k}]", column)
            if not len(set(columns)) == len(columns) == len(robot.joint):
                hint = "List one column for each joint, in the order of the [[joint]] tables."
                yield f"{key} names {len(set(columns))} columns for {len(robot.joint)} joints", hint
    said = {f"channels.{name}": name for name in _NEEDED if getattr(channels, name) is not None}
    if channels.effort == "current":
        said["channels.effort"] = "current"
    for source, kind in said.items():
        for k, joint in enumerate(robot.joint):
            for name in _NEEDED[kind]:
                if getattr(joint, name) is None:
                    yield (
                        f"{source} says that the log carries {kind}, but joint[{k}].{name} "
                        f"(joint {joint.name!r}) is missing",
                        f"Add {name} and gear_ratio to that joint. {_NUMBERS[name][1]}",
                    )


def _pattern(key: str, pattern: str, joints: int) -> Iterator[_Problem]:
    yield from _text(key, pattern)
    try:
        parts = [part[1:] for part in Formatter().parse(pattern) if part[1] is not None]
    except ValueError as problem:
        yield f"{key} {pattern!r}: {problem}", "Write {name}, {index} or {index0}."
        return
    for field, spec, conversion in parts:
        if field not in ("name", "index", "index0") or spec or conversion:
            hint = "Write {name}, {index} (from 1) or {index0} (from 0), without format."
            yield f"{key} {pattern!r} has the unknown placeholder {{{field}}}", hint
    if joints > 1 and not parts:
        hint = "Put {name}, {index} (from 1) or {index0} (from 0) into it."
        yield f"{key} {pattern!r} is the same for all {joints} joints", hint
