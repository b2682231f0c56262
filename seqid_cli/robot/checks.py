"""Checks of a robot file beyond its types, apart from those that need the URDF.

A problem names the key's full path. Imports neither numpy nor Pinocchio, so that a
wrong file is reported at once.
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from string import Formatter
from typing import Any, NamedTuple

import msgspec

from seqid_cli.robot import formula
from seqid_cli.robot.toml_schema import (
    EffectEntry,
    ImuEntry,
    Interfaces,
    JointEntry,
    RobotFile,
)

# Keys of [channels] that are of the log as a whole, not of each joint.
_OF_THE_LOG = (
    "time",
    "time_unit",
    "rate",
    "files",
    "topic",
    "namespace",
    "interface",
    "prefix",
    "effort",
    "unit",
    "length_unit",
)
_NAMES = ("topic", "namespace", "prefix")  # of these, names as logs have them
# In SI units: of any constant of a drive, of any number.
SMALLEST, LARGEST = 1e-12, 1e9
LEAST_AXIS = 1e-9  # length of an axis; a shorter one has no direction
LARGEST_TOLERANCE = 0.5  # rad, m: more is no tolerance but another arm
# memory grows with the third power, the time of some checks with the fourth
MOST_JOINTS = 16
FASTEST_HZ = 1e6  # samples per second of a log; drives take 40 000
# Tables that a robot file may have, and accelerometers of one IMU: more than any arm.
_MOST = {"imu": 64, "effect": 256}
_MOST_ACCELEROMETERS = 64

# What each number of a joint is.
_MEANINGS = {
    "torque_constant": (
        "It is the motor-side constant in N m/A; the sign goes to gear_ratio."
    ),
    "torque_constant_error": (
        "It is relative: 0.02 where the constant is known to 2 % (one sigma)."
    ),
    "position_zero_error": "It is the standard error of the joint's zero in rad (m).",
    "gear_ratio": (
        "Motor turns per joint turn; 1 for a direct drive, negative if it turns back."
    ),
    "rotor_inertia": "It is in kg m^2 on the motor side; leave it out to identify it.",
    "winding_resistance": "It is the motor's resistance in ohm, both terminals.",
    "supply_voltage": "It is the voltage in V at a duty cycle of 1.",
    "encoder_resolution": "It is the encoder's step at the joint in rad.",
    "velocity_limit": "It is the largest speed in rad/s.",
}
# From what on and below what its size must be, where not from SMALLEST to LARGEST.
_LIMITS = {
    "torque_constant_error": (0.0, 1.0),
    "position_zero_error": (0.0, 1.0),
    "rotor_inertia": (0.0, LARGEST),
}
# What the motor's data must hold for a log of these channels. A current without them is
# told by the log: a file for logs of several kinds need not have them.
_NEEDED = {
    "voltage": ("torque_constant", "winding_resistance"),
    "pwm": ("torque_constant", "winding_resistance", "supply_voltage"),
}
# What the unit of positions rests on.
_UNIT_DATA = {
    "encoder_resolution": "Give the positions [rad] of one count, at the joint.",
    "position_limits": "Give the positions [rad] at which the log has -100 and 100.",
}
_WORD = re.compile(r"[a-z][a-z0-9_]{0,40}")


class Problem(NamedTuple):
    """What is wrong, and what to do."""

    message: str
    hint: str


def nearest(word: str, known: Iterable[str]) -> str:
    """Offer the known name nearest to a word, in a sentence; empty if none is near."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"Did you mean '{close[0]}'? " if close else ""


def problems(robot: RobotFile) -> Iterator[Problem]:
    """Yield the values that make no sense, by their keys."""
    yield from _text("name", robot.name)
    if robot.urdf is not None:
        yield from _text("urdf", robot.urdf)
    if not 0 < len(robot.joint) <= MOST_JOINTS:
        yield Problem(
            f"the robot has {len(robot.joint) or 'no'} [[joint]] tables",
            "Add one [[joint]] table per actuated joint of one serial arm, up to"
            f" {MOST_JOINTS}.",
        )
    for table, most in _MOST.items():
        count = len(getattr(robot, table))
        if count > most:
            yield Problem(
                f"the robot has {count} [[{table}]] tables", f"Up to {most} are read."
            )
    for k, imu in enumerate(robot.imu):
        count = len(imu.accelerometers)
        if count > _MOST_ACCELEROMETERS:
            yield Problem(
                f"imu[{k}].accelerometers has {count} entries",
                f"Up to {_MOST_ACCELEROMETERS} are read.",
            )
    yield from _numbers("gravity", "", robot.gravity)
    yield from _tolerances(robot)
    for table in ("joint", "imu", "effect"):
        yield from _entries(table, getattr(robot, table))

    joints = [joint.name for joint in robot.joint]
    for k, joint in enumerate(robot.joint):
        yield from _joint(f"joint[{k}]", joint, robot.urdf)
    for k, imu in enumerate(robot.imu):
        yield from _imu(f"imu[{k}]", imu, joints)
    for k, effect in enumerate(robot.effect):
        yield from _effect(f"effect[{k}]", effect, joints)
    yield from _channels(robot)
    yield from _missing_drive_data(robot)
    yield from _missing_unit_data(robot)


def _text(key: str, value: str) -> Iterator[Problem]:
    if not value.strip() or not value.isprintable():
        yield Problem(f"{key} is {value!r}", "Give it a name of printable characters.")


def _numbers(key: str, named: str, value: Any) -> Iterator[Problem]:
    """Yield numbers in a value that are too large or not finite, by their full paths.

    `named`: the table in words, behind the path.
    """
    if isinstance(value, float) and not abs(value) <= LARGEST:
        fault = "not a finite number"
        if math.isfinite(value):
            fault = "which no arm has"
        yield Problem(
            f"{key}{named} is {value:g}, {fault}",
            f"Write a finite number in SI units; up to {LARGEST:g} is read.",
        )
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from _numbers(f"{key}.{name}", named, getattr(value, name))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _numbers(f"{key}[{k}]", named, item)


def _tolerances(robot: RobotFile) -> Iterator[Problem]:
    """Yield standard errors of the arm as a whole that make no sense."""
    errors = {
        "gravity_error": robot.gravity_error,
        "geometry_error.position": robot.geometry_error.position,
        "geometry_error.angle": robot.geometry_error.angle,
    }
    for key, error in errors.items():
        if not 0.0 <= error <= LARGEST_TOLERANCE:
            yield Problem(
                f"{key} must be from 0 to {LARGEST_TOLERANCE:g}, is {error:g}",
                "It is a standard error in rad, that of a position in m.",
            )


def _entries(
    table: str, entries: Sequence[JointEntry | ImuEntry | EffectEntry]
) -> Iterator[Problem]:
    """Yield names that are none or there twice, and numbers that are too large."""
    names = [entry.name for entry in entries]
    for k, entry in enumerate(entries):
        name = entry.name
        yield from _text(f"{table}[{k}].name", name)
        first = names.index(name)
        if first < k:
            yield Problem(
                f"{table}[{k}].name {name!r} is already the name of {table}[{first}]",
                f"Every {table} needs a name of its own.",
            )
        # The limits of an effect's settings have a check of their own.
        if table != "effect":
            yield from _numbers(f"{table}[{k}]", f" ({table} {name!r})", entry)


def _joint(key: str, joint: JointEntry, urdf: str | None) -> Iterator[Problem]:
    named = f" (joint {joint.name!r})"
    if urdf is not None and joint.dh is not None:
        yield Problem(
            f"both urdf and {key}.dh{named} are given",
            "Give the geometry once: a urdf, or dh for every joint.",
        )
    if urdf is None and joint.dh is None:
        yield Problem(
            f"neither urdf nor {key}.dh{named} is given",
            'Give urdf = "...", or dh = { alpha, a, d, theta0 } for every joint.',
        )

    for name, meaning in _MEANINGS.items():
        value = getattr(joint, name)
        if value is None:
            continue
        low, high = _LIMITS.get(name, (SMALLEST, LARGEST))
        # A gear may turn back: its size counts.
        is_signed = name == "gear_ratio"
        size = abs(value) if is_signed else value
        if not low <= size < high:
            must = "its size must" if is_signed else "must"
            yield Problem(
                f"{key}.{name}{named} is {value:g}, {must} be {low:g} or more and below"
                f" {high:g}",
                meaning,
            )

    if joint.position_limits is not None:
        lower, upper = joint.position_limits
        if lower >= upper:
            yield Problem(
                f"{key}.position_limits{named} is [{lower:g}, {upper:g}], not in"
                " ascending order",
                "Write [lower, upper].",
            )


def _imu(key: str, imu: ImuEntry, joints: list[str]) -> Iterator[Problem]:
    named = f"(imu {imu.name!r})"
    if imu.after_joint not in joints:
        offer = nearest(imu.after_joint, joints)
        yield Problem(
            f"{key}.after_joint {named} names no joint: {imu.after_joint!r}",
            f"{offer}The robot's joints: {', '.join(joints)}.",
        )
    if not imu.accelerometers and not imu.gyro:
        yield Problem(
            f"{key} {named} has neither accelerometers nor a gyro",
            "List its accelerometers, or set gyro = true for an ordinary IMU.",
        )
    for k, sensor in enumerate(imu.accelerometers):
        if not math.hypot(*sensor.axis) > LEAST_AXIS:
            yield Problem(
                f"{key}.accelerometers[{k}].axis {named} has no direction:"
                f" {[*sensor.axis]}",
                "Give the direction in which the accelerometer senses.",
            )


def _effect(key: str, effect: EffectEntry, joints: list[str]) -> Iterator[Problem]:
    named = f" (effect {effect.name!r})"
    if _WORD.fullmatch(effect.name) is None:
        yield Problem(
            f"{key}.name is {effect.name!r}", "Use small letters, digits and _."
        )
    if effect.joint is not None and effect.joint not in joints:
        offer = nearest(effect.joint, joints)
        yield Problem(
            f"{key}.joint is {effect.joint!r}, which is no joint{named}",
            f"{offer}Joints: {', '.join(joints)}; or leave it out.",
        )
    for name, (low, high) in effect.settings.items():
        is_free = (
            _WORD.fullmatch(name) is not None
            and formula.symbol_of(name) is None
            and not formula.is_coefficient(name)
        )
        if not is_free or not -math.inf < low < high < math.inf:
            yield Problem(
                f"{key}.settings.{name} is [{low}, {high}]{named}",
                "Write width = [lowest, highest], under a name that no symbol has.",
            )


def _channels(robot: RobotFile) -> Iterator[Problem]:
    """Yield names of columns that are none, or not one for each joint."""
    channels = robot.channels
    if channels.time is not None:
        yield from _text("channels.time", str(channels.time))
    if channels.rate is not None:
        if not 0.0 < channels.rate <= FASTEST_HZ:
            yield Problem(
                f"channels.rate is {channels.rate:g}",
                f"Give the samples per second in Hz, up to {FASTEST_HZ:g}.",
            )
        if channels.time is not None:
            yield Problem(
                "channels.rate and channels.time both say when samples were taken",
                "Leave one of them out.",
            )
    for of_file, name in channels.files.items():
        yield from _text(f"channels.files.{of_file}", name)
        if "/" in name or "\\" in name or name in (".", ".."):
            yield Problem(
                f"channels.files.{of_file} is {name!r}, which is no name of a file",
                "Name a file beside that of the positions, without a folder.",
            )
    for key in _NAMES:
        if getattr(channels, key) is not None:
            yield from _text(f"channels.{key}", getattr(channels, key))
    if channels.prefix is not None and channels.names is not None:
        yield Problem(
            "channels.prefix and channels.names both say how the log names joints",
            "Leave one of them out.",
        )
    if channels.interface is not None:
        yield from _interface(channels.interface)
    for quantity in channels.__struct_fields__:
        key = f"channels.{quantity}"
        names = getattr(channels, quantity)
        if quantity in _OF_THE_LOG or names is None:
            continue
        if isinstance(names, str):
            yield from _pattern(key, names, len(robot.joint))
            continue
        for k, column in enumerate(names):
            yield from _text(f"{key}[{k}]", str(column))
        n_different = len(set(map(str, names)))
        if not n_different == len(names) == len(robot.joint):
            yield Problem(
                f"{key} names {n_different} columns for {len(robot.joint)} joints",
                "List one column for each joint, in the order of the [[joint]] tables.",
            )


def _interface(interface: Interfaces) -> Iterator[Problem]:
    """Yield names of interfaces that are none, or two for one effort."""
    for quantity in interface.__struct_fields__:
        if getattr(interface, quantity) is not None:
            yield from _text(
                f"channels.interface.{quantity}", getattr(interface, quantity)
            )
    if interface.torque is not None and interface.current is not None:
        yield Problem(
            "channels.interface names both a torque and a current",
            "Leave one of them out: torque where both are measured.",
        )


def _pattern(key: str, pattern: str, n_joints: int) -> Iterator[Problem]:
    """Yield faults of a pattern that gives the column of each joint."""
    yield from _text(key, pattern)
    hint = (
        "Write {name}, {index} (from 1) or {index0} (from 0) into it, without format."
    )
    try:
        parts = list(Formatter().parse(pattern))
    except ValueError as problem:
        yield Problem(f"{key} {pattern!r}: {problem}", hint)
        return
    fields = [part for part in parts if part[1] is not None]
    for _, field, form, conversion in fields:
        if field not in ("name", "index", "index0") or form or conversion:
            yield Problem(
                f"{key} {pattern!r} has the unknown placeholder {{{field}}}", hint
            )
    if n_joints > 1 and not fields:
        yield Problem(f"{key} {pattern!r} is the same for all {n_joints} joints", hint)


def _missing_drive_data(robot: RobotFile) -> Iterator[Problem]:
    """Yield drive data that the channels of the log call for and a joint lacks."""
    channels = robot.channels
    kind_by_source = {
        f"channels.{kind}": kind
        for kind in _NEEDED
        if getattr(channels, kind) is not None
    }
    for source, kind in kind_by_source.items():
        for k, joint in enumerate(robot.joint):
            for name in _NEEDED[kind]:
                if getattr(joint, name) is not None:
                    continue
                yield Problem(
                    f"{source} says that the log carries {kind}, but joint[{k}].{name}"
                    f" (joint {joint.name!r}) is missing",
                    f"Add {name} and gear_ratio to that joint. {_MEANINGS[name]}",
                )


def _missing_unit_data(robot: RobotFile) -> Iterator[Problem]:
    """Yield joints without what the unit of their positions rests on."""
    unit = robot.channels.unit
    name = {"count": "encoder_resolution", "percent": "position_limits"}.get(unit)
    if name is None:
        return
    for k, joint in enumerate(robot.joint):
        if getattr(joint, name) is None:
            yield Problem(
                f"channels.unit is {unit!r}, but joint[{k}].{name} (joint"
                f" {joint.name!r}) is missing",
                _UNIT_DATA[name],
            )
