"""Files as Python objects: results, robots and logs, and logs as tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.logs.given import Log, PathLike, expanded

if TYPE_CHECKING:
    import pyarrow as pa

    from seqid_cli.logs.recording import Recording
    from seqid_cli.params.schema import Written
    from seqid_cli.robot.types import Robot
    from seqid_cli.typing import Array, Mask

_AXES = ("x", "y", "z")


def load(path: PathLike) -> Written | Robot:
    """Read a JSON document that seqid wrote, or a robot file (TOML).

    Parameters
    ----------
    path : path
        By its suffix: `.toml` is a robot file, anything else a document.

    Returns
    -------
    Written or Robot
        A document of its own kind: `ParameterFile`, `PredictionFile` ...

    Raises
    ------
    ConfigError
        The file is missing, damaged, of another kind or of a newer version.
    """
    place = Path(os.fspath(path))
    if place.suffix.lower() == ".toml":
        from seqid_cli.robot.file import load_robot

        return load_robot(place)
    from seqid_cli.params.io import read_document

    return read_document(place)


def table(log: Log, robot: PathLike | Robot) -> pa.Table:
    """Read a log as one Arrow table on one time base, as every command sees it.

    Parameters
    ----------
    log : path, table or Recording
        In any format that the commands read.
    robot : path or Robot
        Names joints, channels and IMUs, and turns current into torque.

    Returns
    -------
    pyarrow.Table
        In the default column names and SI units, so that it is a log itself: `t` [s
        from 0], `elbow.position` [rad or m], `elbow.torque` [N m or N] ..., `imu_a.a1`
        [m/s^2], `imu_a.gx` [rad/s]. `valid` is false where samples were bridged over a
        gap.

    Raises
    ------
    InputError
        The log cannot be read, lacks a channel or is too short.
    """
    import pyarrow as pa

    from seqid_cli.logs.read import read_recording
    from seqid_cli.logs.recording import Recording
    from seqid_cli.robot.file import load_robot
    from seqid_cli.robot.types import Robot

    arm = robot if isinstance(robot, Robot) else load_robot(Path(os.fspath(robot)))
    if isinstance(log, Recording):
        recording = log
    else:
        (place,) = expanded([log])
        assert isinstance(place, Path)
        recording = read_recording(place, arm)
    return pa.table(_columns(recording, arm))


def _columns(recording: Recording, robot: Robot) -> dict[str, Array | Mask]:
    """Return the channels of a recording by their default names."""
    columns: dict[str, Array | Mask] = {"t": recording.t, "valid": recording.valid}
    by_joint = {
        "position": recording.q,
        "velocity": recording.dq,
        "torque": recording.tau,
        "load": recording.load,
        "link_position": recording.link_position,
        "temperature": recording.temperature,
    }
    for quantity, values in by_joint.items():
        if values is None:
            continue
        for number, name in enumerate(robot.joint_names):
            columns[f"{name}.{quantity}"] = values[:, number]
    for imu, readings in recording.accelerometers.items():
        for number in range(readings.shape[1]):
            columns[f"{imu}.a{number + 1}"] = readings[:, number]
    for imu, rates in recording.gyros.items():
        for number, axis in enumerate(_AXES):
            columns[f"{imu}.g{axis}"] = rates[:, number]
    return columns
