"""A robot guessed from the names in a log alone: all but its geometry."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.contents import LogContents
from seqid_cli.logs.tables.name_words import (
    BESIDE,
    BRACKET,
    EFFORT,
    letters_of,
    quantity_of,
    words_of,
)
from seqid_cli.logs.tables.naming_schemes import joints_by_scheme, patterns_around
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.toml import MOST_JOINTS
from seqid_cli.robot.toml_schema import Channels, Columns, column_name
from seqid_cli.robot.types import Imu, Joint, Robot

_SHORT = 2  # letters; such words are too common to stand for a quantity of one joint
_DEGREES = frozenset({"deg", "degs", "degrees", "grad", "°"})


@dataclass(frozen=True, kw_only=True)
class Guess:
    """A guess by names: joints in order, patterns of `[channels]`, IMUs, units."""

    joints: tuple[str, ...]
    patterns: Mapping[str, Columns] = field(default_factory=dict)
    imus: tuple[Imu, ...] = ()
    unit: Literal["rad", "deg"] = "rad"
    length_unit: Literal["m", "mm"] = "m"
    topic: str | None = None  # of the joint states, where it is not the usual one
    rate: float | None = None  # Hz, of a table without a column of time


@dataclass(frozen=True, kw_only=True)
class Known:
    """What is known of a robot and its logs beside the names in them."""

    joints: tuple[str, ...] = ()  # of a URDF
    rate: float | None = None  # Hz, of tables without a column of time


NOTHING_KNOWN = Known()


def guess(contents: LogContents, known: Known = NOTHING_KNOWN) -> Guess:
    """Guess joints, channels and IMUs of a log from the names in it."""
    return replace(_guess_by_names(contents, known.joints), rate=known.rate)


def _guess_by_names(contents: LogContents, robot_joints: Sequence[str]) -> Guess:
    imus = _imus(contents.columns or contents.channels)
    patterns, joints = guess_channels(contents.columns)
    if not contents.joints and set(joints).isdisjoint(robot_joints):
        known_patterns, known_joints = _around_known(robot_joints, contents.columns)
        if known_joints and len(known_joints) >= len(joints):
            patterns, joints = known_patterns, known_joints
    ends = (name.rpartition(".") for name in contents.columns)
    defaults = tuple(
        joint for joint, dot, quantity in ends if dot and quantity == "position"
    )
    if defaults or contents.joints or not joints:
        return Guess(
            joints=defaults or contents.joints,
            patterns={},
            imus=imus,
            topic=next(iter(contents.state_topics), None),
        )
    positions = patterns["position"]
    text = positions if isinstance(positions, str) else " ".join(map(str, positions))
    words = {*letters_of(text), *re.findall("°", text)}
    unit: Literal["rad", "deg"] = "deg" if _DEGREES & words else "rad"
    return Guess(
        joints=joints,
        patterns=patterns,
        imus=imus,
        unit=unit,
        length_unit="mm" if "mm" in words else "m",
    )


def _around_known(
    robot_joints: Sequence[str], columns: Sequence[str]
) -> tuple[dict[str, Columns], tuple[str, ...]]:
    """Guess patterns around names of known joints, and which of these are there.

    The pattern of the position is the one that most of them have.
    """
    joints_by_pattern: dict[str, list[str]] = {}
    for joint in robot_joints:
        for pattern in patterns_around([joint], columns).get("position", ()):
            joints_by_pattern.setdefault(pattern, []).append(joint)
    if not joints_by_pattern:
        return {}, ()
    position, joints = max(joints_by_pattern.items(), key=lambda item: len(item[1]))
    patterns: dict[str, Columns] = {"position": position}
    for quantity, listed in patterns_around(joints, columns).items():
        patterns.setdefault("torque" if quantity == EFFORT else quantity, listed[0])
    return patterns, tuple(joints)


def guess_channels(names: Iterable[str]) -> tuple[dict[str, Columns], tuple[str, ...]]:
    """Guess `[channels]` patterns and joint names from column names.

    Returns: patterns by quantity, with {index}, {index0} or {name}, or the column of
    each joint, empty where nothing is found; names found in the columns, else joint_1,
    joint_2, ...
    """
    names = list(names)
    patterns, joints = _guess_by_words(names)

    # What is read without being declared is recognised as well, also where a joint is
    # called like a word that is passed over (`motor_a`, `left_joint_1`). Underscores
    # part too much to count where words tell anything.
    read = joints_by_scheme(names, separators="./" if joints else "./_")
    if read is None or len(read.joints) <= len(joints):
        return patterns, joints
    form = read.patterns["position"]
    if not joints:
        # `freq_q`: a word of few letters tells a quantity of several joints only.
        words = letters_of(form.replace("{name}", " "))
        is_short = max(map(len, words)) <= _SHORT
        if "_" in form and is_short and len(read.joints) == 1:
            return patterns, joints
        return dict(read.patterns), read.joints
    # The words must have seen some of the same joints: a pose has positions as well.
    columns = {column_name(form, joint, 0) for joint in read.joints}
    guessed = patterns["position"]
    guessed_columns = {column_name(guessed, joint, k) for k, joint in enumerate(joints)}
    if guessed_columns <= columns:
        return dict(read.patterns), read.joints
    return patterns, joints


def _guess_by_words(names: list[str]) -> tuple[dict[str, Columns], tuple[str, ...]]:
    """Guess patterns and joints, as of `guess_channels`, by words for quantities."""
    numbered = _numbered(names)
    named = _named(names)
    patterns: dict[str, Columns] = {}
    if numbered.get("position"):
        forms = map(sorted, numbered["position"].values())
        numbers = max(forms, key=lambda counted: (_is_range(counted), len(counted)))
        for quantity, columns_of_forms in numbered.items():
            fitting = [
                columns
                for columns in columns_of_forms.values()
                if _indexed(columns, numbers)
            ]
            if fitting:
                patterns[quantity] = _indexed(max(fitting, key=len), numbers)
        counted = range(1, len(numbers) + 1) if _is_range(numbers) else numbers
        return patterns, tuple(f"joint_{number}" for number in counted)
    if "position" in named:
        form, joints = max(named["position"].items(), key=lambda item: len(item[1]))
        for quantity, joints_of_forms in named.items():
            of_all_joints = [
                quantity_form
                for quantity_form, form_joints in joints_of_forms.items()
                if set(joints) <= set(form_joints)
            ]
            if of_all_joints:
                patterns[quantity] = of_all_joints[0]
        return patterns | {"position": form}, tuple(joints)
    for name in names:  # of a single joint, which need no name: `q`, `q_act`, `tau`
        if quantity := quantity_of(words_of(name)):
            patterns.setdefault(quantity, name)
    return (patterns, ("joint_1",)) if "position" in patterns else ({}, ())


def _indexed(forms: Mapping[int, str], numbers: list[int]) -> Columns:
    """Write the columns of joints as one pattern where only their number differs."""
    column_numbers = sorted(forms)
    counted = _is_range(column_numbers) and _is_range(numbers)
    column_numbers = column_numbers[: len(numbers)] if counted else numbers
    if len(column_numbers) < len(numbers) or not set(column_numbers) <= forms.keys():
        return ()  # some joint lacks the quantity
    if counted and len({forms[number] for number in column_numbers}) == 1:
        first = column_numbers[0]
        return forms[first].replace("{#}", "{index0}" if first == 0 else "{index}")
    columns = tuple(
        forms[number].replace("{#}", str(number)) for number in column_numbers
    )
    return columns[0] if len(columns) == 1 else columns


def _numbered(
    names: list[str], *, max_joints: int = 64
) -> dict[str, dict[str, dict[int, str]]]:
    """Forms with `{#}` for the number, by quantity, form without unit, and number."""
    by_quantity: dict[str, dict[str, dict[int, str]]] = {}
    for name in names:
        for match in re.finditer(r"[0-9]{1,3}", name):
            if any(a.start() < match.start() < a.end() for a in BRACKET.finditer(name)):
                continue
            form = name[: match.start()] + "{#}" + name[match.end() :]
            if quantity := quantity_of(words_of(form)):
                forms = by_quantity.setdefault(quantity, {}).setdefault(
                    BRACKET.sub("", form), {}
                )
                forms.setdefault(int(match[0]), form)
    for quantity, columns_of_forms in by_quantity.items():
        by_quantity[quantity] = {
            form: columns
            for form, columns in columns_of_forms.items()
            if len(columns) <= max_joints
        }
    return by_quantity


def _named(names: list[str]) -> dict[str, dict[str, list[str]]]:
    """Forms with `{name}`, by quantity, with the joints found."""
    by_quantity: dict[str, dict[str, list[str]]] = {}
    for name in names:
        for separator in ("/", ".", "_"):
            parts = name.split(separator)
            for at in (len(parts) - 1, 0):
                quantity = quantity_of(words_of(parts[at])) if len(parts) > 1 else ""
                joint = separator.join(parts[:at] if at else parts[1:]).strip("/")
                if quantity and joint and not BESIDE & set(words_of(joint)):
                    form = name.replace(joint, "{name}", 1)
                    forms = by_quantity.setdefault(quantity, {})
                    forms.setdefault(form, []).append(joint)
    # Words of few letters tell a quantity beside several joints only.
    for forms in by_quantity.values():
        for form in [form for form, joints in forms.items() if len(joints) == 1]:
            if max(map(len, letters_of(form.replace("{name}", " ")))) <= _SHORT:
                del forms[form]
    return {quantity: forms for quantity, forms in by_quantity.items() if forms}


def _is_range(numbers: list[int]) -> bool:
    """Whether the numbers count joints, from 0 or from 1."""
    return numbers[0] in (0, 1) and numbers == [
        *range(numbers[0], numbers[0] + len(numbers))
    ]


def _imus(names: Iterable[str]) -> tuple[Imu, ...]:
    """IMUs by the default names of columns and topics; unknown positions are zero."""
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
        Imu(
            name=imu,
            after_joint=0,
            positions=np.zeros((count, 3)),
            axes=np.eye(3)[np.arange(count) % 3],
            gyro=imu in gyros,
        )
        for imu, count in counts.items()
        if count >= 3
    )


def stand_in(guessed: Guess, *, source: Path) -> Robot:
    """Make a robot that can read the log; its geometry means nothing."""
    count = len(guessed.joints)
    if count > MOST_JOINTS:
        hint = (
            "Give a robot file with -r that names those of one arm, up to"
            f" {MOST_JOINTS}."
        )
        raise InputError(
            f"there are {count} joints in it", hint=hint, where=str(source)
        )
    return Robot(
        name="unknown",
        # A current is read as it is, so that it can be judged without drive data.
        joints=tuple(Joint(name, torque_constant=1.0) for name in guessed.joints),
        chain=chain_from_dh(np.zeros((count, 4)).tolist()),
        gravity=np.array([0.0, 0.0, -9.81]),
        sha256="",
        source=source,
        imus=guessed.imus,
        channels=Channels(
            **guessed.patterns,  # type: ignore[arg-type]
            unit=guessed.unit,
            topic=guessed.topic,
            rate=guessed.rate,
        ),
    )
