"""A robot file proposed from logs and a URDF."""

import difflib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError, SeqidError, UsageError
from seqid_cli.inspect.dynamics.equations import GRAVITY
from seqid_cli.inspect.guess import WORDS, Guess, guess
from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.logs.contents import Survey, survey
from seqid_cli.logs.tables.naming_schemes import find_scheme, time_names
from seqid_cli.params.results.inspection import InspectedJoint
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml.schema import Columns
from seqid_cli.robot.toml.template import JointTemplate, RobotTemplate
from seqid_cli.robot.urdf.text import UrdfJoint, UrdfText, best_chain

_FILLERS = re.compile(r"(joint|axis|link|act|actuator)")


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

    `paths`: the first says which joints and channels there are, all of them what moves. `urdf`:
    without it the geometry is left to be filled in. `urdf_path`: how the file is to name it.
    `drives`: `torque_constant` and `gear_ratio`, one for all joints or one for each.

    Raises UsageError: as many drives' data as there are neither joints nor one. Raises InputError:
    a log cannot be read, or shows no joint.
    """
    surveyed = survey(paths[0])
    guessed = guess(surveyed)
    reports = [inspect_log(path) for path in paths]
    for report in reports:
        if report.log.verdict == "unreadable":
            first = report.findings[0]
            raise InputError(first.message, hint=first.remedy, where=report.log.path)
    seen: dict[str, InspectedJoint] = {}  # a joint moves if it moves in any log
    for joint in (joint for report in reports for joint in report.log.joints):
        if joint.name not in seen or (joint.moves and not seen[joint.name].moves):
            seen[joint.name] = joint
    undriven = [name for name in guessed.joints if name not in seen]
    guessed = replace(guessed, joints=tuple(n for n in guessed.joints if n in seen))
    pairs, chain = _matched(guessed.joints, urdf)
    codes = {finding.code for report in reports for finding in report.findings}
    found: list[tuple[str, UrdfJoint | None]] = [*pairs]
    found = found or [(log_name, None) for log_name in guessed.joints]
    units = {"unit": "deg"} if guessed.unit == "deg" or "position_in_degrees" in codes else {}
    read_as = guessed.unit
    sliding = any(_in_mm(own, seen[log_name], read_as=read_as) for log_name, own in pairs)
    if sliding or guessed.length_unit == "mm":
        units["length_unit"] = "mm"
    joints = tuple(
        _joint(log_name, own, seen[log_name], read_as=read_as, units=units)
        for log_name, own in found
    )
    joints = _driven(joints, drives)
    names = tuple(joint.name for joint in joints)
    effort = next((joint.effort for joint in seen.values() if joint.effort), "")
    if not surveyed.columns and effort:
        effort = "effort"
    log_names = tuple(log_name for log_name, _ in found)
    channels, unread = _channels(surveyed, guessed, log_names, names)
    taken = {joint.name for _, joint in pairs}
    template = RobotTemplate(
        name=name,
        joints=joints,
        urdf=urdf_path if pairs else None,
        effort=effort,
        imus=guessed.imus,
        channels={**channels, **units},
        left_out=tuple(joint.name for joint in chain if joint.name not in taken),
    )
    if undriven:
        lacking = f"the log has neither torque nor current of {', '.join(undriven)}: left out"
        unread = (*unread, lacking)
    return Proposal(template, (*unread, *_todo(template, guessed, pairs, urdf)))


def _driven(
    joints: tuple[JointTemplate, ...], drives: Mapping[str, Sequence[float]]
) -> tuple[JointTemplate, ...]:
    """Give each joint the data of its drive."""
    for key, values in drives.items():
        if len(values) not in (1, len(joints)):
            names = ", ".join(joint.name for joint in joints)
            message = f"{len(values)} values of {key} for {len(joints)} joints"
            raise UsageError(message, hint=f"Give one for all, or one for each of {names}.")
        own = [*values] * (len(joints) if len(values) == 1 else 1)
        pairs = zip(joints, own, strict=True)
        joints = tuple(replace(joint, **{key: value}) for joint, value in pairs)  # type: ignore[arg-type]
    return joints


def _in_mm(joint: UrdfJoint, seen: InspectedJoint, *, read_as: str, margin: float = 0.02) -> bool:
    """Whether positions of a sliding joint are within its limits, or nearly, only in mm."""
    if joint.kind != "prismatic" or joint.lower is None or joint.upper is None:
        return False
    span = joint.upper - joint.lower
    low, high = np.degrees([seen.low, seen.high]) if read_as == "deg" else (seen.low, seen.high)
    beyond = max(joint.lower - low, high - joint.upper)
    slack = margin * span
    inside = joint.lower - slack <= 1e-3 * low and 1e-3 * high <= joint.upper + slack
    return bool(beyond > span and inside)


def with_gravity(
    content: str, path: Path, logs: Sequence[Path], *, most: int = 8, apart: float = 0.1
) -> str:
    """Write gravity into a robot file as its first logs tell it.

    The same text where they do not, or where the file at `path` still lacks something. `apart`:
    share of gravity by which the logs may differ; their median is written.
    """
    try:
        report = inspect_logs(logs[:most], load_robot(path))
    except SeqidError:
        return content
    told = [said[1] for f in report.findings if (said := GRAVITY.match(f.message))]
    each = np.array([json.loads(text) for text in told])
    if not told or np.ptp(each, axis=0).max() > apart * np.linalg.norm(each[0]):
        return content
    middle = [float(f"{x:.3g}") + 0.0 for x in np.median(each, axis=0)]
    line = f"gravity = {middle}  # m/s^2 in the base frame, as the logs tell"
    return re.sub(r"(?m)^gravity = .*$", line, content)


def match_names(log: Sequence[str], urdf: Sequence[str], *, near: float = 0.6) -> dict[str, str]:
    """Pair names of a log with those of a URDF, one to one: equal ones first, then the nearest.

    Names differ in case, separators and fillers (`elbow`, `elbow_joint`); a number in both must be
    the same.
    """
    pairs = {name: name for name in log if name in urdf}
    left = [name for name in log if name not in pairs]
    free = [name for name in urdf if name not in pairs.values()]
    scored = sorted((-_likeness(a, b), log.index(a), urdf.index(b)) for a in left for b in free)
    for score, i, j in scored:
        if -score >= near and log[i] not in pairs and urdf[j] not in pairs.values():
            pairs[log[i]] = urdf[j]
    return pairs


def _likeness(a: str, b: str) -> float:
    numbers = [re.findall(r"[0-9]+", text) for text in (a, b)]
    if numbers[0] and numbers[1] and numbers[0] != numbers[1]:
        return 0.0
    plain = [_FILLERS.sub("", re.sub(r"[^a-z0-9]", "", text.lower())) for text in (a, b)]
    if plain[0] == plain[1]:
        return 1.0
    return difflib.SequenceMatcher(a=plain[0], b=plain[1]).ratio() if all(plain) else 0.0


def _matched(
    log: Sequence[str], urdf: UrdfText | None
) -> tuple[list[tuple[str, UrdfJoint]], tuple[UrdfJoint, ...]]:
    """Pair the log's joints with those of the URDF's chain that fits best, in chain order."""
    if urdf is None:
        return [], ()
    pairs = match_names(log, urdf.movable)
    back = {joint: name for name, joint in pairs.items()}
    chain = best_chain(urdf, lambda joint: 1000.0 * (joint.name in back) + 1.0)
    found = [(back[joint.name], joint) for joint in chain if joint.name in back]
    if len(found) == len(log):
        return found, chain
    chain = best_chain(urdf)
    matched = [re.fullmatch(r"[A-Za-z_]*([0-9]+)", name) for name in log]
    places = [int(match[1]) for match in matched if match]
    first = 0 if 0 in places else 1
    if len(places) == len(log) and max(places) - first < len(chain):
        return [(name, chain[k - first]) for name, k in zip(log, places, strict=True)], chain
    return found, chain


def _joint(
    log_name: str,
    joint: UrdfJoint | None,
    seen: InspectedJoint,
    *,
    read_as: str,
    units: Mapping[str, str],
) -> JointTemplate:
    """Describe a joint, whose positions the inspection took for angles in `read_as`."""
    step = seen.encoder_step
    if step is not None:
        angle = math.radians(1.0) if "unit" in units else 1.0
        length = 1e-3 if "length_unit" in units else 1.0
        factor = length if joint is not None and joint.kind == "prismatic" else angle
        step = factor * (math.degrees(step) if read_as == "deg" else step)
    if joint is None:
        return JointTemplate(log_name, encoder_step=step, moves=seen.moves)
    limits = None
    if joint.lower is not None and joint.upper is not None:
        limits = (joint.lower, joint.upper)
    remark = "" if joint.name == log_name else f"{log_name} in the log"
    return JointTemplate(joint.name, limits, joint.velocity, step, seen.moves, remark)


def _channels(
    surveyed: Survey, guessed: Guess, log: tuple[str, ...], joints: tuple[str, ...]
) -> tuple[dict[str, Columns], tuple[str, ...]]:
    """Return `[channels]` that the log needs, and names that they cannot express."""
    # `joints` are the names in the robot file of those that the log calls `log`.
    if not surveyed.columns:
        renamed = ", ".join(f"{a} -> {b}" for a, b in zip(log, joints, strict=True) if a != b)
        text = f"the log's joints have other names: rename them in a copy of the URDF ({renamed})"
        return {}, (text,) if renamed else ()
    names = surveyed.columns
    times = time_names(names)
    channels: dict[str, Columns] = {}
    if "t" not in times and len(times) != 1:
        channels["time"] = next(iter(times), "TODO")
    patterns = dict(guessed.patterns) or {
        quantity: f"{{name}}.{quantity}"
        for quantity in WORDS
        if quantity == "position" or all(f"{name}.{quantity}" in names for name in guessed.joints)
    }
    match = find_scheme(joints, names)
    if match is not None:  # what its names do not tell
        told = {*match.columns, *(("current", "torque") if "effort" in match.columns else ())}
        patterns = {key: pattern for key, pattern in patterns.items() if key not in told}
    mapped = {key: _mapped(pattern, log, joints) for key, pattern in patterns.items()}
    return {**channels, **mapped}, ()


def _mapped(pattern: Columns, log: tuple[str, ...], joints: tuple[str, ...]) -> Columns:
    """Write the log's names by those of the URDF, where they only have something around them."""
    # Or by the number of the joint, where it is all that tells the log's names apart, or column by
    # column.
    if not isinstance(pattern, str) or "{name}" not in pattern:
        return pattern
    for prefix, _, suffix in (a.partition(b) for a, b in zip(log, joints, strict=True) if b in a):
        if all(a == f"{prefix}{b}{suffix}" for a, b in zip(log, joints, strict=True)):
            return pattern.replace("{name}", f"{prefix}{{name}}{suffix}")
    for key, first in (("{index}", 1), ("{index0}", 0)):
        for match in re.finditer("[0-9]+", log[0]):
            before, after = log[0][: match.start()], log[0][match.end() :]
            if all(name == f"{before}{k + first}{after}" for k, name in enumerate(log)):
                return pattern.replace("{name}", f"{before}{key}{after}")
    return tuple(pattern.replace("{name}", name) for name in log)


def _todo(
    template: RobotTemplate,
    guessed: Guess,
    pairs: Sequence[tuple[str, UrdfJoint]],
    urdf: UrdfText | None,
) -> tuple[str, ...]:
    todo: list[str] = []
    if "unit" in template.channels:
        todo.append('check unit = "deg" under [channels]: the angles look like degrees')
    if "length_unit" in template.channels:
        todo.append('check length_unit = "mm" under [channels]: positions are called or look so')
    if urdf is not None and pairs and template.left_out:
        names = ", ".join(template.left_out)
        todo.append(f"the log lacks joints of the URDF, taken as locked at zero: {names}")
    if urdf is None:
        todo.append("the geometry: name a URDF, or complete dh of every joint")
    elif not pairs:
        todo.append(
            f"none of the log's joints ({', '.join(guessed.joints)}) was found in the URDF "
            f"({', '.join(urdf.movable) or 'no movable joint'}): give the geometry by hand"
        )
    else:
        there = {log for log, _ in pairs}
        missing = [name for name in dict.fromkeys(guessed.joints) if name not in there]
        if missing:
            todo.append(f"joints of the log that the URDF's chain lacks: {', '.join(missing)}")
    known = all(joint.torque_constant and joint.gear_ratio for joint in template.joints)
    if template.effort == "current" and not known:
        todo.append("torque_constant and gear_ratio of every joint")
    if template.effort == "effort":
        todo.append('whether effort is torque in N m or current in A (effort = "current")')
    if template.channels.get("time") == "TODO":
        todo.append("the time column")
    todo += [f"where IMU {imu.name} rides, and its layout" for imu in template.imus]
    return tuple(todo)
