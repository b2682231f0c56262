"""Reading `robot.toml` and the URDF it names: every failure names file and full path of the key.

Checks beyond the types stand here as well. Imports neither numpy nor Pinocchio, so that
a wrong file is reported at once.
"""

import difflib
import glob
import math
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from string import Formatter
from typing import Any, cast

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.robot import formula, toml_schema
from seqid_cli.robot.toml_schema import (
    SCHEMA,
    EffectEntry,
    ImuEntry,
    JointEntry,
    RobotFile,
)

Problem = tuple[str, str]  # fault, hint
_OF_THE_LOG = ("time", "effort", "unit", "length_unit")  # not of each joint
SMALLEST, LARGEST = 1e-12, 1e9  # in SI units, of any constant of a drive, of any number
LEAST_AXIS = 1e-9  # length of an axis; a shorter one has no direction
# memory grows with the third power, the time of some checks with the fourth
MOST_JOINTS = 16

# What each number of a joint is, and from what on and below what its size must be.
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
_LIMITS = {
    "torque_constant_error": (0.0, 1.0),
    "position_zero_error": (0.0, 1.0),
    "rotor_inertia": (0.0, LARGEST),
}
LARGEST_TOLERANCE = 0.5  # rad, m: more is no tolerance but another arm
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


def problems(robot: RobotFile) -> Iterator[Problem]:
    """Say which values make no sense, by their keys, apart from checks that need the URDF."""
    yield from _text("name", robot.name)
    yield from _text("urdf", "." if robot.urdf is None else robot.urdf)
    if not 0 < len(robot.joint) <= MOST_JOINTS:
        hint = (
            "Add one [[joint]] table per actuated joint of one serial arm, up to"
            f" {MOST_JOINTS}."
        )
        yield f"the robot has {len(robot.joint) or 'no'} [[joint]] tables", hint
    yield from _numbers("gravity", "", robot.gravity)
    yield from _tolerances(robot)
    for table in ("joint", "imu", "effect"):
        names = [entry.name for entry in getattr(robot, table)]
        for k, (name, entry) in enumerate(
            zip(names, getattr(robot, table), strict=True)
        ):
            yield from _text(f"{table}[{k}].name", name)
            if names.index(name) < k:
                first, hint = (
                    names.index(name),
                    f"Every {table} needs a name of its own.",
                )
                yield (
                    (
                        f"{table}[{k}].name {name!r} is already the name of"
                        f" {table}[{first}]"
                    ),
                    hint,
                )
            if table != "effect":
                yield from _numbers(f"{table}[{k}]", f" ({table} {name!r})", entry)
    joints = [joint.name for joint in robot.joint]
    for k, joint in enumerate(robot.joint):
        yield from _joint(f"joint[{k}]", joint, robot.urdf)
    for k, imu in enumerate(robot.imu):
        yield from _imu(f"imu[{k}]", imu, joints)
    for k, effect in enumerate(robot.effect):
        yield from _effect(f"effect[{k}]", effect, joints)
    yield from _channels(robot)


def _numbers(key: str, named: str, value: Any) -> Iterator[Problem]:
    """Numbers in a table, each with its key's full path, that are too large or not finite."""
    if isinstance(value, float) and not abs(value) <= LARGEST:
        fault = (
            ", which no arm has" if math.isfinite(value) else ", not a finite number"
        )
        hint = f"Write a finite number in SI units; up to {LARGEST:g} is read."
        yield f"{key}{named} is {value:g}{fault}", hint
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from _numbers(f"{key}.{name}", named, getattr(value, name))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _numbers(f"{key}[{k}]", named, item)


def _text(key: str, value: str) -> Iterator[Problem]:
    if not value.strip() or not value.isprintable():
        yield f"{key} is {value!r}", "Give it a name of printable characters."


def _tolerances(robot: RobotFile) -> Iterator[Problem]:
    """Say which standard errors of the arm as a whole make no sense."""
    sizes = {
        "gravity_error": robot.gravity_error,
        "geometry_error.position": robot.geometry_error.position,
        "geometry_error.angle": robot.geometry_error.angle,
    }
    for key, size in sizes.items():
        if not 0.0 <= size <= LARGEST_TOLERANCE:
            message = f"{key} must be from 0 to {LARGEST_TOLERANCE:g}, is {size:g}"
            yield message, "It is a standard error in rad, that of a position in m."


def _joint(key: str, joint: JointEntry, urdf: str | None) -> Iterator[Problem]:
    named = f" (joint {joint.name!r})"
    if urdf is not None and joint.dh is not None:
        hint = "Give the geometry once: a urdf, or dh for every joint."
        yield f"both urdf and {key}.dh{named} are given", hint
    if urdf is None and joint.dh is None:
        hint = 'Give urdf = "...", or dh = { alpha, a, d, theta0 } for every joint.'
        yield f"neither urdf nor {key}.dh{named} is given", hint
    for name, hint in _MEANINGS.items():
        value, (low, high) = (
            getattr(joint, name),
            _LIMITS.get(name, (SMALLEST, LARGEST)),
        )
        if (
            value is not None
            and not low <= (abs(value) if name == "gear_ratio" else value) < high
        ):
            size = "its size must" if name == "gear_ratio" else "must"
            limits = f"{size} be {low:g} or more and below {high:g}"
            yield f"{key}.{name}{named} is {value:g}, {limits}", hint
    low, high = joint.position_limits or (0.0, 1.0)
    if low >= high:
        text = (
            f"{key}.position_limits{named} is [{low:g}, {high:g}], not in ascending"
            " order"
        )
        yield text, "Write [lower, upper]."


def _imu(key: str, imu: ImuEntry, joints: list[str]) -> Iterator[Problem]:
    named = f"(imu {imu.name!r})"
    if imu.after_joint not in joints:
        hint = (
            f"{nearest(imu.after_joint, joints)}The robot's joints:"
            f" {', '.join(joints)}."
        )
        yield f"{key}.after_joint {named} names no joint: {imu.after_joint!r}", hint
    if not imu.accelerometers and not imu.gyro:
        hint = "List its accelerometers, or set gyro = true for an ordinary IMU."
        yield f"{key} {named} has neither accelerometers nor a gyro", hint
    for k, sensor in enumerate(imu.accelerometers):
        if not math.hypot(*sensor.axis) > LEAST_AXIS:
            text = (
                f"{key}.accelerometers[{k}].axis {named} has no direction:"
                f" {[*sensor.axis]}"
            )
            yield text, "Give the direction in which the accelerometer senses."


def _effect(key: str, effect: EffectEntry, joints: list[str]) -> Iterator[Problem]:
    named = f" (effect {effect.name!r})"
    if _WORD.fullmatch(effect.name) is None:
        yield f"{key}.name is {effect.name!r}", "Use small letters, digits and _."
    if effect.joint is not None and effect.joint not in joints:
        hint = (
            f"{nearest(effect.joint, joints)}Joints: {', '.join(joints)}; or leave it"
            " out."
        )
        yield f"{key}.joint is {effect.joint!r}, which is no joint{named}", hint
    for name, (low, high) in effect.settings.items():
        taken = (
            formula.symbol_of(name)
            or formula.is_coefficient(name)
            or not _WORD.fullmatch(name)
        )
        if taken or not -math.inf < low < high < math.inf:
            hint = "Write width = [lowest, highest], under a name that no symbol has."
            yield f"{key}.settings.{name} is [{low}, {high}]{named}", hint


def _channels(robot: RobotFile) -> Iterator[Problem]:
    channels = robot.channels
    yield from _text(
        "channels.time", "t" if channels.time is None else str(channels.time)
    )
    for kind in channels.__struct_fields__:
        key, names = f"channels.{kind}", getattr(channels, kind)
        if kind in _OF_THE_LOG or names is None:
            continue
        if isinstance(names, str):
            yield from _pattern(key, names, len(robot.joint))
            continue
        for k, column in enumerate(names):
            yield from _text(f"{key}[{k}]", str(column))
        different = len(set(map(str, names)))
        if not different == len(names) == len(robot.joint):
            hint = (
                "List one column for each joint, in the order of the [[joint]] tables."
            )
            yield f"{key} names {different} columns for {len(robot.joint)} joints", hint
    said = {
        f"channels.{kind}": kind
        for kind in _NEEDED
        if getattr(channels, kind) is not None
    }
    if channels.effort == "current":
        said["channels.effort"] = "current"
    for source, kind in said.items():
        for k, joint in enumerate(robot.joint):
            for name in (
                name for name in _NEEDED[kind] if getattr(joint, name) is None
            ):
                text = (
                    f"{source} says that the log carries {kind}, but joint[{k}].{name}"
                )
                hint = f"Add {name} and gear_ratio to that joint. {_MEANINGS[name]}"
                yield f"{text} (joint {joint.name!r}) is missing", hint


def _pattern(key: str, pattern: str, joints: int) -> Iterator[Problem]:
    yield from _text(key, pattern)
    hint = (
        "Write {name}, {index} (from 1) or {index0} (from 0) into it, without format."
    )
    try:
        parts = [part[1:] for part in Formatter().parse(pattern) if part[1] is not None]
    except ValueError as problem:
        yield f"{key} {pattern!r}: {problem}", hint
        return
    for field, spec, conversion in parts:
        if field not in ("name", "index", "index0") or spec or conversion:
            yield f"{key} {pattern!r} has the unknown placeholder {{{field}}}", hint
    if joints > 1 and not parts:
        yield f"{key} {pattern!r} is the same for all {joints} joints", hint


SIZE_LIMIT, URDF_LIMIT = 4 * 2**20, 64 * 2**20  # bytes
MOST_PARTS = 32  # of a dotted key
_PART = r"(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')"
_DEEP_KEY = re.compile(
    rf"(?<![\w\-\"'.]){_PART}(?:[ \t]*\.[ \t]*{_PART}){{{MOST_PARTS}}}"
)


# None where an installed package offers the effect
Formulas = list[formula.Formula | None]


def read_robot_file(path: Path) -> tuple[RobotFile, Formulas, bytes, bytes | None]:
    """Read a robot file and check all that needs neither a URDF nor geometry.

    Returns its content, the formulas of its effects, its bytes and those of the URDF
    beside it. Raises ConfigError naming the file and the key's full path.
    """
    raw = read_limited(path, "robot file", SIZE_LIMIT)
    document = _parse(path, raw)
    schema, hint = (
        document.get("schema"),
        f'Write schema = "{SCHEMA}" in the first line.',
    )
    match = re.fullmatch(r"seqid/robot@([1-9][0-9]{0,5})", str(schema))
    if match is None:
        message = f"schema is {schema!r}, not {SCHEMA!r}"
        message = "the key 'schema' is missing" if schema is None else message
        raise ConfigError(message, where=str(path), hint=hint)
    if int(match[1]) > toml_schema.SCHEMA_VERSION:
        message = f"schema {schema!r} is newer than this seqid knows ({SCHEMA!r})"
        raise ConfigError(message, where=str(path), hint="Update seqid.")
    try:
        content = msgspec.convert(document, RobotFile)
    except msgspec.ValidationError as problem:
        raise _explained(path, document, problem) from None
    except (OverflowError, RecursionError):
        message, hint = (
            "a number is too large or the nesting too deep",
            "Correct the value.",
        )
        raise ConfigError(message, where=str(path), hint=hint) from None
    for message, hint in problems(content):
        raise ConfigError(message, where=str(path), hint=hint)
    formulas = Formulas()
    for k, effect in enumerate(content.effect):
        text, given = effect.torque, (len(content.joint), effect.settings)
        try:
            formulas.append(
                None if text is None else formula.parse_formula(text, *given)
            )
        except formula.FormulaError as problem:
            message = f"effect[{k}].torque {problem} (effect {effect.name!r})"
            sums = "Write a sum of terms as in 'c1 * sign(dq) * abs(load)'"
            hint = f"{sums}; of {', '.join(formula.SYMBOLS)}."
            raise ConfigError(message, where=str(path), hint=hint) from None
    if content.urdf is None:
        return content, formulas, raw, None
    return (
        content,
        formulas,
        raw,
        read_limited(path.parent / content.urdf, "URDF", URDF_LIMIT),
    )


def read_limited(path: Path, what: str, limit: int) -> bytes:
    """Read a file, called `what` in messages; ConfigError if it cannot, or is over `limit`."""
    where = str(path)
    try:
        if path.is_dir():
            raise ConfigError(
                f"the {what} is a folder", where=where, hint="Name the file in it."
            )
        # a pipe would be waited for without end
        if path.exists() and not path.is_file():
            raise ConfigError(f"the {what} is not a regular file", where=where)
        with path.open("rb") as file:
            raw = file.read(limit + 1)
    except FileNotFoundError:
        names = sorted(
            other.name for other in path.parent.glob(f"*{glob.escape(path.suffix)}")
        )
        hint = (
            f"In {path.parent} there is:"
            f" {', '.join(names[:10]) or f'no *{path.suffix} file'}."
        )
        raise ConfigError(f"{what} not found", where=where, hint=hint) from None
    except (OSError, ValueError) as problem:
        raise ConfigError(
            f"the {what} cannot be read: {problem}", where=where
        ) from None
    if len(raw) > limit:
        message = f"the {what} is larger than {limit} bytes"
        raise ConfigError(message, where=where, hint=f"Is this really a {what}?")
    return raw


def _parse(path: Path, raw: bytes) -> dict[str, object]:
    try:
        text = raw.decode("utf-8")
        # each part is a table, and the parser keeps the way to each
        if not _DEEP_KEY.search(text):
            return tomllib.loads(text)
        message, hint = (
            f"a key has more than {MOST_PARTS} parts",
            "Write tables by their names.",
        )
    except UnicodeDecodeError as problem:
        line = raw.count(b"\n", 0, problem.start) + 1
        message = f"line {line} is not UTF-8 text"
        hint = "A robot file is plain text in UTF-8; save it so."
    except (RecursionError, ValueError) as problem:
        message, hint = (
            f"not valid TOML: {problem}",
            "Correct that line, nesting or number.",
        )
        if raw.lstrip().startswith(b"<"):
            message = "this is XML, as a URDF is, not a robot file"
            hint = f"Make one that names it: seqid init LOG --urdf {path} -o robot.toml"
    raise ConfigError(message, where=str(path), hint=hint)


_AT = re.compile(r"^(?P<what>.*?)(?: - at `\$\.?(?P<path>.*)`)?$", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<key>.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(?P<key>.*)`", re.DOTALL)


def _explained(
    path: Path, document: dict[str, object], problem: msgspec.ValidationError
) -> ConfigError:
    """Turn msgspec's message into one with the key's full path and the nearest known key."""
    match = cast("re.Match[str]", _AT.match(str(problem)))
    what, at = match["what"], match["path"] or ""
    prefix = f"{at}." if at else ""
    if unknown := _UNKNOWN.match(what):
        known = toml_schema.TABLES.get(
            re.sub(r"\[[^\]]*\]", "", at), RobotFile
        ).__struct_fields__
        hint = f"{nearest(unknown['key'], known)}Known here: {', '.join(known)}."
        message = f"unknown key '{prefix}{unknown['key']}'"
    elif missing := _MISSING.match(what):
        message = f"the key '{prefix}{missing['key']}' is missing"
        hint = f"Add {missing['key']} = ..."
    else:
        message = f"{at or 'the document'}: {what[:1].lower()}{what[1:]}".replace(
            "`", "'"
        )
        hint = "Correct the value."
    owner = re.match(r"(joint|imu|effect)\[(\d+)\]", at)
    if owner is not None:  # points into a table that may have a name
        entry = cast("list[dict[str, object]]", document[owner[1]])[int(owner[2])]
        name = entry.get("name") if isinstance(entry, dict) else None
        message += f" ({owner[1]} {name!r})" if isinstance(name, str) else ""
    return ConfigError(message, where=str(path), hint=hint)
