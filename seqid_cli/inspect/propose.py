"""A robot file proposed from logs and a URDF."""

import difflib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError, SeqidError, UsageError
from seqid_cli.inspect.dynamics.equations import GRAVITY
from seqid_cli.inspect.guess import WORDS, Guess, guess
from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.inspect.parts import Inspected
from seqid_cli.logs.contents import LogContents, contents_of
from seqid_cli.logs.tables.naming_schemes import find_scheme, time_names
from seqid_cli.params.results.inspection import InspectedJoint
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.template import JointTemplate, RobotTemplate
from seqid_cli.robot.toml_schema import Columns, column_name
from seqid_cli.robot.urdf import UrdfJoint, UrdfText, best_chain

# Words that names of joints have around what tells them apart.
_FILLERS = re.compile(r"(joint|axis|link|act|actuator)")
Pairs = list[tuple[str, UrdfJoint]]  # joints by their names in the log


class Proposal(NamedTuple):
    """A proposed robot file, and the entries that are left to the user."""

    template: RobotTemplate
    todo: tuple[str, ...]


def propose(
    paths: Sequence[Path],
    *,
    urdf: UrdfText | None,
    urdf_path: str | None,
    name: str,
    drives: Mapping[str, Sequence[float]] = {},
) -> Proposal:
    """Propose a robot file from logs of one robot.

    Parameters
    ----------
    paths : sequence of Path
        Logs; the first one says what channels there are.
    urdf : UrdfText, optional
        The geometry; without it that is left to be filled in.
    urdf_path : str, optional
        How the file is to name the URDF.
    name : str
        Name of the robot.
    drives : mapping of str to sequence of float
        `torque_constant` and `gear_ratio`, one for all joints or one for each.

    Raises
    ------
    InputError
        A log cannot be read, or shows no joint.
    UsageError
        `drives` have another number of values.
    """
    contents = contents_of(paths[0])
    guessed = guess(contents)
    reports = [inspect_log(path) for path in paths]
    for report in reports:
        if report.log.verdict == "unreadable":
            problem = report.findings[0]
            raise InputError(
                problem.message, hint=problem.remedy, where=report.log.path
            )

    # The inspection leaves out joints without torque where other joints have one.
    inspected = _inspected_joints(reports)
    undriven = [joint for joint in guessed.joints if joint not in inspected]
    driven = tuple(joint for joint in guessed.joints if joint in inspected)
    guessed = replace(guessed, joints=driven)
    pairs, chain = _matched(guessed.joints, urdf)
    log_joints: list[tuple[str, UrdfJoint | None]] = [*pairs]
    if not pairs:
        log_joints = [(joint, None) for joint in guessed.joints]

    units = _units(guessed, reports)
    joints = _driven(
        [
            _joint(urdf_joint, inspected[log_name], guessed, units)
            for log_name, urdf_joint in log_joints
        ],
        drives,
    )
    log_names = [log_name for log_name, _ in log_joints]
    names = [joint.name for joint in joints]
    channels, todo = _channels(contents, guessed, log_names, names)
    template = RobotTemplate(
        name=name,
        joints=joints,
        urdf=urdf_path if pairs else None,
        effort=_effort(contents, inspected, log_names),
        imus=guessed.imus,
        channels={**channels, **units},
        left_out=tuple(joint.name for joint in chain if joint.name not in names),
    )
    if undriven:
        todo.append(
            f"the log has neither torque nor current of {', '.join(undriven)}: left out"
        )
    todo += _todo(template, guessed, pairs, urdf)
    return Proposal(template, tuple(todo))


def _inspected_joints(reports: Sequence[Inspected]) -> dict[str, InspectedJoint]:
    """Return the joints of all logs by name; a joint moves if it moves in any log."""
    joints: dict[str, InspectedJoint] = {}
    for report in reports:
        for joint in report.log.joints:
            if joint.name not in joints or (
                joint.moves and not joints[joint.name].moves
            ):
                joints[joint.name] = joint
    return joints


def _units(guessed: Guess, reports: Sequence[Inspected]) -> dict[str, str]:
    """Return the units of `[channels]` that positions seem to have."""
    codes = {finding.code for report in reports for finding in report.findings}
    units = {}
    if guessed.unit == "deg" or "position_in_degrees" in codes:
        units["unit"] = "deg"
    if guessed.length_unit == "mm":
        units["length_unit"] = "mm"
    if "time_unit" in codes:
        unit = _time_unit(reports[0].log.rate_hz or 0.0)
        if unit:
            units["time_unit"] = unit
    return units


def _time_unit(
    rate_hz: float, *, slowest_hz: float = 5.0, fastest_hz: float = 50_000.0
) -> str:
    """Return the unit of times that give a rate as seconds; empty where none fits.

    Parameters
    ----------
    rate_hz : float
        Samples per second, times taken for seconds.
    slowest_hz, fastest_hz : float
        Rates at which robots are recorded.
    """
    for unit in ("ms", "us", "ns"):
        rate_hz *= 1000.0
        if slowest_hz <= rate_hz <= fastest_hz:
            return unit
    return ""


def _effort(
    contents: LogContents,
    inspected: Mapping[str, InspectedJoint],
    log_names: Sequence[str],
) -> str:
    """Return what the log has of torque: "torque", "current", "effort", or nothing."""
    efforts = [joint.effort for joint in inspected.values() if joint.effort]
    if not efforts:
        return ""
    # The effort of a message, or of a column that is called so, may be either.
    scheme = find_scheme(log_names, contents.columns)
    is_effort = scheme is not None and "effort" in scheme.columns
    return "effort" if is_effort or not contents.columns else efforts[0]


def _driven(
    joints: Sequence[JointTemplate], drives: Mapping[str, Sequence[float]]
) -> tuple[JointTemplate, ...]:
    """Give each joint the data of its drive."""
    count = len(joints)
    for key, values in drives.items():
        if len(values) not in (1, count):
            names = ", ".join(joint.name for joint in joints)
            message = (
                f"--{key.replace('_', '-')} has {len(values)} numbers for {count}"
                " joints"
            )
            raise UsageError(
                message, hint=f"Give one for all joints, or one for each: {names}."
            )
        by_joint = values if len(values) == count else [*values] * count
        joints = [
            replace(joint, **{key: value})  # type: ignore[arg-type]
            for joint, value in zip(joints, by_joint, strict=True)
        ]
    return tuple(joints)


def with_gravity(
    content: str, path: Path, logs: Sequence[Path], *, most: int = 8, apart: float = 0.1
) -> str:
    """Return a robot file's text with gravity as its first logs show it, or as it was.

    Parameters
    ----------
    content : str
        Text of the robot file.
    path : Path
        The robot file itself.
    logs : sequence of Path
        Logs of the robot.
    most : int
        Logs that are looked at.
    apart : float
        Share of gravity by which they may differ; their median is written.
    """
    try:
        report = inspect_logs(logs[:most], load_robot(path))
    except SeqidError:
        return content
    matches = [GRAVITY.match(finding.message) for finding in report.findings]
    gravities = np.array([json.loads(match[1]) for match in matches if match])
    if not len(gravities):
        return content
    strength = np.linalg.norm(gravities[0])
    if np.ptp(gravities, axis=0).max() > apart * strength:
        return content

    # Adding zero turns -0.0 into 0.0.
    median = [float(f"{x:.3g}") + 0.0 for x in np.median(gravities, axis=0)]
    line = f"gravity = {median}  # m/s^2 in the base frame, as the logs tell"
    return re.sub(r"(?m)^gravity = .*$", line, content)


def match_names(
    log: Sequence[str], urdf: Sequence[str], *, near: float = 0.6
) -> dict[str, str]:
    """Pair names of a log with those of a URDF, one to one.

    Equal names come first, then those behind one prefix, then the nearest.

    Parameters
    ----------
    log, urdf : sequence of str
        Names of joints in both.
    near : float
        Likeness, 0 to 1, that two names have at least.

    Returns
    -------
    dict of str to str
        Names of the URDF by those of the log.
    """
    pairs = {name: name for name in log if name in urdf} or _behind_prefix(log, urdf)
    log_names = [name for name in log if name not in pairs]
    urdf_names = [name for name in urdf if name not in pairs.values()]

    # The likest first; of pairs that are alike the first in the log, then in the URDF.
    scored = sorted(
        (-_likeness(log_name, urdf_name), log.index(log_name), urdf.index(urdf_name))
        for log_name in log_names
        for urdf_name in urdf_names
    )
    for negative_likeness, i, j in scored:
        is_free = log[i] not in pairs and urdf[j] not in pairs.values()
        if -negative_likeness >= near and is_free:
            pairs[log[i]] = urdf[j]
    return pairs


def _behind_prefix(log: Sequence[str], urdf: Sequence[str]) -> dict[str, str]:
    """Pair names of a log that are those of a URDF behind the prefix of most of them.

    Of two arms, whose prefixes have as many, the first in the log counts.
    """
    pairs_by_prefix: dict[str, dict[str, str]] = {}
    for log_name in log:
        for urdf_name in urdf:
            if log_name.endswith(urdf_name):
                prefix = log_name.removesuffix(urdf_name)
                pairs_by_prefix.setdefault(prefix, {})[log_name] = urdf_name
    return max(pairs_by_prefix.values(), key=len, default={})


def _likeness(a: str, b: str) -> float:
    """Return how alike two names are, 0 to 1, but for case, separators and fillers.

    Their numbers must be the same.
    """
    numbers_of_a = re.findall(r"[0-9]+", a)
    numbers_of_b = re.findall(r"[0-9]+", b)
    if numbers_of_a and numbers_of_b and numbers_of_a != numbers_of_b:
        return 0.0
    plain_a = _plain(a)
    plain_b = _plain(b)
    if plain_a == plain_b:
        return 1.0
    if not (plain_a and plain_b):
        return 0.0
    return difflib.SequenceMatcher(a=plain_a, b=plain_b).ratio()


def _plain(name: str) -> str:
    """Return a name without case, separators and fillers: "elbow" for "Elbow_Joint"."""
    return _FILLERS.sub("", re.sub(r"[^a-z0-9]", "", name.lower()))


def _matched(
    log: Sequence[str], urdf: UrdfText | None
) -> tuple[Pairs, tuple[UrdfJoint, ...]]:
    """Pair the log's joints with those of the URDF's chain that fits best."""
    if urdf is None:
        return [], ()
    log_name_of = {
        joint: name for name, joint in match_names(log, urdf.movable).items()
    }

    # The chain with most of the log's joints; of these the longest.
    def worth(joint: UrdfJoint) -> float:
        return 1001.0 if joint.name in log_name_of else 1.0

    chain = best_chain(urdf, worth)
    pairs = [
        (log_name_of[joint.name], joint) for joint in chain if joint.name in log_name_of
    ]
    if len(pairs) == len(log):
        return pairs, chain

    # Names such as "motor_3" say a place in the chain, from 0 or from 1.
    chain = best_chain(urdf)
    matches = [re.fullmatch(r"[A-Za-z_]*([0-9]+)", name) for name in log]
    places = [int(match[1]) for match in matches if match]
    first = 0 if 0 in places else 1
    if len(places) == len(log) and max(places) - first < len(chain):
        pairs = [
            (name, chain[place - first])
            for name, place in zip(log, places, strict=True)
        ]
    return pairs, chain


def _joint(
    joint: UrdfJoint | None,
    inspected: InspectedJoint,
    guessed: Guess,
    units: Mapping[str, str],
) -> JointTemplate:
    """Describe a joint of the robot file."""
    step = inspected.encoder_step
    if step is not None:
        # The inspection took all positions for angles in the guessed unit, those of
        # joints that slide as well; the robot file has rad, or m.
        if joint is not None and joint.kind == "prismatic":
            step *= 1e-3 if "length_unit" in units else 1.0
        else:
            step *= math.radians(1.0) if "unit" in units else 1.0
        if guessed.unit == "deg":
            step = math.degrees(step)
    if joint is None:
        return JointTemplate(
            name=inspected.name, encoder_step=step, moves=inspected.moves
        )

    limits = None
    if joint.lower is not None and joint.upper is not None:
        limits = (joint.lower, joint.upper)
    remark = "" if joint.name == inspected.name else f"{inspected.name} in the log"
    return JointTemplate(
        name=joint.name,
        limits=limits,
        velocity=joint.velocity,
        encoder_step=step,
        moves=inspected.moves,
        remark=remark,
    )


def _channels(
    contents: LogContents, guessed: Guess, log: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, Columns], list[str]]:
    """Return `[channels]` by which joints are those of a log, and what they lack.

    `log` are the names of the joints in the log, `joints` those in the robot file.
    """
    if not contents.columns:
        return _channels_of_messages(contents, log, joints)

    columns = contents.columns
    channels: dict[str, Columns] = {}
    times = time_names(columns)
    if "t" not in times and len(times) != 1:
        channels["time"] = next(iter(times), "TODO")

    patterns = dict(guessed.patterns)
    if not patterns:
        for quantity in WORDS:
            in_all = all(f"{name}.{quantity}" in columns for name in guessed.joints)
            if quantity == "position" or in_all:
                patterns[quantity] = f"{{name}}.{quantity}"

    # What a naming scheme finds by the robot file's names need not be written.
    scheme = find_scheme(joints, columns)
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
    if list(log) == list(joints):
        return channels, todo

    prefix = log[0].removesuffix(joints[0])
    if list(log) == [prefix + joint for joint in joints]:
        channels["prefix"] = prefix
        return channels, todo
    channels["names"] = tuple(log)
    renamed = [f"{a} -> {b}" for a, b in zip(log, joints, strict=True) if a != b]
    todo.append(
        "check names under [channels]: the log's joints have other names than the"
        f" URDF's ({', '.join(renamed)})"
    )
    return channels, todo


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


def _todo(
    template: RobotTemplate, guessed: Guess, pairs: Pairs, urdf: UrdfText | None
) -> Iterator[str]:
    """Yield what is left to the user."""
    if "unit" in template.channels:
        yield 'check unit = "deg" under [channels]: the angles look like degrees'
    if "time_unit" in template.channels:
        unit = template.channels["time_unit"]
        yield f'check time_unit = "{unit}" under [channels]: by the rate of the samples'
    if "length_unit" in template.channels:
        yield 'check length_unit = "mm" under [channels]: positions are called so'

    paired = {log_name for log_name, _ in pairs}
    unpaired = ", ".join(
        name for name in dict.fromkeys(guessed.joints) if name not in paired
    )
    if urdf is None:
        yield "the geometry: name a URDF, or complete dh of every joint"
    elif not pairs:
        movable = ", ".join(urdf.movable) or "no movable joint"
        yield (
            f"no joint of the log ({unpaired}) is in the URDF ({movable}): give the"
            " geometry"
        )
    elif unpaired:
        yield f"joints of the log that the URDF's chain lacks: {unpaired}"
    if pairs and template.left_out:
        names = ", ".join(template.left_out)
        yield f"the log lacks joints of the URDF, taken as locked at zero: {names}"

    has_drive_data = all(
        joint.torque_constant and joint.gear_ratio for joint in template.joints
    )
    if template.effort == "current" and not has_drive_data:
        yield "torque_constant and gear_ratio of every joint"
    if not template.effort:
        yield (
            "the torques or currents: no column or message was taken for one; name it"
            " under [channels]"
        )
    if template.effort == "effort":
        yield 'whether effort is torque in N m or current in A (effort = "current")'
    if template.channels.get("time") == "TODO":
        yield "the time column"
    for imu in template.imus:
        yield f"where IMU {imu.name} rides, and its layout"
