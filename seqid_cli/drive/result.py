"""The document of a drive: each number with its state, verdicts, and notes."""

from collections.abc import Mapping, Sequence

import numpy as np

from seqid_cli.drive.equations import (
    ACCELERATION_FEEDFORWARD,
    DERIVATIVE,
    GRAVITY,
    INTEGRAL,
    PARTS,
    PROPORTIONAL,
    UNITS,
    VELOCITY_FEEDFORWARD,
)
from seqid_cli.drive.fit import JointFit
from seqid_cli.drive.settings import DriveSettings, DriveVerdictSettings
from seqid_cli.drive.signals import DriveSignals
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.params.document import head, robot_id, used_settings, worst_level
from seqid_cli.params.results.drive import (
    DRIVE_SCHEMA,
    DriveFile,
    DriveParameter,
    JointDrive,
)
from seqid_cli.params.schema import Verdict
from seqid_cli.shares import percent
from seqid_cli.units import unit_of

# What to record where the logs cannot show a part.
RECORD: Mapping[str, str] = {
    PROPORTIONAL: "move the joint by commands that it has to follow quickly",
    DERIVATIVE: "record a chirp up to twice the loop's bandwidth",
    VELOCITY_FEEDFORWARD: "record a chirp up to twice the loop's bandwidth",
    ACCELERATION_FEEDFORWARD: "record a chirp up to twice the loop's bandwidth",
    INTEGRAL: "hold the joint for some seconds between moves, against gravity",
    GRAVITY: "move the joint, or those before it, to where gravity's torque differs",
}
# Delays of joints that differ by less than so many standard errors are one.
SAME_DELAY_SIGMA = 3.0
# Of the proportional gain, as its standard error: up to it a joint is good.
MAX_ERROR = 0.1
# Times a standard error, to either side: 95 %.
INTERVAL = 1.96


def drive_file(
    fits: Mapping[str, JointFit],
    faults: Mapping[str, str],
    logs: Sequence[DriveSignals],
    inputs: Inputs,
    log_set: LogSet,
    settings: DriveSettings,
) -> DriveFile:
    """Describe fits as the document of a drive.

    Parameters
    ----------
    fits : mapping of str to JointFit
        By joint.
    faults : mapping of str to str
        Why a joint has none, by joint.
    logs : sequence of DriveSignals
    inputs : Inputs
        Robot and model that the logs were read with.
    log_set : LogSet
        The logs, read.
    settings : DriveSettings
    """
    prismatic = {joint.name for joint in inputs.robot.joints if joint.prismatic}
    joints = {
        name: _joint(fit, slides=name in prismatic, measured=logs[0].measured)
        for name, fit in fits.items()
    }
    common = common_delay(joints)
    of_joints = [
        *(
            Verdict(joint=name, good=False, reason=reason)
            for name, reason in faults.items()
        ),
        *(verdict_of_joint(name, fit, settings.verdict) for name, fit in fits.items()),
    ]
    verdicts = [
        _verdict_of_all(of_joints),
        *log_set.verdicts(),
        *of_joints,
    ]
    return DriveFile(
        **head(DRIVE_SCHEMA, log_set.created(inputs.documents)),
        robot=robot_id(inputs.robot),
        inputs=log_set.inputs(),
        models=inputs.ids(),
        method="torque" if logs[0].measured else "motion",
        command_delay=common,
        joints=joints,
        stages=inputs.stages,
        cutoff_hz=logs[0].cutoff_hz,
        verdicts=verdicts,
        notes=[*log_set.notes(), *_notes(joints, common, inputs)],
        effective_settings=used_settings(settings),
    )


def _joint(fit: JointFit, *, slides: bool, measured: bool) -> JointDrive:
    parameters = [_delay(fit), _lag(fit, measured=measured)]
    parameters += [_part(fit, name, slides=slides) for name in PARTS]
    parameters += [
        _torque_limit(fit, slides=slides),
        _velocity_limit(fit, slides=slides),
    ]
    return JointDrive(
        parameters=parameters,
        command=fit.course,
        command_known=fit.course_is_known,
        left=fit.left,
        rmse=fit.rmse,
        samples=fit.rows,
        offset=fit.offset,
    )


def _identified(
    name: str, value: float, std_error: float, unit: str, reason: str = ""
) -> DriveParameter:
    return DriveParameter(
        name=name,
        value=value,
        std_error=std_error,
        unit=unit,
        state="identified",
        low=value - INTERVAL * std_error,
        high=value + INTERVAL * std_error,
        reason=reason,
    )


def _delay(fit: JointFit) -> DriveParameter:
    reason = ""
    if not fit.course_is_known:
        reason = (
            "the logs do not tell whether commands hold or are interpolated: if they"
            " are, it is half a command's period longer"
        )
    return _identified(
        "command_delay",
        fit.values["command_delay"],
        fit.std_errors["command_delay"],
        "s",
        reason,
    )


def _lag(fit: JointFit, *, measured: bool) -> DriveParameter:
    if not measured:
        return DriveParameter(
            name="torque_lag",
            value=None,
            std_error=None,
            unit="s",
            state="not_shown",
            reason="there is no measured torque: log it",
        )
    return _identified(
        "torque_lag", fit.values["torque_lag"], fit.std_errors["torque_lag"], "s"
    )


def _part(fit: JointFit, name: str, *, slides: bool) -> DriveParameter:
    unit = unit_of(UNITS[name], slides)
    if name in fit.names:
        return _identified(name, fit.values[name], fit.std_errors[name], unit)
    if name in fit.refused:
        error = fit.refused[name]
        return DriveParameter(
            name=name,
            value=0.0,
            std_error=error,
            unit=unit,
            state="absent",
            low=-INTERVAL * error,
            high=INTERVAL * error,
        )
    return DriveParameter(
        name=name,
        value=None,
        std_error=None,
        unit=unit,
        state="not_shown",
        reason=_why_not_shown(fit, name),
    )


def _why_not_shown(fit: JointFit, name: str) -> str:
    if name not in fit.own_shares:
        if fit.course == "held":
            return "commands that hold have no slope to feed forward"
        return "only a measured torque shows it: log it"
    share = percent(fit.own_shares[name])
    return f"other parts explain all but {share} of it: {RECORD[name]}"


def _torque_limit(fit: JointFit, *, slides: bool) -> DriveParameter:
    unit = unit_of("N m", slides)
    if fit.limit is not None:
        return _identified("torque_limit", fit.limit.value, fit.limit.std_error, unit)
    return DriveParameter(
        name="torque_limit",
        value=None,
        std_error=None,
        unit=unit,
        state="not_reached",
        low=fit.largest_torque,
        reason="never reached: record large steps",
    )


def _velocity_limit(fit: JointFit, *, slides: bool) -> DriveParameter:
    limit = fit.speed_limit
    if limit is not None:
        unit = unit_of("rad/s", slides)
        return _identified("velocity_limit", limit.value, limit.std_error, unit)
    return DriveParameter(
        name="velocity_limit",
        value=None,
        std_error=None,
        unit=unit_of("rad/s", slides),
        state="not_reached",
        low=fit.largest_speed,
        reason="never reached: record large steps",
    )


def common_delay(joints: Mapping[str, JointDrive]) -> DriveParameter | None:
    """Return the delay that all joints share, None where they differ."""
    delays = [joint.parameters[0] for joint in joints.values()]
    if not delays:
        return None
    values = np.array([delay.value for delay in delays], np.float64)
    errors = np.array([delay.std_error for delay in delays], np.float64)
    weights = errors**-2.0
    mean = float(np.average(values, weights=weights))
    if (np.abs(values - mean) > SAME_DELAY_SIGMA * errors).any():
        return None
    # Stamps that are off are so for all joints: the error does not average out.
    return _identified("command_delay", mean, float(errors.min()), "s")


def verdict_of_joint(name: str, fit: JointFit, limits: DriveVerdictSettings) -> Verdict:
    """Judge the controller of a joint by what it leaves, and by its gain's error."""
    error = fit.std_errors[PROPORTIONAL] / max(abs(fit.values[PROPORTIONAL]), 1e-300)
    left = percent(fit.left)
    if fit.values[PROPORTIONAL] <= 0.0:
        reason = (
            "the torque drives the joint away from its command: check the signs, or the"
            " joint does not follow this command"
        )
        return Verdict(joint=name, good=False, reason=reason)
    if fit.left > limits.max_left:
        reason = f"{left} of the torque is left: the controller is of another form"
        return Verdict(joint=name, good=False, reason=reason)
    if error > MAX_ERROR or fit.left > limits.good_left:
        reason = (
            f"{left} of the torque is left, the proportional gain is known to"
            f" {percent(error)}"
        )
        return Verdict(joint=name, good=False, level="usable", reason=reason)
    return Verdict(joint=name, good=True)


def _verdict_of_all(of_joints: Sequence[Verdict]) -> Verdict:
    """Return the verdict on the drive: that of the worst joint."""
    level = worst_level(of_joints) or "poor"
    names = [verdict.joint for verdict in of_joints if verdict.level == level]
    reason = "" if level == "good" else f"{', '.join(names)}: see there"
    return Verdict(good=level == "good", level=level, reason=reason)


def _notes(
    joints: Mapping[str, JointDrive], common: DriveParameter | None, inputs: Inputs
) -> list[str]:
    notes = []
    if joints and common is None:
        notes.append("the joints' command delays differ by more than their errors")
    if inputs.stages.effects:
        names = dict.fromkeys(effect.effect for effect in inputs.stages.effects)
        notes.append(
            "effects of the model do not take part in the drive's fit:"
            f" {', '.join(names)}"
        )
    return notes
