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
from seqid_cli.logs.contents import Survey, survey
from seqid_cli.logs.tables.naming_schemes import column_name, find_scheme, time_names
from seqid_cli.params.results.inspection import InspectedJoint
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.template import JointTemplate, RobotTemplate
from seqid_cli.robot.toml_schema import Columns
from seqid_cli.robot.urdf import UrdfJoint, UrdfText, best_chain

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
    """Propose a robot file from logs of one robot, of which the first says what channels there are.

    `urdf`: without it the geometry is left to be filled in. `urdf_path`: how the file
    is to name it. `drives`: `torque_constant` and `gear_ratio`, one for all joints or
    one for each; any other number raises UsageError. Raises InputError: a log cannot be
    read, or shows no joint.
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
    known: list[tuple[str, UrdfJoint | None]] = [*pairs] or [
        (n, None) for n in guessed.joints
    ]
    codes = {finding.code for report in reports for finding in report.findings}
    units = (
        {"unit": "deg"}
        if guessed.unit == "deg" or "position_in_degrees" in codes
        else {}
    )
    units |= {"length_unit": "mm"} if guessed.length_unit == "mm" else {}
    joints = _driven(
        [_joint(own, seen[log], guessed, units) for log, own in known], drives
    )
    effort = next((joint.effort for joint in seen.values() if joint.effort), "")
    log_names, names = [log for log, _ in known], [joint.name for joint in joints]
    channels, todo = _channels(surveyed, guessed, log_names, names)
    template = RobotTemplate(
        name=name,
        joints=joints,
        urdf=urdf_path if pairs else None,
        effort="effort" if effort and not surveyed.columns else effort,
        imus=guessed.imus,
        channels={**channels, **units},
        left_out=tuple(joint.name for joint in chain if joint.name not in names),
    )
    if undriven:
        todo.append(
            f"the log has neither torque nor current of {', '.join(undriven)}: left out"
        )
    return Proposal(template, (*todo, *_todo(template, guessed, pairs, urdf)))


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
        every = values if len(values) == count else [*values] * count
        pairs = zip(joints, every, strict=True)
        joints = [replace(joint, **{key: value}) for joint, value in pairs]  # type: ignore[arg-type]
    return tuple(joints)


def with_gravity(
    content: str, path: Path, logs: Sequence[Path], *, most: int = 8, apart: float = 0.1
) -> str:
    """Return a robot file's text with gravity as its first logs tell it, or as it was.

    `apart`: share of gravity by which the logs may differ; their median is written.
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


def match_names(
    log: Sequence[str], urdf: Sequence[str], *, near: float = 0.6
) -> dict[str, str]:
    """Pair names of a log with those of a URDF, one to one: equal ones first, then the nearest."""
    pairs = {name: name for name in log if name in urdf}
    left = [name for name in log if name not in pairs]
    free = [name for name in urdf if name not in pairs.values()]
    scored = sorted(
        (-_likeness(a, b), log.index(a), urdf.index(b)) for a in left for b in free
    )
    for score, i, j in scored:
        if -score >= near and log[i] not in pairs and urdf[j] not in pairs.values():
            pairs[log[i]] = urdf[j]
    return pairs


def _likeness(a: str, b: str) -> float:
    """Compare names but for case, separators, fillers (`elbow_joint`); numbers must be the same."""
    numbers = [re.findall(r"[0-9]+", text) for text in (a, b)]
    if numbers[0] and numbers[1] and numbers[0] != numbers[1]:
        return 0.0
    plain = [
        _FILLERS.sub("", re.sub(r"[^a-z0-9]", "", text.lower())) for text in (a, b)
    ]
    if plain[0] == plain[1]:
        return 1.0
    return (
        difflib.SequenceMatcher(a=plain[0], b=plain[1]).ratio() if all(plain) else 0.0
    )


def _matched(
    log: Sequence[str], urdf: UrdfText | None
) -> tuple[Pairs, tuple[UrdfJoint, ...]]:
    """Pair the log's joints with those of the URDF's chain that fits best, in chain order."""
    if urdf is None:
        return [], ()
    back = {joint: name for name, joint in match_names(log, urdf.movable).items()}
    chain = best_chain(urdf, lambda joint: 1000.0 * (joint.name in back) + 1.0)
    found = [(back[joint.name], joint) for joint in chain if joint.name in back]
    if len(found) == len(log):
        return found, chain
    chain = best_chain(urdf)
    matched = [re.fullmatch(r"[A-Za-z_]*([0-9]+)", name) for name in log]
    places = [int(match[1]) for match in matched if match]
    first = 0 if 0 in places else 1
    if len(places) == len(log) and max(places) - first < len(chain):
        return [
            (name, chain[k - first]) for name, k in zip(log, places, strict=True)
        ], chain
    return found, chain


def _joint(
    joint: UrdfJoint | None,
    seen: InspectedJoint,
    guessed: Guess,
    units: Mapping[str, str],
) -> JointTemplate:
    """Describe a joint; the inspection took its positions for angles in the guessed unit."""
    step = seen.encoder_step
    if step is not None:
        angle = math.radians(1.0) if "unit" in units else 1.0
        length = 1e-3 if "length_unit" in units else 1.0
        step *= length if joint is not None and joint.kind == "prismatic" else angle
        step = math.degrees(step) if guessed.unit == "deg" else step
    if joint is None:
        return JointTemplate(seen.name, encoder_step=step, moves=seen.moves)
    limits = (
        (joint.lower, joint.upper) if None not in (joint.lower, joint.upper) else None
    )
    remark = "" if joint.name == seen.name else f"{seen.name} in the log"
    return JointTemplate(joint.name, limits, joint.velocity, step, seen.moves, remark)  # type: ignore[arg-type]


def _channels(
    surveyed: Survey, guessed: Guess, log: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, Columns], list[str]]:
    """Return `[channels]` by which a robot file's joints are those of a log, and what they lack."""
    if not surveyed.columns:
        renamed = ", ".join(
            f"{a} -> {b}" for a, b in zip(log, joints, strict=True) if a != b
        )
        text = (
            "the log's joints have other names: rename them in a copy of the URDF"
            f" ({renamed})"
        )
        return {}, [text] if renamed else []
    names = surveyed.columns
    times = time_names(names)
    channels: dict[str, Columns] = {}
    if "t" not in times and len(times) != 1:
        channels["time"] = next(iter(times), "TODO")
    patterns = dict(guessed.patterns)
    for quantity in () if patterns else WORDS:
        there = all(f"{name}.{quantity}" in names for name in guessed.joints)
        patterns |= (
            {quantity: f"{{name}}.{quantity}"}
            if quantity == "position" or there
            else {}
        )
    match = find_scheme(joints, names)
    told = {*match.columns} if match is not None else set()  # by the names themselves
    told |= {"current", "torque"} if "effort" in told else set()
    mapped = {
        k: _mapped(pattern, log, joints)
        for k, pattern in patterns.items()
        if k not in told
    }
    return {**channels, **mapped}, []


def _mapped(pattern: Columns, log: Sequence[str], joints: Sequence[str]) -> Columns:
    """Write the log's names by those of the URDF, by the joints' numbers, or column by column."""
    if not isinstance(pattern, str) or "{name}" not in pattern:
        return pattern
    pairs = list(zip(log, joints, strict=True))
    parts = [a.partition(b) for a, b in pairs if b in a]
    forms = [f"{before}{{name}}{after}" for before, _, after in parts]
    for match in re.finditer("[0-9]+", log[0]):
        before, after = log[0][: match.start()], log[0][match.end() :]
        forms += [f"{before}{key}{after}" for key in ("{index}", "{index0}")]
    for form in forms:
        if all(column_name(form, b, k) == a for k, (a, b) in enumerate(pairs)):
            return pattern.replace("{name}", form)
    return tuple(pattern.replace("{name}", name) for name in log)


def _todo(
    template: RobotTemplate, guessed: Guess, pairs: Pairs, urdf: UrdfText | None
) -> Iterator[str]:
    """Yield what is left to the user."""
    if "unit" in template.channels:
        yield 'check unit = "deg" under [channels]: the angles look like degrees'
    if "length_unit" in template.channels:
        yield 'check length_unit = "mm" under [channels]: positions are called so'
    there = {log for log, _ in pairs}
    missing = ", ".join(
        name for name in dict.fromkeys(guessed.joints) if name not in there
    )
    if urdf is None:
        yield "the geometry: name a URDF, or complete dh of every joint"
    elif not pairs:
        movable = ", ".join(urdf.movable) or "no movable joint"
        yield (
            f"no joint of the log ({missing}) is in the URDF ({movable}): give the"
            " geometry"
        )
    elif missing:
        yield f"joints of the log that the URDF's chain lacks: {missing}"
    if pairs and template.left_out:
        names = ", ".join(template.left_out)
        yield f"the log lacks joints of the URDF, taken as locked at zero: {names}"
    known = all(joint.torque_constant and joint.gear_ratio for joint in template.joints)
    if template.effort == "current" and not known:
        yield "torque_constant and gear_ratio of every joint"
    if template.effort == "effort":
        yield 'whether effort is torque in N m or current in A (effort = "current")'
    if template.channels.get("time") == "TODO":
        yield "the time column"
    yield from (f"where IMU {imu.name} rides, and its layout" for imu in template.imus)
