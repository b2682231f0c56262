"""Checks of a robot file beyond its types; every message names the key's full path."""

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import NoReturn

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

PATTERN_FIELDS = frozenset({"name", "index", "index0"})
JOINT_CHANNELS = [n for n in Channels.__struct_fields__ if n not in ("time", "effort", "unit")]

_MEANING = {  # what each number of a joint is, for hints
    "torque_constant": "It is the motor-side constant in N m/A; the sign goes to gear_ratio.",
    "torque_constant_error": "It is relative: 0.02 where the constant is known to 2 % (one sigma).",
    "gear_ratio": "Motor turns per joint turn; 1 for a direct drive, negative if it turns back.",
    "rotor_inertia": "It is in kg m^2 on the motor side; leave it out to identify it.",
    "winding_resistance": "It is the motor's resistance in ohm, both terminals.",
    "supply_voltage": "It is the voltage in V at a duty cycle of 1.",
    "encoder_resolution": "It is the encoder's step at the joint in rad.",
    "velocity_limit": "It is the largest speed in rad/s.",
}
_POSITIVE = (
    "torque_constant",
    "winding_resistance",
    "supply_voltage",
    "encoder_resolution",
    "velocity_limit",
)
# What the motor's data must hold for a log of these channels.
_NEEDED = {
    "current": ("torque_constant",),
    "voltage": ("torque_constant", "winding_resistance"),
    "pwm": ("torque_constant", "winding_resistance", "supply_voltage"),
}
SMALLEST, LARGEST = 1e-12, 1e9  # in SI units, of any constant of a drive, of any number
LEAST_AXIS = 1e-9  # length of an axis; a shorter one has no direction
MOST_JOINTS = 16  # memory grows with the third power, the time of some checks with the fourth


_WORD = re.compile(r"[a-z][a-z0-9_]{0,40}")


def nearest(word: str, known: Iterable[str]) -> str:
    """Offer the known name nearest to `word` in a sentence, empty where none is near."""
    found = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"Did you mean '{found[0]}'? " if found else ""


def check_content(path: Path, robot: RobotFile) -> tuple[Formula | None, ...]:
    """Check the values of a robot file, apart from checks that need its URDF.

    Returns: that of each effect; None where an installed package offers the effect. Raises
    ConfigError: a value makes no sense; the message names `path` and the key.
    """
    return _Checks(path).document(robot)


@dataclass(frozen=True)
class _Checks:
    """The checks of one file."""

    path: Path

    def fail(self, message: str, hint: str) -> NoReturn:
        raise ConfigError(message, where=str(self.path), hint=hint)

    def document(self, robot: RobotFile) -> tuple[Formula | None, ...]:
        self.text("name", robot.name)
        for k, value in enumerate(robot.gravity):
            self.finite(f"gravity[{k}]", value)
        if not robot.joint:
            self.fail("the robot has no [[joint]]", "Add one [[joint]] table per actuated joint.")
        if len(robot.joint) > MOST_JOINTS:
            hint = f"Name the joints of one serial arm; up to {MOST_JOINTS} are read."
            self.fail(f"the robot has {len(robot.joint)} [[joint]] tables", hint)
        self.unique("joint", [joint.name for joint in robot.joint])
        self.unique("imu", [imu.name for imu in robot.imu])
        self.geometry(robot)
        for k, joint in enumerate(robot.joint):
            self.joint(f"joint[{k}]", joint)
        for k, imu in enumerate(robot.imu):
            self.imu(f"imu[{k}]", imu, [joint.name for joint in robot.joint])
        self.unique("effect", [effect.name for effect in robot.effect])
        names = [joint.name for joint in robot.joint]
        formulas = [self.effect(f"effect[{k}]", e, names) for k, e in enumerate(robot.effect)]
        self.channels(robot)
        return tuple(formulas)

    def effect(self, key: str, effect: EffectEntry, joints: list[str]) -> Formula | None:
        named = f" (effect {effect.name!r})"
        if _WORD.fullmatch(effect.name) is None:
            self.fail(f"{key}.name is {effect.name!r}", "Use small letters, digits and _.")
        if effect.joint is not None and effect.joint not in joints:
            hint = f"{nearest(effect.joint, joints)}Joints: {', '.join(joints)}; or leave it out."
            self.fail(f"{key}.joint is {effect.joint!r}, which is no joint{named}", hint)
        for name, (low, high) in effect.settings.items():
            taken = symbol_of(name) or is_coefficient(name) or not _WORD.fullmatch(name)
            if taken or not -math.inf < low < high < math.inf:
                hint = "Write width = [lowest, highest], under a name that no symbol has."
                self.fail(f"{key}.settings.{name} is [{low}, {high}]{named}", hint)
        if effect.torque is None:
            return None
        try:
            return parse_formula(effect.torque, len(joints), effect.settings)
        except FormulaError as problem:
            hint = (
                f"Write a sum of terms as in 'c1 * sign(dq) * abs(load)'; of {', '.join(SYMBOLS)}."
            )
            self.fail(f"{key}.torque {problem}{named}", hint)

    def text(self, key: str, value: str) -> None:
        if not value.strip() or not value.isprintable():
            self.fail(f"{key} is {value!r}", "Give it a name of printable characters.")

    def finite(self, key: str, value: float) -> None:
        if not math.isfinite(value):
            self.fail(f"{key} is {value}, not a finite number", "Write a finite number.")
        if abs(value) > LARGEST:
            hint = f"Write it in SI units; up to {LARGEST:g} is read."
            self.fail(f"{key} is {value:g}, which no arm has", hint)

    def unique(self, table: str, names: list[str]) -> None:
        for k, name in enumerate(names):
            self.text(f"{table}[{k}].name", name)
            first = names.index(name)
            if first < k:
                self.fail(
                    f"{table}[{k}].name {name!r} is already the name of {table}[{first}]",
                    f"Every {table} needs a name of its own.",
                )

    def geometry(self, robot: RobotFile) -> None:
        with_dh = [k for k, joint in enumerate(robot.joint) if joint.dh is not None]
        if robot.urdf is not None and with_dh:
            joint = robot.joint[with_dh[0]].name
            self.fail(
                f"both urdf and joint[{with_dh[0]}].dh (joint {joint!r}) are given",
                "Give the geometry once: a urdf, or dh for every joint.",
            )
        if robot.urdf is None and len(with_dh) < len(robot.joint):
            k = next(k for k, joint in enumerate(robot.joint) if joint.dh is None)
            self.fail(
                f"neither urdf nor joint[{k}].dh (joint {robot.joint[k].name!r}) is given",
                'Give urdf = "...", or dh = { alpha, a, d, theta0 } for every joint.',
            )
        if robot.urdf is not None:
            self.text("urdf", robot.urdf)

    def joint(self, key: str, joint: JointEntry) -> None:
        of = f" (joint {joint.name!r})"
        numbers = {name: getattr(joint, name) for name in _MEANING}
        for name, value in numbers.items():
            if value is None:
                continue
            self.finite(f"{key}.{name}{of}", value)
            limit = "above 0" if name in _POSITIVE and value <= 0.0 else ""
            if name in (*_POSITIVE, "gear_ratio") and 0.0 < abs(value) < SMALLEST:
                limit = f"{SMALLEST:g} or more"
            if name == "gear_ratio" and value == 0.0:
                limit = "other than 0"
            if name == "rotor_inertia" and value < 0.0:
                limit = "0 or more"
            if name == "torque_constant_error" and not 0.0 <= value < 1.0:
                limit = "at least 0 and below 1"
            if limit:
                self.fail(f"{key}.{name}{of} is {value:g}, must be {limit}", _MEANING[name])
        if joint.dh is not None:
            for name in ("alpha", "a", "d", "theta0"):
                self.finite(f"{key}.dh.{name}{of}", getattr(joint.dh, name))
        if joint.position_limits is not None:
            self.limits(f"{key}.position_limits", of, joint.position_limits)

    def limits(self, key: str, of: str, limits: tuple[float, float]) -> None:
        low, high = limits
        self.finite(f"{key}[0]{of}", low)
        self.finite(f"{key}[1]{of}", high)
        if low >= high:
            self.fail(
                f"{key}{of} is [{low:g}, {high:g}], not in ascending order", "Write [lower, upper]."
            )

    def imu(self, key: str, imu: ImuEntry, joints: list[str]) -> None:
        if imu.after_joint not in joints:
            self.fail(
                f"{key}.after_joint (imu {imu.name!r}) names no joint: {imu.after_joint!r}",
                f"{nearest(imu.after_joint, joints)}The robot's joints: {', '.join(joints)}.",
            )
        if not imu.accelerometers and not imu.gyro:
            self.fail(
                f"{key} (imu {imu.name!r}) has neither accelerometers nor a gyro",
                "List its accelerometers, or set gyro = true for an ordinary IMU.",
            )
        for k, sensor in enumerate(imu.accelerometers):
            at = f"{key}.accelerometers[{k}]"
            for i in range(3):
                self.finite(f"{at}.position[{i}] (imu {imu.name!r})", sensor.position[i])
                self.finite(f"{at}.axis[{i}] (imu {imu.name!r})", sensor.axis[i])
            if not LEAST_AXIS < math.hypot(*sensor.axis) < math.inf:
                self.fail(
                    f"{at}.axis (imu {imu.name!r}) has no direction: {list(sensor.axis)}",
                    "Give the direction in which the accelerometer senses.",
                )

    def channels(self, robot: RobotFile) -> None:
        channels = robot.channels
        if channels.time is not None:
            self.text("channels.time", str(channels.time))
        for kind in JOINT_CHANNELS:
            pattern = getattr(channels, kind)
            if isinstance(pattern, str):
                self.pattern(f"channels.{kind}", pattern, len(robot.joint))
            elif pattern is not None:
                self.columns(f"channels.{kind}", [str(each) for each in pattern], robot)
        said = {f"channels.{name}": name for name in _NEEDED if getattr(channels, name) is not None}
        if channels.effort == "current":
            said["channels.effort"] = "current"
        for source, kind in said.items():
            for k, joint in enumerate(robot.joint):
                missing = [name for name in _NEEDED[kind] if getattr(joint, name) is None]
                if missing:
                    self.fail(
                        f"{source} says that the log carries {kind}, but joint[{k}].{missing[0]} "
                        f"(joint {joint.name!r}) is missing",
                        f"Add {missing[0]} and gear_ratio to that joint. {_MEANING[missing[0]]}",
                    )

    def columns(self, key: str, columns: list[str], robot: RobotFile) -> None:
        for k, column in enumerate(columns):
            self.text(f"{key}[{k}]", column)
        if len(set(columns)) < len(columns) or len(columns) != len(robot.joint):
            self.fail(
                f"{key} names {len(set(columns))} columns for {len(robot.joint)} joints",
                "List one column for each joint, in the order of the [[joint]] tables.",
            )

    def pattern(self, key: str, pattern: str, joints: int) -> None:
        self.text(key, pattern)
        try:
            parts = list(Formatter().parse(pattern))
        except ValueError as problem:
            self.fail(f"{key} {pattern!r}: {problem}", "Write {name}, {index} or {index0}.")
        fields = [field for _, field, _, _ in parts if field is not None]
        odd = [
            field
            for _, field, spec, conversion in parts
            if field is not None and (field not in PATTERN_FIELDS or spec or conversion)
        ]
        if odd:
            self.fail(
                f"{key} {pattern!r} has the unknown placeholder {{{odd[0]}}}",
                "Write {name}, {index} (from 1) or {index0} (from 0), without format.",
            )
        if joints > 1 and not fields:
            self.fail(
                f"{key} {pattern!r} is the same for all {joints} joints",
                "Put {name}, {index} (from 1) or {index0} (from 0) into it.",
            )
