"""`[channels]` of a proposed robot file: names, columns, units of a log."""

import re
from collections.abc import Collection, Iterable, Sequence

from seqid_cli.inspect.guess import Guess
from seqid_cli.inspect.scales import likely_unit_of_time
from seqid_cli.logs.contents import LogContents
from seqid_cli.logs.tables.name_words import WORDS
from seqid_cli.logs.tables.naming_schemes import (
    LEROBOT_STATE,
    find_scheme,
    stamp_parts,
    time_names,
)
from seqid_cli.params.results.inspection import InspectedJoint
from seqid_cli.robot.toml_schema import Columns, column_name

# Beside the codes of findings: the equations say that angles are in degrees.
MEASURED_DEGREES = "measured degrees"


def units_of(
    guessed: Guess, codes: Collection[str], rate_hz: float, declared: str | None
) -> dict[str, str]:
    """Return the units of `[channels]`, without those that are taken anyway.

    Parameters
    ----------
    guessed : Guess
        What names in the log tell.
    codes : collection of str
        Findings of its inspection.
    rate_hz : float
        Samples per second, as the log is read without a unit of time.
    declared : str, optional
        Unit of positions; as names and values show it where it is left out.
    """
    units = {}
    is_likely_deg = guessed.unit == "deg" or "position_in_degrees" in codes
    usual = "turn" if "position_in_turns" in codes else "rad"
    unit = declared or ("deg" if is_likely_deg else usual)
    if unit != "rad":
        units["unit"] = unit
    if guessed.length_unit == "mm":
        units["length_unit"] = "mm"
    if "time_unit" in codes:
        time_unit = likely_unit_of_time(rate_hz)
        if time_unit:
            units["time_unit"] = time_unit
    return units


def may_be_percent(
    contents: LogContents, guessed: Guess, joints: Iterable[InspectedJoint]
) -> bool:
    """Tell whether positions that look like degrees may be percent of the range.

    LeRobot writes either of servos whose state is positions alone, and its files do not
    say which. No percent are beyond 100. Robots whose state has speeds or torques as
    well are logged in degrees.
    """
    length = sum(name.startswith(f"{LEROBOT_STATE}[") for name in contents.columns)
    if length == 0 or length > len(contents.joints) or guessed.unit == "deg":
        return False
    return all(max(abs(joint.low), abs(joint.high)) <= 100.0 for joint in joints)


def channels_of(
    contents: LogContents, guessed: Guess, log: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, Columns], list[str]]:
    """Return `[channels]` by which joints are those of a log, and what they lack.

    `log` are the names of the joints in the log, `joints` those in the robot file.
    """
    if not contents.columns:
        return _channels_of_messages(contents, log, joints)

    columns = contents.columns
    channels: dict[str, Columns] = {}
    scheme = find_scheme(joints, columns)
    has_time_of_scheme = scheme is not None and scheme.time in columns
    times = time_names(columns)
    is_sure = "t" in times or len(times) == 1 or has_time_of_scheme
    is_sure = is_sure or guessed.rate is not None
    if not is_sure and stamp_parts(columns) is None:
        channels["time"] = next(iter(times), "TODO")
    if contents.joints and not guessed.patterns:
        names, todo = _names(contents, log, joints)
        return {**channels, **names}, todo

    patterns = dict(guessed.patterns)
    if not patterns:
        for quantity in WORDS:
            in_all = all(f"{name}.{quantity}" in columns for name in guessed.joints)
            if quantity == "position" or in_all:
                patterns[quantity] = f"{{name}}.{quantity}"

    # What a naming scheme finds by the robot file's names need not be written.
    by_scheme = {*scheme.columns} if scheme is not None else set()
    if "effort" in by_scheme:
        by_scheme |= {"current", "torque"}
    for quantity, pattern in patterns.items():
        if quantity not in by_scheme:
            channels[quantity] = _mapped(pattern, log, joints)
    return channels, []


def _channels_of_messages(
    contents: LogContents, log: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, Columns], list[str]]:
    """Return topic and names of joints as messages have them, and what is to check."""
    channels: dict[str, Columns] = {}
    todo = []
    if contents.state_topics:
        topic, *others = contents.state_topics
        channels["topic"] = topic
        todo.append(f"check topic under [channels]: joints are read from {topic}")
        if others:
            todo[-1] += f"; this robot's states may be on {', '.join(others)}"
    names, todo_of_names = _names(contents, log, joints)
    return {**channels, **names}, todo + todo_of_names


def _names(
    contents: LogContents, log: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, Columns], list[str]]:
    """Return how a log that names joints names those of the robot file."""
    if list(log) == list(joints) or not contents.named:
        return {}, []
    prefix = log[0].removesuffix(joints[0])
    if list(log) == [prefix + joint for joint in joints]:
        return {"prefix": prefix}, []
    renamed = [f"{a} -> {b}" for a, b in zip(log, joints, strict=True) if a != b]
    todo = (
        "check names under [channels]: the log's joints have other names than the"
        f" URDF's ({', '.join(renamed)})"
    )
    return {"names": tuple(log)}, [todo]


def _mapped(pattern: Columns, log: Sequence[str], joints: Sequence[str]) -> Columns:
    """Write the log's names by those of the URDF, by numbers, or column by column."""
    if not isinstance(pattern, str) or "{name}" not in pattern:
        return pattern

    # The URDF's name may be a part of the log's, or its place in the chain may.
    forms = []
    for log_name, joint in zip(log, joints, strict=True):
        if joint in log_name:
            prefix, _, suffix = log_name.partition(joint)
            forms.append(f"{prefix}{{name}}{suffix}")
    for match in re.finditer("[0-9]+", log[0]):
        prefix = log[0][: match.start()]
        suffix = log[0][match.end() :]
        forms += [f"{prefix}{key}{suffix}" for key in ("{index}", "{index0}")]

    for form in forms:
        names = [column_name(form, joint, k) for k, joint in enumerate(joints)]
        if names == list(log):
            return pattern.replace("{name}", form)
    return tuple(pattern.replace("{name}", name) for name in log)
