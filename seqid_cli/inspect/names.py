"""Channels of the robot file against those of a log."""

import difflib

from seqid_cli.inspect.findings import found
from seqid_cli.logs.contents import Survey
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Robot


def nearest_name(name: str, known: tuple[str, ...]) -> str:
    """Return the known name nearest to a name, empty where none is near."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return close[0]
    lower = {other.lower(): other for other in known}
    close = difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.5)
    return lower[close[0]] if close else ""


def missing_imus(robot: Robot, survey: Survey) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find IMUs of the robot file that a log lacks.

    A log need not have them; it is a finding where an unknown name in the log is very near.
    """
    prefixes = tuple(
        dict.fromkeys(
            name.strip("/").rsplit("/" if "/" in name else ".", 1)[0]
            for name in (channel.name for channel in survey.channels)
            if "." in name or "/" in name
        )
    )
    unknown = tuple(
        p for p in prefixes if p not in {*robot.joint_names, *(i.name for i in robot.imus)}
    )
    missing, findings = {}, []
    for imu in robot.imus:
        if imu.name in prefixes:
            continue
        near = difflib.get_close_matches(imu.name.lower(), [p.lower() for p in unknown], 1, 0.8)
        name = next((p for p in unknown if near and p.lower() == near[0]), "")
        missing[imu.name] = name
        if name:
            text = f"the log has no IMU {imu.name!r}, but {name!r}"
            findings.append(found("channel_missing", text, joint=imu.name, channel=name))
    return missing, findings


def missing_joints(
    robot: Robot, joints: tuple[str, ...]
) -> tuple[dict[str, str], list[InspectionFinding]]:
    """Find joints of the robot file that a log lacks, with the nearest name that it has."""
    unknown = tuple(name for name in joints if name not in robot.joint_names)
    missing, findings = {}, []
    for name in robot.joint_names:
        if name not in joints:
            near = nearest_name(name, unknown)
            missing[name] = near
            text = f"the log has no joint {name!r}" + (f"; nearest: {near!r}" if near else "")
            findings.append(found("channel_missing", text, joint=name, channel=near))
    return missing, findings
