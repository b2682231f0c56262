"""How well-known loggers name the columns of a table: no numpy, no Arrow.

A scheme gives the pattern of each quantity; `{name}` is the joint's name in the robot
file, `{index0}` and `{index}` its place in the chain from 0 or 1, `column[k]` an
element of a list. Schemes are filled with the joints of a robot file to find their
columns (`find_scheme`), and read backwards to find joints without one
(`joints_by_scheme`).

Sources: UR RTDE, `actual_q`, `target_q` and their like with `_0` ... `_5`
(RTDE_Python_Client_Library, rtde/csv_writer.py); libfranka, `state.q[0]`,
`state.q_d[0]` ... and time in ms (src/logging/robot_state_log.cpp); LeRobot datasets,
list columns `observation.state`, `action` and others.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from seqid_cli.logs.tables.name_words import (
    COMMAND_WORDS,
    COMMANDED,
    COMMANDS,
    EFFORT,
    NAMING_WORDS,
    QUANTITIES,
    is_in_si,
    quantity_of,
    words_of,
)
from seqid_cli.robot.toml_schema import column_name

_ALL = (*QUANTITIES, EFFORT)


_RTDE = {
    "position": "actual_q",
    "velocity": "actual_qd",
    "torque": "actual_current_as_torque",
    "current": "actual_current",
    "temperature": "joint_temperatures",
    "command": "target_q",
    "command_velocity": "target_qd",
    "command_torque": "target_moment",
}
_FRANKA = {
    "position": "q",
    "velocity": "dq",
    "torque": "tau_J",
    "command": "q_d",
    "command_velocity": "dq_d",
    "command_torque": "tau_J_d",
}
_LEROBOT = {
    "position": "state",
    "velocity": "velocity state.velocity",
    "torque": "torque",
    "current": "current",
    "temperature": "temperature",
    "effort": "effort",
}
LEROBOT_STATE = "observation.state"
LEROBOT_ACTION = "action"  # what the motors were asked for; its entries have own names
EPISODES = ("episode_index", "episode_id", "episode")


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """How one logger names its columns.

    `patterns` of a quantity are tried one after the other. `time` is the column of the
    time where that is not the only one named so. `time_unit` is that of a time column
    whose name does not say. Where `of_lists`, joints are the elements of lists, and the
    log may say which element is whose.
    """

    patterns: Mapping[str, tuple[str, ...]]
    time: str | None = None
    time_unit: str | None = None
    of_lists: bool = False


def _scheme(
    form: str,
    words: Mapping[str, str],
    *,
    time: str | None = None,
    time_unit: str | None = None,
    of_lists: bool = False,
) -> Scheme:
    """Make a scheme of a form of names; `*` stands for each word of a quantity."""
    patterns = {
        quantity: tuple(form.replace("*", word) for word in listed.split())
        for quantity, listed in words.items()
    }
    return Scheme(patterns=patterns, time=time, time_unit=time_unit, of_lists=of_lists)


def _with_action(scheme: Scheme) -> Scheme:
    """Add the command of a LeRobot data set, which is no observation."""
    patterns = {**scheme.patterns, "command": (f"{LEROBOT_ACTION}[{{index0}}]",)}
    return replace(scheme, patterns=patterns)


_EVERY = {**NAMING_WORDS, **COMMAND_WORDS}
_NAMED = {name: words.named for name, words in _EVERY.items() if words.named}
_NUMBERED = {name: words.numbered for name, words in _EVERY.items() if words.numbered}
DEFAULT = _scheme("{name}.*", {quantity: quantity for quantity in _ALL})
SCHEMES = (
    DEFAULT,
    _scheme("{name}.*", _NAMED),
    _scheme("{name}/*", _NAMED),
    _scheme("*.{name}", _NAMED),
    _scheme("*/{name}", _NAMED),
    _scheme("/joint_states/{name}/*", _NAMED),
    _scheme("{name}_*", _NAMED),
    _scheme("*_{name}", _NAMED),
    _scheme("*_{index0}", _RTDE),
    # One column for each joint, whatever its brackets look like.
    _scheme("state.*[{index0}]", _FRANKA, time_unit="ms"),
    _with_action(_scheme("observation.*[{index0}]", _LEROBOT, of_lists=True)),
    # Messages as rostopic prints them; see `echoed`.
    _scheme(
        "field.*{index0}",
        {quantity: quantity for quantity in ("position", "velocity", EFFORT)},
        time="field.header.stamp",
        time_unit="ns",
        of_lists=True,
    ),
    _scheme("*_{index0}", _NUMBERED),
    _scheme("*_{index}", _NUMBERED),
    _scheme("*{index0}", _NUMBERED),
    _scheme("*{index}", _NUMBERED),
    _scheme("*[{index0}]", _NUMBERED, of_lists=True),
    # A message as a struct of lists.
    _scheme("joint_states.*[{index0}]", _NUMBERED, of_lists=True),
    _scheme("joint_state.*[{index0}]", _NUMBERED, of_lists=True),
)
# Columns of lists of names, which say whose the elements of the other lists are.
NAME_COLUMNS = tuple(
    struct + name
    for struct in ("", "joint_states.", "joint_state.")
    for name in ("name", "names", "joint_names")
)


@dataclass(frozen=True)
class Match:
    """A scheme found in a log."""

    # the column of each joint, by quantity; None where a joint lacks one
    columns: dict[str, list[str | None]]
    time: str | None  # its time column, where that is not the only one named so
    time_unit: str | None  # of its time column where the name does not say


def find_scheme(
    joints: Sequence[str],
    log_columns: Collection[str],
    entries: Mapping[str, int] | None = None,
    command_entries: Mapping[str, int] | None = None,
) -> Match | None:
    """Find the scheme by which a log names the positions of all joints.

    Parameters
    ----------
    joints : sequence of str
        Names of the robot file, in chain order.
    log_columns : collection of str
        Columns of the log.
    entries : mapping of str to int, optional
        Place of each joint in the log's lists, where it names them; else a joint's
        place in them is that in the chain.
    command_entries : mapping of str to int, optional
        Likewise in its lists of commands; as in the others where it is left out.
    """
    if command_entries is None:
        command_entries = entries
    for scheme in SCHEMES:
        columns: dict[str, list[str | None]] = {}
        for quantity in _ALL:
            of_lists = command_entries if quantity in COMMANDS else entries
            places = list(range(len(joints)))
            if of_lists and scheme.of_lists:
                places = [of_lists.get(joint, -1) for joint in joints]
            names = _columns(
                scheme,
                quantity,
                list(zip(joints, places, strict=True)),
                log_columns,
                of_all=quantity == "position",
            )
            if names is not None:
                columns[quantity] = names
        if "position" in columns:
            return Match(columns, scheme.time, scheme.time_unit)
    return _match_around(joints, log_columns)


def _match_around(joints: Sequence[str], log_columns: Collection[str]) -> Match | None:
    """Match columns that hold the joints' names between other words.

    Only where one pattern alone tells the position, in SI units; another quantity that
    several patterns tell is left out.
    """
    sure = {
        quantity: patterns[0]
        for quantity, patterns in patterns_around(joints, log_columns).items()
        if len(patterns) == 1 and is_in_si(patterns[0])
    }
    if "position" not in sure:
        return None
    columns: dict[str, list[str | None]] = {
        quantity: [pattern.replace("{name}", joint) for joint in joints]
        for quantity, pattern in sure.items()
    }
    return Match(columns, None, None)


def patterns_around(
    joints: Sequence[str], log_columns: Collection[str]
) -> dict[str, list[str]]:
    """Find the patterns by which columns name quantities around the joints' names.

    `actual_position_{name}` or `{name}.present_position`: words for a quantity, and
    words that are no command beside them. A pattern has a column for every joint.
    """
    efforts = frozenset(f"{NAMING_WORDS[EFFORT].named} efforts".split())
    patterns: dict[str, list[str]] = {}
    for column in sorted(log_columns):
        if joints[0] not in column or "{" in column:
            continue
        pattern = column.replace(joints[0], "{name}", 1)
        if any(pattern.replace("{name}", name) not in log_columns for name in joints):
            continue
        words = words_of(pattern.replace("{name}", " "))
        quantity = quantity_of(words)
        if quantity:
            key = EFFORT if efforts.intersection(words) else quantity
            patterns.setdefault(key, []).append(pattern)
    return patterns


def find_quantities(
    joints: Sequence[str], log_columns: Collection[str]
) -> dict[str, list[str | None]]:
    """Find the columns of all quantities but the position.

    The robot file declares the position. Another quantity is found by the first scheme
    that has it for all joints, else by the default names of some joints.
    """
    placed_joints = [(joint, place) for place, joint in enumerate(joints)]
    columns: dict[str, list[str | None]] = {}
    for quantity in _ALL[1:]:
        for scheme in SCHEMES:
            names = _columns(scheme, quantity, placed_joints, log_columns, of_all=True)
            if names is not None:
                break
        else:
            names = _columns(
                DEFAULT, quantity, placed_joints, log_columns, of_all=False
            )
        if names:
            columns[quantity] = names
    return columns


def nearest_scheme(joints: Sequence[str], log_columns: Collection[str]) -> list[str]:
    """List the position columns that a log lacks of the scheme that fits it best."""
    missing_by_pattern = []
    for scheme in SCHEMES:
        for pattern in scheme.patterns["position"]:
            names = [column_name(pattern, name, k) for k, name in enumerate(joints)]
            missing_by_pattern.append(
                [name for name in names if name not in log_columns]
            )
    return min(missing_by_pattern, key=len)


def _columns(
    scheme: Scheme,
    quantity: str,
    placed_joints: list[tuple[str, int]],
    log_columns: Collection[str],
    *,
    of_all: bool,
) -> list[str | None] | None:
    """Return the columns of the first pattern that has them for all joints, or some."""
    for pattern in scheme.patterns.get(quantity, ()):
        filled = [column_name(pattern, joint, place) for joint, place in placed_joints]
        names = [name if name in log_columns else None for name in filled]
        if all(names) or (not of_all and any(names)):
            return names
    return None


@dataclass(frozen=True)
class NamedJoints:
    """Joints that the columns of a table name, and the pattern of each quantity."""

    joints: tuple[str, ...]  # in the order of the columns
    patterns: dict[str, str]


def joints_by_scheme(names: Sequence[str], separators: str) -> NamedJoints | None:
    """Find the joints that a scheme with `{name}` would read from a table.

    Parameters
    ----------
    names : sequence of str
        Columns of the table.
    separators : str
        Characters of which one must stand beside the name for a scheme to count.

    Returns
    -------
    NamedJoints or None
        Those of the scheme that finds the most joints; of equal ones, of the longest
        pattern. An effort counts as a torque. None where no scheme finds any.
    """
    best: NamedJoints | None = None
    best_rank = (0, 0)
    for scheme in SCHEMES:
        for pattern in scheme.patterns["position"]:
            beside = pattern.replace("{name}", "")
            if beside == pattern or not set(separators).intersection(beside):
                continue
            joints = _names_in(pattern, names)
            rank = (len(joints), len(pattern))
            if joints and rank > best_rank:
                patterns = {"position": pattern, **_patterns(scheme, joints, names)}
                best = NamedJoints(joints, patterns)
                best_rank = rank
    return best


def _names_in(pattern: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return what stands for `{name}` in the columns of a pattern.

    Commanded quantities are left out: `target.position` is no joint.
    """
    before, after = pattern.split("{name}")
    form = re.compile(f"{re.escape(before)}([^./]+){re.escape(after)}")
    matches = (form.fullmatch(name) for name in names)
    joints = [match[1] for match in matches if match is not None]
    return tuple(
        joint
        for joint in dict.fromkeys(joints)
        if not COMMANDED.intersection(re.split(r"[_\W]+", joint.lower()))
    )


def _patterns(
    scheme: Scheme, joints: Sequence[str], names: Sequence[str]
) -> dict[str, str]:
    """Return the patterns of quantities beside the position that all joints have."""
    patterns: dict[str, str] = {}
    for quantity in _ALL[1:]:
        key = "torque" if quantity == EFFORT else quantity
        for pattern in scheme.patterns.get(quantity, ()):
            columns = [column_name(pattern, name, k) for k, name in enumerate(joints)]
            if set(columns) <= set(names):
                patterns.setdefault(key, pattern)
                break
    return patterns


# Names of time columns, the unit behind them optional: time, t_ms, timestamp [s],
# __time.
_UNIT = r"s|sec|secs|seconds|ms|msec|us|usec|ns|nsec"
_TIME = re.compile(
    r"(?:__)?(?:t|time|timestamp|time_stamp|stamp|header[./_]stamp|zeit)"
    rf"(?:[ _]+(?P<unit>{_UNIT})|[ _]*[\[(](?P<bracket>{_UNIT})[\])])?",
    re.IGNORECASE,
)
_UNIT_BY_START = {"s": "s", "se": "s", "ms": "ms", "us": "us", "ns": "ns"}
_STAMP_PARTS = re.compile(r"(?P<stem>.*stamp[./_])(?:sec|secs|seconds)")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")


def time_names(names: Iterable[str]) -> dict[str, str | None]:
    """List the columns that look like time, with the unit where the name says it."""
    units: dict[str, str | None] = {}
    for name in names:
        match = _TIME.fullmatch(name.strip())
        if match is not None:
            unit = (match["unit"] or match["bracket"] or "").lower()
            units[name] = _UNIT_BY_START[unit[:2]] if unit else None
    return units


def stamp_parts(names: Collection[str]) -> tuple[str, str] | None:
    """Find a stamp that is written as whole seconds and nanoseconds in two columns."""
    for name in names:
        match = _STAMP_PARTS.fullmatch(name)
        if match is None:
            continue
        for word in _NANOSECONDS:
            nanoseconds = match["stem"] + word
            if nanoseconds in names:
                return name, nanoseconds
    return None
