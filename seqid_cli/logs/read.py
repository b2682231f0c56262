"""From a log file to a `Recording`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError, UsageError
from seqid_cli.logs import raw as raw_log
from seqid_cli.logs.lost_samples import Mended, mended, with_losses
from seqid_cli.logs.mcap import reader, rosbags
from seqid_cli.logs.publishers import without_second_publisher
from seqid_cli.logs.raw import BlockReader, RawLog, Stream, TimeSource
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.storage.files import check_log, sha256_of, storage_file, unchanged
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.tables import csv_file, parquet
from seqid_cli.logs.timebase import Base, make_base, overlap, resample
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

READERS: dict[str, BlockReader] = {
    "parquet": parquet.read_blocks,
    "mcap": reader.read_blocks,
    "csv": csv_file.read_blocks,
    "rosbag2": rosbags.read_blocks,
    "rosbag1": rosbags.read_blocks,
}
ABSURD = 1e9  # no position, torque or acceleration in SI units is that large


def read_recording(
    path: Path, robot: Robot, *, time_source: TimeSource = "header"
) -> Recording:
    """Read one log on a uniform time base: a file told by its content, or a ROS 2 bag's folder.

    Parameters
    ----------
    robot : Robot
        Names of joints, channels and IMUs; drive data that turn current into torque.
    time_source : {"header", "log"}
        MCAP and bags only: the stamps in the messages, or the times of logging.

    Returns
    -------
    Recording
        Joints in the robot's order, SI units. `tau` is the logged torque [N m at the
        joint], else current times torque constant and gear ratio. `temperature` is NaN
        for joints that have none; everything else is finite.

    Raises
    ------
    InputError
        The file cannot be read, lacks a channel or is too short.
    UsageError
        `time_source` is not known.
    """
    return read_both(path, robot, time_source=time_source)[0]


def read_both(
    path: Path, robot: Robot, *, time_source: TimeSource = "header"
) -> tuple[Recording, RawLog]:
    """Read one log as a recording and as it was logged; see `read_recording` and `assemble`."""
    if time_source not in ("header", "log"):
        raise UsageError(
            f"time source {time_source!r} is not known", hint="Use header or log."
        )
    with local_copy(path) as copy:
        kind, file = check_log(copy), storage_file(copy)
        with unchanged(file):
            raw = read_whole(file, kind, robot, time_source)
            digest = sha256_of(file)
        recording, raw = assemble(file, kind, digest, raw, robot)
    return (replace(recording, path=path) if copy is not path else recording), raw


def read_whole(path: Path, kind: str, robot: Robot, time_source: TimeSource) -> RawLog:
    """Read a file of a format as one block; see `BlockReader`."""
    (raw,) = READERS[kind](path, robot, time_source, rows=None)
    joints, found = raw_log.in_turns(raw.joints, robot)
    text = "position wraps by whole turns {} times; it is made to run on"
    said = [f"{name}: {text.format(count)}" for name, count in found.items()]
    return replace(raw, joints=joints, warnings=(*raw.warnings, *said))


class TorqueLackingError(InputError):
    """`joints` have neither torque nor current, and others of the robot do."""

    def __init__(self, joints: Sequence[str], where: str) -> None:
        message = (
            f"neither torque nor current of joint {', '.join(joints)}, but of others"
        )
        super().__init__(
            message, hint="Log it for every joint of the robot file.", where=where
        )
        self.joints = tuple(joints)


def assemble(
    path: Path, kind: str, digest: str, raw: RawLog, robot: Robot
) -> tuple[Recording, RawLog]:
    """Lay what was logged on one time base, mended; see `read_recording`.

    Returns: the recording; what was logged, without what no sensor reads, its joint
    samples in the order of time, with `tau` [N m at the joint] beside their channels.
    """
    where = str(path)
    warnings = list(raw.warnings)
    joints = without_absurd(raw.joints, warnings)
    joints = without_second_publisher(joints, where, warnings)
    present = np.isfinite(joints.channels["position"]).any(axis=0)
    if missing := [robot.joint_names[j] for j in np.flatnonzero(~present)]:
        text = (
            f"no position of joint {', '.join(missing)}: {len(joints)} samples, all"
            " without it"
        )
        hint = "Log all joints of the robot file, by the names that it gives them."
        raise InputError(text, hint=hint, where=where)
    joints = with_torque(joints, robot, raw.prefer_current, where, warnings)
    ordered, backwards, duplicates, of_clock = raw_log.tidy(joints)
    repair = mended(ordered)
    logged = repair.stream
    base = make_base(logged, where)
    q, valid, holes = resample(logged, "position", base)
    gaps, tau = {*holes, *base.gaps}, None
    if "tau" in logged.channels:
        tau, measured, holes = resample(logged, "tau", base)
        valid, gaps = valid & measured, gaps.union(holes)
    names = ("velocity", "load", "link_position")
    dq, load, link = (_of_all_joints(logged, name, base, warnings) for name in names)
    warnings += [*of_clock, *repair.warnings]
    accelerometers, gyros, measured = _read_imus(raw, robot, base, repair, warnings)
    heat = None
    if np.isfinite(logged.channels.get("temperature", np.nan)).any():
        heat, *_ = resample(logged, "temperature", base)
    recording = Recording(
        path=path,
        sha256=digest,
        format=kind,
        t=base.t,
        q=q,
        valid=valid & measured,
        health=Health(
            rate_hz=1.0 / base.step_s,
            jitter=base.jitter,
            gaps=tuple(sorted(gaps)),
            non_monotonic=backwards,
            duplicates=duplicates,
            resampled=not base.exact,
            log_minus_header_s=raw.log_minus_header_s,
            warnings=tuple(dict.fromkeys(warnings)),
            mended=repair.warnings,
        ),
        dq=dq,
        tau=tau,
        temperature=heat,
        load=load,
        link_position=link,
        accelerometers=accelerometers,
        gyros=gyros,
        start=base.start_ns * 1e-9,
        partial=raw.partial,
        bridged=_bridged(repair, base),
    )
    return recording, replace(raw, joints=logged)


def _bridged(repair: Mended, base: Base) -> Mask | None:
    """Samples (N,) of the base that lie nearest to some that were not measured."""
    if not repair.bridged.any():
        return None
    seconds = (repair.stream.stamp_ns - base.start_ns) * 1e-9
    edges = 0.5 * (seconds[1:] + seconds[:-1])
    return np.asarray(repair.bridged[np.searchsorted(edges, base.t)])


def without_absurd(
    stream: Stream, warnings: list[str], *, most: float = ABSURD
) -> Stream:
    """Treat values that are infinite or larger than `most` as missing, and say so."""
    channels, count = {}, 0
    for name, values in stream.channels.items():
        wrong = np.abs(values) > most
        count += int(np.count_nonzero(wrong))
        channels[name] = np.where(wrong, np.nan, values) if wrong.any() else values
    if not count:
        return stream
    text = f"{count} values are infinite or beyond {most:g}; taken as missing"
    warnings.append(f"{stream.name}: {text}")
    return replace(stream, channels=channels)


def with_torque(
    joints: Stream, robot: Robot, prefer_current: bool, where: str, warnings: list[str]
) -> Stream:
    """Add `tau`: the logged torque, else current times torque constant and gear ratio."""
    none = np.full((len(joints), robot.n), np.nan)
    torque, current = (
        joints.channels.get(name, none) for name in ("torque", "current")
    )
    factors = np.array([joint.torque_per_ampere for joint in robot.joints], np.float64)
    by_current = current * factors  # NaN where the robot file has none
    first, second = (by_current, torque) if prefer_current else (torque, by_current)
    tau = np.where(np.isfinite(first).any(axis=0), first, second)
    present: Mask = np.asarray(np.isfinite(tau).any(axis=0))
    names = np.array(robot.joint_names)
    if len(
        without_drive := names[np.asarray(np.isfinite(current).any(axis=0)) & ~present]
    ):
        text = (
            f"the current of {', '.join(without_drive)} cannot be turned into torque:"
            " give "
        )
        warnings.append(f"{text}torque_constant and gear_ratio in the robot file")
    elif present.all():
        return replace(joints, channels={**joints.channels, "tau": tau})
    elif present.any():
        raise TorqueLackingError(names[~present].tolist(), where)
    return joints


def _of_all_joints(
    stream: Stream, quantity: str, base: Base, warnings: list[str]
) -> Array | None:
    """Resample an optional channel; None, with a warning, where only some joints have it."""
    if quantity not in stream.channels:
        return None
    values, *_ = resample(stream, quantity, base)
    there = np.isfinite(values)
    if there.any() and not there.all():
        warnings.append(f"{quantity} is logged for some joints only; it is left out")
    return values if there.all() else None


def _read_imus(
    raw: RawLog, robot: Robot, base: Base, repair: Mended, warnings: list[str]
) -> tuple[dict[str, Array], dict[str, Array], Mask]:
    """Accelerometers (N, K) and gyros (N, 3) by IMU, and where (N,) all of them are measured."""
    found: dict[str, dict[str, Array]] = {raw_log.ACCELEROMETERS: {}, raw_log.GYRO: {}}
    valid = np.ones(base.count, np.bool_)
    for imu in robot.imus:
        given = raw.imus.get(imu.name, ())
        tidied = [raw_log.tidy(without_absurd(each, warnings)) for each in given]
        streams = [stream for stream, *_ in tidied]
        for k, each in enumerate(streams):
            if np.array_equal(each.stamp_ns, repair.stamps):  # those of the joints
                streams[k], _ = with_losses(each, repair.losses)
        if not streams or not _usable(imu.name, streams, base, warnings):
            continue
        for quantity, target in found.items():
            those = [stream for stream in streams if quantity in stream.channels]
            if parts := [resample(stream, quantity, base) for stream in those]:
                target[imu.name] = np.hstack([values for values, *_ in parts])
                valid &= np.all([measured for _, measured, _ in parts], axis=0)
        warnings += [warning for *_, own in tidied for warning in own]
    return found[raw_log.ACCELEROMETERS], found[raw_log.GYRO], valid


def _usable(name: str, streams: list[Stream], base: Base, warnings: list[str]) -> bool:
    """Tell whether an IMU can be used on the base; otherwise it is left out with a warning."""
    for stream in streams:
        covered, wrong = overlap(stream, base), ""
        empty = [
            q
            for q, v in stream.channels.items()
            if not np.isfinite(v).any(axis=0).all()
        ]
        if empty:
            wrong = f"{stream.name} has no {empty[0]} values"
        elif covered <= 0.0:
            wrong = f"the stamps of {stream.name} do not overlap those of the joints; "
            wrong += "let both use one clock, or use the times of logging"
        if wrong:
            warnings.append(f"IMU {name!r} is left out: {wrong}")
            return False
        if covered < 0.99:
            text = f"{stream.name} covers {percent(covered, 0)} of the joints' time"
            warnings.append(f"{text}; samples outside it are not valid")
    return True
