"""From a log file to a `Recording`.

A reader gives what was logged, each stream with its own stamps (`RawLog`). It is put
right here, step by step: values that no sensor reads, a second publisher, torque from
current, stamps, lost samples. Then everything is brought to one time base.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.clock import tidy
from seqid_cli.logs.commands import commands_on_base
from seqid_cli.logs.even_stamps import EvenStream
from seqid_cli.logs.imu_streams import rate_of, without_zeros
from seqid_cli.logs.log_file import LogFile
from seqid_cli.logs.lost_samples import Mended, mended, with_losses
from seqid_cli.logs.publishers import without_second_publisher
from seqid_cli.logs.raw import (
    ACCELEROMETERS,
    GYRO,
    RawLog,
    Stream,
)
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.signs import with_signs
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.logs.timebase import Base, make_base, overlap, resample
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

ABSURD = 1e9  # no position, torque or acceleration in SI units is that large
# What is nearer to zero in SI units is below the resolution of any sensor.
NOTHING = 1e-12
EFFORTS = ("torque", "current")


def read_recording(
    path: Path, robot: Robot, *, reading: Reading = HEADER_STAMPS
) -> Recording:
    """Read one log on a uniform time base.

    Parameters
    ----------
    path : Path
        A file, whose content tells its format, or the folder of a ROS 2 bag.
    robot : Robot
        Names of joints, channels and IMUs; drive data that turn current into torque.
    reading : Reading
        By which stamps logs are read, and which part of them.

    Returns
    -------
    Recording
        Joints in the robot's order, SI units. `tau` is the logged torque [N m at the
        joint], else current times torque constant and gear ratio. `temperature` and
        commands are NaN for joints that have none; everything else is finite.

    Raises
    ------
    InputError
        The file cannot be read, lacks a channel or is too short.
    UsageError
        The source of its stamps is not known.
    """
    recording, _ = read_both(path, robot, reading=reading)
    return recording


def read_both(
    path: Path, robot: Robot, *, reading: Reading = HEADER_STAMPS
) -> tuple[Recording, RawLog]:
    """Read one log as a recording and as it was logged.

    The parameters and errors are those of `read_recording`, the results of `assemble`.
    """
    with local_copy(path) as copy:
        log = LogFile.at(copy, reading=reading)
        raw = log.whole(robot)
        recording, raw = assemble(log.file, log.format, log.sha256, raw, robot)

    # A copy is gone by now: the recording names the log that it is of.
    if copy is not path:
        recording = replace(recording, path=path)
    return recording, raw


class TorqueLackingError(InputError):
    """`joints` have neither torque nor current, and others of the robot do."""

    def __init__(self, joints: Sequence[str], where: str) -> None:
        super().__init__(
            f"neither torque nor current of joint {', '.join(joints)}, but of others",
            hint="Log it for every joint of the robot file.",
            where=where,
        )
        self.joints = tuple(joints)


def assemble(
    path: Path, kind: str, digest: str, raw: RawLog, robot: Robot
) -> tuple[Recording, RawLog]:
    """Lay what was logged on one time base, mended.

    Parameters
    ----------
    path : Path
        The log, as the recording and messages name it.
    kind, digest : str
        Its format and SHA-256.
    raw : RawLog
        What was logged, each stream with its own stamps.
    robot : Robot
        Names of joints and IMUs; drive data that turn current into torque.

    Returns
    -------
    Recording
        N samples on one uniform time base; see `read_recording`.
    RawLog
        What was logged, without what no sensor reads: its M joint samples in the order
        of time, with `tau` (M, n) [N m at the joint] beside their channels, and the
        IMUs' in theirs.

    Raises
    ------
    InputError
        A joint has no position, some joints have no torque, two publishers cannot be
        told apart, or the log is too short.
    """
    where = str(path)
    warnings = list(raw.warnings)

    # What was logged, without what cannot be the robot's, in the order of time.
    joints = without_absurd(raw.joints, warnings)
    joints = without_second_publisher(joints, where, warnings)
    _check_positions(joints, robot, where)
    messages = [without_absurd(stream, warnings) for stream in raw.commands]
    joints = with_signs(joints, robot, warnings, commands=messages)
    joints = with_torque(joints, robot, raw.prefer_current, where, warnings)
    tidied = tidy(joints)
    repair = mended(tidied.stream)
    logged = repair.stream

    # Position and torque must be measured for a sample to be valid.
    base = make_base(logged, where)
    position = resample(logged, "position", base)
    valid = position.valid
    gaps = {*position.gaps, *base.gaps}
    tau = None
    if "tau" in logged.channels:
        torque = resample(logged, "tau", base)
        tau = torque.values
        valid = valid & torque.valid
        gaps.update(torque.gaps)

    # Other channels count where they are whole.
    dq = _of_all_joints(logged, "velocity", base, warnings)
    load = _of_all_joints(logged, "load", base, warnings)
    link_position = _of_all_joints(logged, "link_position", base, warnings)
    temperature = None
    if np.isfinite(logged.channels.get("temperature", np.nan)).any():
        temperature = resample(logged, "temperature", base).values

    commands = commands_on_base(logged, messages, base)

    warnings += [*tidied.warnings, *repair.warnings]
    imus = _read_imus(raw, robot, base, tidied.even, repair, warnings)
    recording = Recording(
        path=path,
        sha256=digest,
        format=kind,
        t=base.t,
        q=position.values,
        valid=valid & imus.valid,
        health=Health(
            rate_hz=1.0 / base.step_s,
            jitter=base.jitter,
            gaps=tuple(sorted(gaps)),
            non_monotonic=tidied.steps_back,
            duplicates=tidied.duplicates,
            resampled=not base.exact,
            log_minus_header_s=raw.log_minus_header_s,
            warnings=tuple(dict.fromkeys(warnings)),
            mended=repair.warnings,
            imu_rates_hz=imus.rates_hz,
        ),
        dq=dq,
        tau=tau,
        temperature=temperature,
        load=load,
        link_position=link_position,
        command=commands.values.get("command"),
        command_velocity=commands.values.get("command_velocity"),
        command_torque=commands.values.get("command_torque"),
        command_form=commands.form,
        command_age=commands.age,
        accelerometers=imus.accelerometers,
        gyros=imus.gyros,
        start=base.start_ns * 1e-9,
        partial=raw.partial,
        bridged=_bridged(repair, base),
    )
    return recording, replace(raw, joints=logged, imus=raw.imus | imus.streams)


def _check_positions(joints: Stream, robot: Robot, where: str) -> None:
    """Raise InputError where a joint of the robot has no position at all."""
    has_position = np.isfinite(joints.channels["position"]).any(axis=0)
    missing = [robot.joint_names[j] for j in np.flatnonzero(~has_position)]
    if missing:
        raise InputError(
            f"no position of joint {', '.join(missing)}: {len(joints)} samples, all"
            " without it",
            hint="Log all joints of the robot file, by the names that it gives them.",
            where=where,
        )


def _bridged(repair: Mended, base: Base) -> Mask | None:
    """Return the samples (N,) of the base that lie nearest to some not measured."""
    if not repair.bridged.any():
        return None
    seconds = (repair.stream.stamp_ns - base.start_ns) * 1e-9
    midpoints = 0.5 * (seconds[1:] + seconds[:-1])
    nearest = np.searchsorted(midpoints, base.t)
    return np.asarray(repair.bridged[nearest])


def without_absurd(
    stream: Stream, warnings: list[str], *, most: float = ABSURD, least: float = NOTHING
) -> Stream:
    """Treat values that are infinite or larger than `most` as missing, and say so.

    A torque or current that never reaches `least` is zero: squares of its values would
    vanish by rounding.
    """
    channels: dict[str, Array] = {}
    n_absurd = 0
    for name, values in stream.channels.items():
        size = np.abs(values)
        is_absurd = size > most
        n_absurd += int(np.count_nonzero(is_absurd))
        channels[name] = values
        if is_absurd.any():
            channels[name] = np.where(is_absurd, np.nan, values)
        is_nothing = ~(size >= least).any(axis=0) & (size > 0.0)
        if name in EFFORTS and is_nothing.any():
            channels[name] = np.where(is_nothing, 0.0, channels[name])

    if not n_absurd:
        return replace(stream, channels=channels)
    warnings.append(
        f"{stream.name}: {n_absurd} values are infinite or beyond {most:g}; taken as"
        " missing"
    )
    return replace(stream, channels=channels)


def with_torque(
    joints: Stream, robot: Robot, prefer_current: bool, where: str, warnings: list[str]
) -> Stream:
    """Add the torque `tau`: the logged one, else by current and drive data.

    Parameters
    ----------
    joints : Stream
        Joint samples with `torque` (M, n) [N m] or `current` (M, n) [A], or neither.
    robot : Robot
        Torque constants [N m / A] and gear ratios.
    prefer_current : bool
        Whether a current counts more than a torque of the same joint.
    where : str
        The log, for messages.
    warnings : list of str
        A current that cannot be turned into torque is added to it.

    Returns
    -------
    Stream
        With `tau` (M, n) [N m at the joint] where every joint has it, else as it was.

    Raises
    ------
    TorqueLackingError
        Some joints have neither, and others have one.
    """
    missing = np.full((len(joints), robot.n), np.nan)
    torque = joints.channels.get("torque", missing)
    current = joints.channels.get("current", missing)
    torque_per_ampere = np.array(
        [joint.torque_per_ampere for joint in robot.joints], np.float64
    )
    torque_by_current = current * torque_per_ampere  # NaN without drive data

    preferred, fallback = torque, torque_by_current
    if prefer_current:
        preferred, fallback = torque_by_current, torque
    tau = np.where(np.isfinite(preferred).any(axis=0), preferred, fallback)

    has_torque: Mask = np.asarray(np.isfinite(tau).any(axis=0))
    has_current: Mask = np.asarray(np.isfinite(current).any(axis=0))
    names = np.array(robot.joint_names)
    without_drive_data = names[has_current & ~has_torque]
    if len(without_drive_data):
        warnings.append(
            f"the current of {', '.join(without_drive_data)} cannot be turned into"
            " torque: give torque_constant and gear_ratio in the robot file"
        )
        return joints
    if has_torque.all():
        return replace(joints, channels={**joints.channels, "tau": tau})
    if has_torque.any():
        raise TorqueLackingError(names[~has_torque].tolist(), where)
    return joints


def _of_all_joints(
    stream: Stream, quantity: str, base: Base, warnings: list[str]
) -> Array | None:
    """Resample an optional channel to (N, n); None where not every joint has it."""
    if quantity not in stream.channels:
        return None
    values = resample(stream, quantity, base).values
    is_logged = np.isfinite(values)
    if is_logged.all():
        return values
    if is_logged.any():
        warnings.append(f"{quantity} is logged for some joints only; it is left out")
    return None


@dataclass(frozen=True, kw_only=True)
class _ImuReadings:
    """Readings of all IMUs on the time base."""

    accelerometers: dict[str, Array]  # (N, K) m/s^2 by IMU
    gyros: dict[str, Array]  # (N, 3) rad/s by IMU
    valid: Mask  # (N,) where all of them are measured
    rates_hz: dict[str, float]  # of their own samples
    streams: dict[str, tuple[Stream, ...]]  # in the order of time, mended


def _read_imus(
    raw: RawLog,
    robot: Robot,
    base: Base,
    even_joints: EvenStream | None,
    repair: Mended,
    warnings: list[str],
) -> _ImuReadings:
    """Bring the IMUs of the robot to the base; one that cannot be used is left out.

    `even_joints`: the joint samples where they were laid evenly; IMUs that have their
    stamps follow.
    """
    by_quantity: dict[str, dict[str, Array]] = {ACCELEROMETERS: {}, GYRO: {}}
    valid = np.ones(base.count, np.bool_)
    rates_hz: dict[str, float] = {}
    mended_streams: dict[str, tuple[Stream, ...]] = {}
    for imu in robot.imus:
        streams: list[Stream] = []
        clock_warnings: list[str] = []
        for stream in raw.imus.get(imu.name, ()):
            readings = without_zeros(without_absurd(stream, warnings), warnings)
            tidied = tidy(readings, even_joints)
            clock_warnings += tidied.warnings
            streams.append(_with_losses_of_joints(tidied.stream, repair))
        if not streams or not _is_usable(imu.name, streams, base, warnings):
            continue

        rates_hz[imu.name] = rate_of(streams)
        mended_streams[imu.name] = tuple(streams)
        for quantity, values_by_imu in by_quantity.items():
            parts = [
                resample(stream, quantity, base)
                for stream in streams
                if quantity in stream.channels
            ]
            if parts:
                values_by_imu[imu.name] = np.hstack([part.values for part in parts])
                valid &= np.all([part.valid for part in parts], axis=0)
        warnings += clock_warnings
    return _ImuReadings(
        accelerometers=by_quantity[ACCELEROMETERS],
        gyros=by_quantity[GYRO],
        valid=valid,
        rates_hz=rates_hz,
        streams=mended_streams,
    )


def _with_losses_of_joints(stream: Stream, repair: Mended) -> Stream:
    """Mend an IMU's stream as the joints were, where it has their stamps."""
    if not np.array_equal(stream.stamp_ns, repair.stamps):
        return stream
    mended_stream, _ = with_losses(stream, repair.losses)
    return mended_stream


def _is_usable(
    name: str, streams: list[Stream], base: Base, warnings: list[str]
) -> bool:
    """Tell whether an IMU can be used on the base; a warning says why it cannot."""
    for stream in streams:
        covered_share = overlap(stream, base)
        fault = ""
        empty = [
            quantity
            for quantity, values in stream.channels.items()
            if not np.isfinite(values).any(axis=0).all()
        ]
        if empty:
            fault = f"{stream.name} has no {empty[0]} values"
        elif covered_share <= 0.0:
            fault = (
                f"the stamps of {stream.name} do not overlap those of the joints; let"
                " both use one clock, or use the times of logging"
            )
        if fault:
            warnings.append(f"IMU {name!r} is left out: {fault}")
            return False

        if covered_share < 0.99:
            warnings.append(
                f"{stream.name} covers {percent(covered_share, 0)} of the joints' time;"
                " samples outside it are not valid"
            )
    return True
