"""Checks of one log in their order, for `seqid inspect` and for stages that read it.

Channels are compared with each other without samples that are known to be damaged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from seqid_cli.inspect.channels import clock, commands, positions, torques
from seqid_cli.inspect.channels.positions import Break
from seqid_cli.inspect.channels.values import missing
from seqid_cli.inspect.channels.velocities import velocity_findings
from seqid_cli.inspect.dynamics.angles import unit_by_equations
from seqid_cli.inspect.dynamics.equations import geometry_findings
from seqid_cli.inspect.dynamics.friction import friction_findings, sample_of
from seqid_cli.inspect.findings import finding_of, grouped
from seqid_cli.inspect.imu.motion import FOLLOWS, LinkFit, follow, motion_findings
from seqid_cli.inspect.imu.readings import imu_findings
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.read import assemble
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.params.results.inspection import InspectionFinding

Codes = frozenset[str]

# Findings whose samples are taken out.
TAKEN_OUT: Codes = frozenset({"position_spikes", "position_frozen"})
# Findings that spoil what is computed from the motion or torque of their joint.
SPOIL: Codes = frozenset(
    {
        "position_in_degrees",
        "position_in_mm",
        "position_in_turns",
        "position_in_counts",
        "position_in_percent",
        "position_scale",
        "position_motor_side",
        "position_jump",
        "position_stuck",
        "joints_swapped",
        "sign_mismatch",
        "torque_zero",
        "torque_constant_value",
        "torque_stuck",
        "torque_echo",
        "axis_flipped",
        "position_zero",
        "current_in_ma",
        "effort_unsigned",
        "effort_sign_bit",
        "gear_inverse",
        "values_absurd",
        "values_lost",
    }
)
# Units of angles, of which the equations know more than the sizes of positions.
ANGLE_UNITS: Codes = frozenset(
    {"position_in_degrees", "position_in_turns", "position_in_counts"}
)
# Findings that spoil it for all joints.
SPOIL_ALL: Codes = frozenset(
    {
        "time_unit",
        "time_scale",
        "clock_set_back",
        "stamps_far_off",
        "drive_data_missing",
    }
)


@dataclass(frozen=True)
class Explanation:
    """Findings that are left out at a joint where one of the causes explains them.

    Those with a cause that is found `anywhere` are left out at all joints.
    """

    causes: Codes
    explained: Codes
    anywhere: bool = False


_EXPLANATIONS = (
    Explanation(
        causes=frozenset(
            {
                "position_in_degrees",
                "position_in_mm",
                "position_in_turns",
                "position_in_counts",
                "position_in_percent",
                "position_motor_side",
                "joints_swapped",
            }
        ),
        explained=frozenset(
            {
                "position_limits",
                "speed_limit",
                "velocity_inconsistent",
                "encoder_resolution",
            }
        ),
    ),
    # A servo drives towards its goal: such a sign is wrong at times, never reversed.
    Explanation(
        causes=frozenset({"sign_by_command"}), explained=frozenset({"sign_mismatch"})
    ),
    Explanation(
        causes=frozenset({"torque_zero", "torque_constant_value"}),
        explained=frozenset({"torque_echo"}),
    ),
    Explanation(
        causes=frozenset({"torque_echo"}),
        explained=frozenset({"torque_saturated", "torque_quantised", "torque_stuck"}),
    ),
    Explanation(
        causes=frozenset(
            {
                "current_in_ma",
                "effort_is_current",
                "effort_is_torque",
                "effort_sign_bit",
                "torque_scale",
            }
        ),
        explained=frozenset({"torque_limit", "effort_limits"}),
        anywhere=True,
    ),
    Explanation(
        causes=frozenset({"values_lost"}), explained=frozenset({"channel_hole"})
    ),
    Explanation(
        causes=frozenset({"gyro_in_degrees"}), explained=frozenset({"gyro_bias"})
    ),
)
# Findings that a clock which scatters makes of sound values.
_UNEVEN: Codes = frozenset({"velocity_inconsistent", "speed_limit", "position_jump"})


def check(
    data: LogData, *, imus: bool = True, quality: bool = True
) -> tuple[LogData, list[InspectionFinding], list[LinkFit]]:
    """Check a log: a check is left out where an earlier finding spoils it.

    Parameters
    ----------
    data : LogData
        A log, or a part of one.
    imus : bool
        Whether IMUs are checked.
    quality : bool
        Whether it is also judged how well channels are measured (steps, held values,
        temperature): warnings at most.

    Returns
    -------
    sound : LogData
        The log without damaged samples.
    findings : list of InspectionFinding
        Each code once per joint and channel.
    link_fits : list of LinkFit
        How IMUs follow their links.
    """
    breaks = positions.breaks_of(data.robot, data.t, data.joints.channels["position"])
    sound = without(data, breaks)
    link_fits = follow(sound) if imus else []

    # Each channel by itself.
    findings = [*clock.clock_findings(data), *clock.hole_findings(data)]
    if data.recording.partial:
        findings.append(finding_of("salvaged", data.recording.partial))
    of_torques = [*torques.torque_findings(data), *torques.echo_findings(data)]
    findings += of_torques
    of_missing = [*_missing_values(data)]
    if not quality:
        of_missing = [f for f in of_missing if f.severity == "error"]
    findings += of_missing
    if quality:
        spoilt_joints = {f.joint for f in of_torques if f.code in SPOIL}
        findings += torques.torque_quality(data, spoilt_joints)
        findings += torques.temperature_findings(data)
        findings += torques.sensor_findings(data)
        findings += commands.command_findings(data)
    if imus and not _all_spoilt(findings):
        findings += imu_findings(data)
    if not _all_spoilt(findings):
        findings += _of_positions(data, breaks, quality=quality)

    # Channels against each other.
    findings = _measured_unit(sound, _unexplained(findings))
    if not _all_spoilt(findings):
        findings += _of_dynamics(sound, findings, link_fits)
    groups = grouped(_unexplained(findings))
    return sound, [group[0] for group in groups], link_fits


def without(data: LogData, breaks: Sequence[Break]) -> LogData:
    """Take damaged samples out of a log, and lay it on its time base anew.

    Short holes are bridged by a curve, longer ones are not valid, like any missing
    values.
    """
    if not any(len(damage.rows) for damage in breaks):
        return data
    position = data.joints.channels["position"].copy()
    for damage in breaks:
        position[damage.rows, damage.joint] = np.nan
    channels = {**data.joints.channels, "position": position}
    raw = replace(data.raw, joints=replace(data.joints, channels=channels))

    log = data.recording
    recording, _ = assemble(log.path, log.format, log.sha256, raw, data.robot)
    # The clock has not changed: what it says of the log stays, but for more gaps.
    gaps = tuple(sorted({*log.health.gaps, *recording.health.gaps}))
    health = replace(log.health, gaps=gaps, resampled=recording.health.resampled)
    return replace(data, raw=raw, recording=replace(recording, health=health))


def _missing_values(data: LogData) -> Iterator[InspectionFinding]:
    """Find values that are missing in the position and the torque of every joint."""
    columns = [("position", data.joints.channels["position"])]
    effort = data.effort()
    if effort is not None:
        columns.append(effort)
    for quantity, values in columns:
        for j, name in enumerate(data.robot.joint_names):
            yield from missing(
                values[:, j],
                data.t,
                name,
                quantity,
                data.settings.channels.max_missing,
            )


def _all_spoilt(findings: Sequence[InspectionFinding]) -> bool:
    """Return whether nothing can be computed from the motion of any joint."""
    return any(finding.code in SPOIL_ALL for finding in findings)


def _of_positions(
    data: LogData, breaks: Sequence[Break], *, quality: bool
) -> list[InspectionFinding]:
    """Check positions and velocities."""
    of_positions = [*positions.position_findings(data, breaks)]
    spoilt = {f.joint for f in of_positions if f.code in SPOIL | TAKEN_OUT}
    findings = [*velocity_findings(data, spoilt)]
    if not _all_spoilt(findings):
        findings += of_positions
        findings += positions.too_fast(data)
    if quality:
        findings += positions.position_quality(data, {f.joint for f in of_positions})
    if data.recording.health.jitter > JITTER_LIMIT:
        # Slopes over times that scatter mean nothing.
        findings = [f for f in findings if f.code not in _UNEVEN]
    return findings


def _of_dynamics(
    data: LogData, findings: list[InspectionFinding], link_fits: Sequence[LinkFit]
) -> list[InspectionFinding]:
    """Compare torque, motion and IMUs with each other; `findings` are those so far."""
    # Accelerations mean nothing where times scatter.
    spoilt = {f.code for f in findings} & {*SPOIL, "jitter"}
    sample = None if spoilt else sample_of(data)
    of_torque: list[InspectionFinding] = []
    if sample is not None:
        of_friction = [*friction_findings(data, sample)]
        of_torque = geometry_findings(data, sample, of_friction)
    of_dynamics = [_with_blame(finding, data, link_fits) for finding in of_torque]
    if any(finding.code == "gravity_direction" for finding in of_torque):
        return of_dynamics  # IMUs are compared with it

    # A zero that is off, which may be why limits are exceeded, turns the link.
    spoilt_joints = _joints_of(
        [f for f in (*findings, *of_torque) if f.code in SPOIL | {"position_limits"}]
    )
    if not spoilt_joints & set(data.robot.joint_names):
        broken_imus = {
            f.joint
            for f in findings
            if f.severity == "error" or f.code == "imu_saturated"
        }
        sound_fits = [fit for fit in link_fits if fit.imu.name not in broken_imus]
        of_dynamics += motion_findings(data, sound_fits)
    return of_dynamics


def _measured_unit(
    data: LogData, findings: list[InspectionFinding]
) -> list[InspectionFinding]:
    """Let the equations say in which unit all angles are, where limits or speeds do.

    Degrees and percent of a range look alike by their sizes.
    """
    spoilt = [finding for finding in findings if finding.code in SPOIL]
    units = [finding for finding in spoilt if finding.code in ANGLE_UNITS]
    if not units or len(spoilt) > len(units) or not data.modelled:
        return findings
    sample = sample_of(data)
    if sample is None or not sample.moving:
        return findings
    # Of one joint in degrees the equations of all joints say nothing.
    revolute = {
        joint.name
        for j, joint in enumerate(data.robot.joints)
        if data.moves(j) and not joint.prismatic
    }
    if not revolute <= {finding.joint for finding in units}:
        return findings
    measured = unit_by_equations(sample)
    if measured is None:
        return findings
    return [*(finding for finding in findings if finding not in units), measured]


def _joints_of(findings: Sequence[InspectionFinding]) -> set[str]:
    """Return the names of joints and IMUs that findings are about."""
    return {name for finding in findings for name in finding.joint.split(", ")}


def _with_blame(
    finding: InspectionFinding, data: LogData, link_fits: Sequence[LinkFit]
) -> InspectionFinding:
    """Add to a sign that is wrong whether the IMUs blame the position or the torque."""
    if finding.code != "sign_mismatch":
        return finding
    joint = data.robot.joint_names.index(finding.joint)
    moved_fits = [fit for fit in link_fits if fit.imu.after_joint >= joint]
    if not moved_fits:
        return finding
    # IMUs know nothing of the torque: where they follow their links, the position is
    # right.
    one_strays = any(fit.left > FOLLOWS for fit in moved_fits)
    blamed = "position" if one_strays else "torque"
    message = f"{finding.message}; by the IMUs it is the {blamed}'s"
    return structs.replace(finding, message=message)


def _unexplained(findings: list[InspectionFinding]) -> list[InspectionFinding]:
    """Leave out what another finding of the same joint already explains."""
    places = {
        (name, finding.code)
        for finding in findings
        for name in finding.joint.split(", ")
    }
    codes = {finding.code for finding in findings}

    def is_explained(finding: InspectionFinding) -> bool:
        return any(
            finding.code in explanation.explained
            and any(
                (finding.joint, cause) in places
                or (explanation.anywhere and cause in codes)
                for cause in explanation.causes
            )
            for explanation in _EXPLANATIONS
        )

    return [finding for finding in findings if not is_explained(finding)]
