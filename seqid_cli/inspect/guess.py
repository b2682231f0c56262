"""A robot guessed from the names in a log alone: joints, channels, IMUs, but no geometry."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.contents import Survey
from seqid_cli.robot.placement import DhRow, chain_from_dh
from seqid_cli.robot.toml.checks import MOST_JOINTS
from seqid_cli.robot.toml.schema import Channels
from seqid_cli.robot.types import Imu, Joint, Robot

# Words for each quantity, joined and in lower case; those of one letter count only beside a number.
WORDS: Mapping[str, tuple[str, ...]] = {
    "position": ("position", "positions", "pos", "q", "angle", "theta", "measq"),
    "velocity": ("velocity", "velocities", "vel", "qd", "dq", "qdot", "speed", "omega"),
    "current": ("current", "currents", "cur", "amps", "i", "iq"),
    "torque": ("torque", "torques", "tau", "effort", "efforts", "trq", "tauj", "moment"),
    "temperature": ("temperature", "temperatures", "temp"),
}
_QUANTITY = {word: quantity for quantity, words in WORDS.items() for word in words}
_NOISE = {
    "joint",
    "joints",
    "j",
    "axis",
    "state",
    "states",
    "actual",
    "measured",
    "meas",
    "act",
    "motor",
    "robot",
    "observation",
}
_COMMANDED = {
    "target",
    "desired",
    "des",
    "cmd",
    "command",
    "commanded",
    "ref",
    "goal",
    "setpoint",
    "d",
    "err",
    "error",
}
_SHORT = 2  # letters; such words are too common to stand for a quantity without a number


@dataclass(frozen=True)
class Guess:
    """A guess by names: joints in order, `[channels]` patterns, and IMUs."""

    joints: tuple[str, ...]
    patterns: Mapping[str, str] = field(default_factory=dict)
    imus: tuple[Imu, ...] = ()


def guess(survey: Survey) -> Guess:
    """Guess joints, channels and IMUs of a log from the names in it."""
    names = [channel.name for channel in survey.channels]
    imus = _imus(names)
    if survey.format == "mcap":
        return Guess(survey.joints, {}, imus)
    patterns, joints = guess_channels(names)
    defaults = tuple(n.removesuffix(".position") for n in names if n.endswith(".position"))
    if defaults:
        return Guess(defaults, {}, imus)
    if not joints:
        return Guess(survey.joints, {}, imus)
    return Guess(joints, patterns, imus)


def guess_channels(names: Iterable[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Guess `[channels]` patterns and joint names from column names.

    Returns
    -------
    patterns : dict
        By quantity, with {index}, {index0} or {name}; empty where nothing is found.
    joints : tuple of str
        Names found in the columns, else joint_1, joint_2, ...
    """
    names = list(names)
    numbered, named = _numbered(names), _named(names)
    position = _best(numbered.get("position", {}))
    if position is not None:
        patterns = {"position": _index(*position)}
        count = len(position[1])
        for quantity in ("velocity", "current", "torque", "temperature"):
            same = {
                form: numbers
                for form, numbers in numbered.get(quantity, {}).items()
                if len(numbers) >= count
            }
            best = _best(same)
            if best is not None:
                patterns[quantity] = _index(*best)
        return patterns, tuple(f"joint_{k + 1}" for k in range(count))
    if "position" not in named:
        return {}, ()
    form, joints = max(named["position"].items(), key=lambda item: len(item[1]))
    patterns = {"position": form}
    for quantity in ("velocity", "current", "torque", "temperature"):
        fits = [f for f, js in named.get(quantity, {}).items() if set(joints) <= set(js)]
        if fits:
            patterns[quantity] = fits[0]
    return patterns, tuple(joints)


def _index(form: str, numbers: Sequence[int]) -> str:
    return form.replace("{#}", "{index0}" if numbers[0] == 0 else "{index}")


def _numbered(names: list[str]) -> dict[str, dict[str, list[int]]]:
    """Forms with `{#}` for the number, by quantity, with the numbers found."""
    found: dict[str, dict[str, set[int]]] = {}
    for name in names:
        for match in re.finditer(r"[0-9]{1,3}", name):
            form = name[: match.start()] + "{#}" + name[match.end() :]
            quantity = _quantity(_words(form), _SHORT - 2)
            if quantity:
                found.setdefault(quantity, {}).setdefault(form, set()).add(int(match[0]))
    return {
        quantity: {f: sorted(ns) for f, ns in forms.items() if _is_range(ns)}
        for quantity, forms in found.items()
    }


def _named(names: list[str]) -> dict[str, dict[str, list[str]]]:
    """Forms with `{name}`, by quantity, with the joints found."""
    found: dict[str, dict[str, list[str]]] = {}
    for name in names:
        for separator in ("/", ".", "_"):
            parts = name.split(separator)
            for at in (len(parts) - 1, 0):
                quantity = _quantity([parts[at].lower()], _SHORT) if len(parts) > 1 else ""
                joint = separator.join(parts[:at] if at else parts[1:]).strip("/")
                if quantity and joint and not _COMMANDED & set(_words(joint)):
                    form = name.replace(joint, "{name}", 1)
                    found.setdefault(quantity, {}).setdefault(form, []).append(joint)
    return found


def _words(text: str) -> list[str]:
    plain = text.replace("{#}", " ")
    return [word.lower() for word in re.split(r"[^A-Za-z]+|(?<=[a-z])(?=[A-Z])", plain) if word]


def _quantity(words: list[str], shortest: int) -> str:
    if _COMMANDED & set(words):
        return ""
    rest = [word for word in words if word not in _NOISE] or [""]
    for text in ("".join(rest), rest[-1] if len(rest) == 1 else ""):
        if text in _QUANTITY and len(text) > shortest:
            return _QUANTITY[text]
    return ""


def _is_range(numbers: set[int], *, max_joints: int = 64) -> bool:
    first = min(numbers)
    return (
        first in (0, 1)
        and numbers == set(range(first, first + len(numbers)))
        and (len(numbers) <= max_joints)
    )


def _best(forms: Mapping[str, list[int]]) -> tuple[str, list[int]] | None:
    return max(forms.items(), key=lambda item: len(item[1]), default=None)


def _imus(names: list[str]) -> tuple[Imu, ...]:
    """IMUs by the default names of columns and topics; positions are unknown and zero."""
    counts: dict[str, int] = {}
    gyros: set[str] = set()
    for name in names:
        if match := re.fullmatch(r"(.+)\.a([0-9]{1,2})", name):
            counts[match[1]] = max(counts.get(match[1], 0), int(match[2]))
        elif match := re.fullmatch(r"(.+)\.a[xyz]", name):
            counts.setdefault(match[1], 3)
        elif match := re.fullmatch(r"(.+)\.g[xyz]", name):
            gyros.add(match[1])
        elif match := re.fullmatch(r"/?(.+)/accel_([0-9]{1,2})", name):
            counts[match[1]] = max(counts.get(match[1], 0), 3 * int(match[2]))
        elif match := re.fullmatch(r"/?(.*imu.*)/data(?:_raw)?", name):
            counts.setdefault(match[1].strip("/"), 3)
            gyros.add(match[1].strip("/"))
    return tuple(
        Imu(imu, 0, np.zeros((count, 3)), np.eye(3)[np.arange(count) % 3], imu in gyros)
        for imu, count in counts.items()
        if count >= 3
    )


def stand_in(guessed: Guess, *, source: Path) -> Robot:
    """Make a robot that can read the log; its geometry means nothing.

    Raises
    ------
    InputError
        The log has more joints than an arm.
    """
    count = len(guessed.joints)
    if count > MOST_JOINTS:
        hint = f"Give a robot file with -r that names those of one arm, up to {MOST_JOINTS}."
        raise InputError(f"there are {count} joints in it", hint=hint, where=str(source))
    return Robot(
        name="unknown",
        # A current is read as it is, so that it can be judged without drive data.
        joints=tuple(Joint(name, torque_constant=1.0) for name in guessed.joints),
        chain=chain_from_dh([DhRow(0.0, 0.0, 0.0, 0.0)] * count),
        gravity=np.array([0.0, 0.0, -9.81]),
        sha256="",
        source=source,
        imus=guessed.imus,
        channels=msgspec.convert(dict(guessed.patterns), Channels),
    )
