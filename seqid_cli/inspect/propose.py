"""A robot file proposed from logs and a URDF."""

import json
import math
import re
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import ConfigError, InputError, SeqidError, UsageError
from seqid_cli.inspect.dynamics.angles import BY_EQUATIONS
from seqid_cli.inspect.dynamics.equations import GRAVITY
from seqid_cli.inspect.guess import Guess, Known, guess
from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.inspect.matching import Pairs, matched
from seqid_cli.inspect.parts import Inspected
from seqid_cli.inspect.proposed_channels import (
    MEASURED_DEGREES,
    channels_of,
    may_be_percent,
    units_of,
)
from seqid_cli.logs.contents import LogContents, contents_of
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.storage.files import unchanged
from seqid_cli.logs.tables.naming_schemes import find_scheme
from seqid_cli.params.results.inspection import InspectedJoint
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.template import JointTemplate, RobotTemplate, robot_toml
from seqid_cli.robot.urdf import UrdfJoint, UrdfText

NO_LIMIT = 1e3  # rad, rad/s (m, m/s), from which on a limit is none
# Channels that a robot file may have only with the data of the servos.
_OF_SERVOS = ("voltage", "pwm")


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
    unit: str | None = None,
    rate: float | None = None,
    reading: Reading = HEADER_STAMPS,
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
    unit : {"rad", "deg", "percent"}, optional
        That of positions; as names and values show it where it is left out.
    rate : float, optional
        Samples per second of tables without a column of time [Hz].
    reading : Reading
        By which stamps logs are read, and which part of them.

    Raises
    ------
    InputError
        A log cannot be read, or shows no joint.
    UsageError
        `drives` have another number of values.
    """
    known = Known(joints=urdf.movable if urdf is not None else (), rate=rate)
    first = LogFile.at(paths[0], reading=reading)
    with unchanged(first.file, first.state):
        contents = contents_of(paths[0])
        guessed = guess(contents, known)
        reports = [inspect_log(path, known=known, reading=reading) for path in paths]
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
    pairs, chain = matched(guessed.joints, urdf)
    log_joints: list[tuple[str, UrdfJoint | None]] = [*pairs]
    if not pairs:
        log_joints = [(joint, None) for joint in guessed.joints]

    log_names = [log_name for log_name, _ in log_joints]
    names = [joint.name if joint else log_name for log_name, joint in log_joints]
    channels, todo = channels_of(contents, guessed, log_names, names)
    codes = {finding.code for report in reports for finding in report.findings}
    rate_hz = reports[0].log.rate_hz

    def template_for(codes: Collection[str]) -> RobotTemplate:
        """Describe the robot, units as findings of these codes call for."""
        units = units_of(guessed, codes, rate_hz, unit)
        is_open = (
            ("unit" in units or "position_scale" in codes)
            and unit is None
            and MEASURED_DEGREES not in codes
            and may_be_percent(contents, guessed, inspected.values())
        )
        if is_open:
            units.pop("unit", None)
        joints = [
            _joint(urdf_joint, inspected[log_name], guessed, units)
            for log_name, urdf_joint in log_joints
        ]
        return RobotTemplate(
            name=name,
            joints=_driven(joints, drives),
            urdf=urdf_path if pairs else None,
            effort=_effort(contents, inspected, log_names),
            imus=guessed.imus,
            channels={**channels, **units},
            left_out=tuple(joint.name for joint in chain if joint.name not in names),
            may_be_percent=is_open,
            rate=rate,
        )

    template = template_for(codes)
    if urdf is not None and pairs:
        # The limits of the URDF tell units that the log alone does not.
        seen = _codes_by(template, urdf, paths[0], reading)
        if template_for(codes | seen) != template:
            template = template_for(codes | seen)
            _codes_by(template, urdf, paths[0], reading)
    if undriven:
        todo.append(
            f"the log has neither torque nor current of {', '.join(undriven)}: left out"
        )
    todo += _todo(template, guessed, pairs, urdf)
    return Proposal(template, tuple(todo))


def _codes_by(
    template: RobotTemplate, urdf: UrdfText, log: Path, reading: Reading
) -> set[str]:
    """Read a log by a proposed robot file, and return the codes of the findings.

    Raises InputError where that cannot be done: no file is worth writing then.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        channels = {
            key: value
            for key, value in template.channels.items()
            if key not in _OF_SERVOS
        }
        geometry = path.with_name("robot.urdf")  # the URDF may be of a log itself
        geometry.write_bytes(urdf.raw)
        trial = replace(template, urdf=geometry.name, channels=channels)
        path.write_text(robot_toml(trial), encoding="utf-8")
        try:
            robot = load_robot(path)
        except ConfigError as error:
            # The folder is gone when the message is read.
            if error.where == str(path):
                error.where = "the proposed robot file"
            elif error.where == str(geometry):
                error.where = str(urdf.path)
            raise
        report = inspect_log(log, robot, reading=reading)
    for finding in report.findings:
        if finding.code in ("unreadable", "channel_missing"):
            raise InputError(
                f"no robot file was found by which it can be read: {finding.message}",
                hint=finding.remedy,
                where=str(log),
            )
    codes = {finding.code for finding in report.findings}
    if any(
        finding.code == "position_in_degrees" and BY_EQUATIONS in finding.message
        for finding in report.findings
    ):
        codes.add(MEASURED_DEGREES)
    return codes


def _limited(limit: float | None) -> float | None:
    """Return a limit of the URDF, or None where it is as large as none."""
    return None if limit is None or limit >= NO_LIMIT else limit


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
    content: str,
    path: Path,
    logs: Sequence[Path],
    *,
    reading: Reading = HEADER_STAMPS,
    most: int = 8,
    apart: float = 0.1,
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
    reading : Reading
        By which stamps they are read, and which part of them.
    most : int
        Logs that are looked at.
    apart : float
        Share of gravity by which they may differ; their median is written.
    """
    try:
        report = inspect_logs(logs[:most], load_robot(path), reading=reading)
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


def _joint(
    joint: UrdfJoint | None,
    inspected: InspectedJoint,
    guessed: Guess,
    units: Mapping[str, str],
) -> JointTemplate:
    """Describe a joint of the robot file."""
    # Programs that export URDFs write 1e16 where a joint has no limit.
    limits = None
    if joint is not None and joint.lower is not None and joint.upper is not None:
        is_limit = max(abs(joint.lower), abs(joint.upper)) < NO_LIMIT
        limits = (joint.lower, joint.upper) if is_limit else None
    step = inspected.encoder_step
    if step is not None:
        # The inspection took all positions for angles in the guessed unit, those of
        # joints that slide as well; the robot file has rad, or m.
        unit = units.get("unit")
        if unit == "percent":
            step = None if limits is None else step * 0.005 * (limits[1] - limits[0])
        elif joint is not None and joint.kind == "prismatic":
            step *= 1e-3 if "length_unit" in units else 1.0
        else:
            step *= math.radians(1.0) if unit == "deg" else 1.0
        if step is not None and guessed.unit == "deg":
            step = math.degrees(step)
    if joint is None:
        return JointTemplate(
            name=inspected.name, encoder_step=step, moves=inspected.moves
        )

    remark = "" if joint.name == inspected.name else f"{inspected.name} in the log"
    return JointTemplate(
        name=joint.name,
        limits=limits,
        velocity=_limited(joint.velocity),
        encoder_step=step,
        moves=inspected.moves,
        remark=remark,
    )


def _todo(
    template: RobotTemplate, guessed: Guess, pairs: Pairs, urdf: UrdfText | None
) -> Iterator[str]:
    """Yield what is left to the user."""
    if template.channels.get("unit") == "deg":
        yield 'check unit = "deg" under [channels]: the angles look like degrees'
    if template.may_be_percent:
        yield (
            "whether positions are in degrees or in percent of the range, which the log"
            ' does not tell: unit = "deg" or "percent" under [channels], or --unit'
        )
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
