"""The checks of one log, in their order: those of `seqid inspect` and of every stage that reads it.

Channels are compared with each other without samples that are known to be damaged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from msgspec import structs

from seqid_cli.inspect.channels import clock, positions, torques
from seqid_cli.inspect.channels.positions import Break
from seqid_cli.inspect.channels.velocities import velocity_findings
from seqid_cli.inspect.dynamics.equations import geometry_findings
from seqid_cli.inspect.dynamics.friction import friction_findings, sample_of
from seqid_cli.inspect.findings import found, grouped
from seqid_cli.inspect.imu.motion import FOLLOWS, LinkFit, follow, motion_findings
from seqid_cli.inspect.imu.readings import imu_findings
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.read import assemble
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.params.results.inspection import InspectionFinding

Codes = frozenset[str]


def _codes(text: str) -> Codes:
    return frozenset(text.split())


# Findings whose samples are taken out, and those that spoil what is computed from the
# motion of a joint, or of all joints.
TAKEN_OUT = _codes("position_spikes position_frozen")
SPOIL = _codes(
    "position_in_degrees position_in_mm position_motor_side position_jump"
    " position_stuck joints_swapped sign_mismatch torque_zero torque_constant_value"
    " torque_stuck torque_echo axis_flipped position_zero current_in_ma values_absurd"
)
SPOIL_ALL = _codes("time_unit clock_set_back stamps_far_off drive_data_missing")
# What is left out of a joint where one of the first codes explains it.
_EXPLAINED: tuple[tuple[Codes, Codes], ...] = (
    (
        _codes("position_in_degrees position_in_mm position_motor_side joints_swapped"),
        _codes("position_limits speed_limit velocity_inconsistent encoder_resolution"),
    ),
    (_codes("torque_zero torque_constant_value"), _codes("torque_echo")),
    (_codes("torque_echo"), _codes("torque_saturated torque_quantised torque_stuck")),
    (_codes("gyro_in_degrees"), _codes("gyro_bias")),
)
# What a clock that scatters makes of sound values.
_UNEVEN = _codes("velocity_inconsistent speed_limit position_jump values_missing")


def check(
    data: LogData, *, imus: bool = True, quality: bool = True
) -> tuple[LogData, list[InspectionFinding], list[LinkFit]]:
    """Check a log: a check is left out where an earlier finding spoils it.

    `quality`: whether it is also judged how well channels are measured (steps, held
    values, temperature): warnings at most. Returns: the log without damaged samples;
    findings, each code once per joint and channel; how IMUs follow their links.
    """
    breaks = positions.breaks_of(data.robot, data.t, data.joints.channels["position"])
    sound = without(data, breaks)
    following = follow(sound) if imus else []
    own = [*clock.clock_findings(data), *clock.hole_findings(data)]
    if data.recording.partial:
        own.append(found("salvaged", data.recording.partial))
    of_torques = [*torques.torque_findings(data), *torques.echo_findings(data)]
    own += of_torques
    if quality:
        own += torques.torque_quality(
            data, {f.joint for f in of_torques if f.code in SPOIL}
        )
        own += [*torques.temperature_findings(data), *torques.sensor_findings(data)]
    if imus and not _all_spoilt(own):
        own += imu_findings(data)
    if not _all_spoilt(own):
        own += _of_positions(data, breaks, quality=quality)
    own = _unexplained(own)
    if not _all_spoilt(own):
        own += _of_dynamics(sound, own, following)
    return sound, [first for first, *_ in grouped(_unexplained(own))], following


def without(data: LogData, breaks: Sequence[Break]) -> LogData:
    """Take the samples of a log out that are known to be wrong, and lay it on its base anew.

    Short holes are bridged by a curve, longer ones are not valid, like any missing
    values.
    """
    if not any(len(each.rows) for each in breaks):
        return data
    position = data.joints.channels["position"].copy()
    for each in breaks:
        position[each.rows, each.joint] = np.nan
    joints = replace(
        data.joints, channels={**data.joints.channels, "position": position}
    )
    raw = replace(data.raw, joints=joints)
    log = data.recording
    again, _ = assemble(log.path, log.format, log.sha256, raw, data.robot)
    gaps = tuple(sorted({*log.health.gaps, *again.health.gaps}))
    health = replace(log.health, gaps=gaps, resampled=again.health.resampled)
    return replace(data, raw=raw, recording=replace(again, health=health))


def _all_spoilt(findings: Sequence[InspectionFinding]) -> bool:
    return any(finding.code in SPOIL_ALL for finding in findings)


def _of_positions(
    data: LogData, breaks: Sequence[Break], *, quality: bool
) -> list[InspectionFinding]:
    """Check positions and velocities."""
    of_positions = [*positions.position_findings(data, breaks)]
    spoilt = {f.joint for f in of_positions if f.code in SPOIL | TAKEN_OUT}
    own = [*velocity_findings(data, spoilt)]
    if not _all_spoilt(own):
        own += [*of_positions, *positions.fast_in_degrees(data)]
    if quality:
        own += positions.position_quality(data, {f.joint for f in of_positions})
    # slopes over such times mean nothing
    uneven = data.recording.health.jitter > JITTER_LIMIT
    return [f for f in own if not (uneven and f.code in _UNEVEN)]


def _of_dynamics(
    data: LogData, own: list[InspectionFinding], following: Sequence[LinkFit]
) -> Iterator[InspectionFinding]:
    """Compare torque, motion and IMUs with each other; `own` are the findings so far."""
    # accelerations mean nothing with jitter
    spoilt = {f.code for f in own} & {*SPOIL, "jitter"}
    sample = None if spoilt else sample_of(data)
    against: list[InspectionFinding] = []
    if sample is not None:
        against = geometry_findings(data, sample, [*friction_findings(data, sample)])
    yield from (_with_imus(finding, data, following) for finding in against)
    if any(finding.code == "gravity_direction" for finding in against):
        return  # IMUs are compared with it
    spoil = SPOIL | {"position_limits"}  # a zero that is off turns the link
    joints = {
        name
        for f in (*own, *against)
        if f.code in spoil
        for name in f.joint.split(", ")
    }
    if not joints & set(data.robot.joint_names):
        broken = {
            f.joint for f in own if f.severity == "error" or f.code == "imu_saturated"
        }
        yield from motion_findings(
            data, [f for f in following if f.imu.name not in broken]
        )


def _with_imus(
    finding: InspectionFinding, data: LogData, following: Sequence[LinkFit]
) -> InspectionFinding:
    """Add to a sign that is wrong whether the IMUs blame the position."""
    names = data.robot.joint_names
    wrong = finding.code == "sign_mismatch"
    moved = [
        f
        for f in following
        if wrong and f.imu.after_joint >= names.index(finding.joint)
    ]
    if not moved:
        return finding
    blamed = "position" if any(f.left > FOLLOWS for f in moved) else "torque"
    return structs.replace(
        finding, message=f"{finding.message}; by the IMUs it is the {blamed}'s"
    )


def _unexplained(findings: list[InspectionFinding]) -> list[InspectionFinding]:
    """Leave out what another finding of the same joint already explains."""
    there = {(name, f.code) for f in findings for name in f.joint.split(", ")}

    def explained(finding: InspectionFinding) -> bool:
        causes = [codes for codes, own in _EXPLAINED if finding.code in own]
        return any((finding.joint, code) in there for codes in causes for code in codes)

    return [finding for finding in findings if not explained(finding)]
