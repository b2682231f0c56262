"""The document of a drive: each number with its state, verdicts, and notes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from seqid_cli.drive.rollouts.fit import WindowFit
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.drive.settings import DriveSettings, DriveVerdictSettings
from seqid_cli.drive.signals import DriveSignals, courses_of_all
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.params.document import head, robot_id, used_settings, worst_level
from seqid_cli.params.results.drive import (
    DRIVE_SCHEMA,
    DriveFile,
    DriveParameter,
    JointDrive,
)
from seqid_cli.params.schema import Stages, Verdict
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
# Units of what windows of simulated motion tell beside the parts of the controller.
WINDOW_UNITS: Mapping[str, str] = {
    "command_delay": "s",
    "torque_lag": "s",
    "armature": "kg m^2",
    "coulomb": "N m",
    "viscous": "N m s/rad",
    "friction_factor": "1",
    "stribeck": "N m",
    "stribeck_speed": "rad/s",
    "load_friction": "1",
    "dead_band": "rad",
}
STATES_OF_ROWS = ("identified", "absent")
# What has no scale of its own where no torque, gravity or inertia is known.
SCALED = (
    PROPORTIONAL,
    DERIVATIVE,
    INTEGRAL,
    VELOCITY_FEEDFORWARD,
    "armature",
    "coulomb",
    "stribeck",
)
TOO_FEW = "too few samples in which it follows its command: record more motion"
NO_SCALE = (
    "without a torque only its ratio to gravity and inertia shows, and these are the"
    " URDF's or a guess: log a torque, or give an identified model"
)
PRIOR_ALONE = "these logs add little to the guess: record larger and faster motion"
VISCOUS_TOO = (
    "it holds viscous friction as well, which the model lacks: log a torque or a"
    " commanded velocity, or give a model with friction (seqid friction)"
)
# A part that was not found and may be as large as this is not absent, but not shown: of
# the proportional gain [1/s] (slower, it would take 10 s to do as much), of the
# derivative, of gravity.
LEAST_INTEGRAL = 0.1
LEAST_FEEDFORWARD = 0.3
LEAST_GRAVITY = 0.3
# Of the error that the fit by rows leaves in held-out windows.
BETTER = 0.99
# Delays of joints that differ by less than so many standard errors are one.
SAME_DELAY_SIGMA = 3.0
# Of the proportional gain, as its standard error: up to it a joint is good.
MAX_ERROR = 0.1
# Times a standard error, to either side: 95 %.
INTERVAL = 1.96


@dataclass(frozen=True, kw_only=True)
class DrivenArm:
    """The arm whose controllers were fitted, and its logs.

    `nominal`: `stages` are those of the URDF's inertials alone. `remarks`: what is to
    be said of joints and commands in these logs.
    """

    inputs: Inputs
    stages: Stages
    logs: Sequence[DriveSignals]
    log_set: LogSet
    nominal: bool
    remarks: Sequence[str] = ()


def explains(fit: JointFit, limits: DriveVerdictSettings) -> bool:
    """Tell whether a fit by rows is one to begin with."""
    return fit.values[PROPORTIONAL] > 0.0 and fit.left <= limits.max_left


def drive_file(
    by_rows: Mapping[int, JointFit | None],
    by_windows: Mapping[int, WindowFit],
    faults: Mapping[str, str],
    arm: DrivenArm,
    settings: DriveSettings,
) -> DriveFile:
    """Describe fits as the document of a drive.

    Parameters
    ----------
    by_rows : mapping of int to JointFit or None
        By joint; None where too few rows were there.
    by_windows : mapping of int to WindowFit
        By joint.
    faults : mapping of str to str
        Why a joint was not fitted, by joint.
    arm : DrivenArm
    settings : DriveSettings
    """
    joints = {}
    verdicts = [
        Verdict(joint=name, good=False, reason=reason)
        for name, reason in faults.items()
    ]
    for j, rows in by_rows.items():
        name = arm.inputs.robot.joint_names[j]
        windows = by_windows.get(j)
        if rows is not None and windows is not None and not is_better(windows):
            windows = None
        if rows is None and windows is None:
            verdicts.append(Verdict(joint=name, good=False, reason=TOO_FEW))
            continue
        described = _Described(
            rows=rows,
            windows=windows,
            slides=arm.inputs.robot.joints[j].prismatic,
            measured=arm.logs[0].measured,
            nominal=arm.nominal,
            course=courses_of_all(arm.logs)[0],
            has_friction=(
                arm.stages.friction is not None and name in arm.stages.friction.joints
            ),
        )
        joints[name] = described.joint()
        verdicts.append(_verdict(name, described, settings.verdict))
    common = common_delay(joints)
    return DriveFile(
        **head(DRIVE_SCHEMA, arm.log_set.created(arm.inputs.documents)),
        robot=robot_id(arm.inputs.robot),
        inputs=arm.log_set.inputs(),
        models=arm.inputs.ids(),
        method="torque" if arm.logs[0].measured else "motion",
        command_delay=common,
        joints=joints,
        stages=arm.stages,
        cutoff_hz=arm.logs[0].cutoff_hz,
        verdicts=[_verdict_of_all(verdicts), *arm.log_set.verdicts(), *verdicts],
        notes=[
            *arm.log_set.notes(),
            *arm.remarks,
            *_notes(joints, common, arm),
        ],
        effective_settings=used_settings(settings),
    )


def is_better(windows: WindowFit) -> bool:
    """Tell whether windows that were held out gained by the fit by windows."""
    return windows.rms < BETTER * windows.rms_by_rows


@dataclass(frozen=True, kw_only=True)
class _Described:
    """What both fits say of a joint; either may be missing."""

    rows: JointFit | None
    windows: WindowFit | None
    slides: bool
    measured: bool
    nominal: bool
    course: str
    has_friction: bool = True  # whether the model has friction of this joint

    def joint(self) -> JointDrive:
        """Return the joint's part of the document."""
        rows = self.rows
        windows = self.windows
        parameters = self._by_rows()
        if windows is not None:
            parameters = self._with_windows(parameters, windows)
        return JointDrive(
            parameters=parameters,
            command=self.course if rows is None else rows.course,
            command_known=rows is not None and rows.course_is_known,
            left=None if rows is None else rows.left,
            rmse=None if rows is None else rows.rmse,
            samples=0 if rows is None else rows.rows,
            offset=self._offset(),
            windows=0 if windows is None else windows.windows,
            window_rms=None if windows is None else windows.rms,
            window_guess=None if windows is None else windows.rms_of_guess,
        )

    def _offset(self) -> float:
        if self.windows is not None and "offset" in self.windows.values:
            return self.windows.values["offset"]
        return 0.0 if self.rows is None else self.rows.offset

    def _by_rows(self) -> list[DriveParameter]:
        fit = self.rows
        if fit is None:
            return [
                DriveParameter(
                    name=name,
                    value=None,
                    std_error=None,
                    unit=self.unit(name),
                    state="not_shown",
                    reason=TOO_FEW,
                )
                for name in ("command_delay", "torque_lag", *PARTS)
            ]
        return [
            _delay(fit),
            _lag(fit, measured=self.measured),
            *(self._part(fit, name) for name in PARTS),
            _torque_limit(fit, slides=self.slides),
            _velocity_limit(fit, slides=self.slides),
        ]

    def _part(self, fit: JointFit, name: str) -> DriveParameter:
        part = _part(fit, name, slides=self.slides)
        if name == DERIVATIVE and part.state == "identified" and self._holds_viscous:
            part.state = "not_shown"
            part.reason = VISCOUS_TOO
        return part

    @property
    def _holds_viscous(self) -> bool:
        """True where damping of the controller and of friction are one number."""
        return not self.measured and not self.has_friction

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return unit_of(UNITS.get(name) or WINDOW_UNITS[name], self.slides)

    def _with_windows(
        self, parameters: Sequence[DriveParameter], fit: WindowFit
    ) -> list[DriveParameter]:
        """Put what windows tell in the place of what rows tell."""
        by_name = {parameter.name: parameter for parameter in parameters}
        if PROPORTIONAL in fit.values:
            # What rows took for a part belongs to a law of other gains. Without its
            # friction and rotor they cannot say what is absent, either.
            stale = {"identified"} if fit.by_rows is not None else {*STATES_OF_ROWS}
            for name in PARTS:
                if by_name[name].state in stale and name not in fit.values:
                    by_name[name] = DriveParameter(
                        name=name,
                        value=None,
                        std_error=None,
                        unit=self.unit(name),
                        state="not_shown",
                        reason=f"held-out windows gain nothing by it: {RECORD[name]}",
                    )
        for name, value in fit.values.items():
            if name == "offset":
                continue
            reason = ""
            before = by_name.get(name)
            if name == "command_delay" and before is not None:
                reason = before.reason
            parameter = _identified(
                name, value, fit.std_errors[name], self.unit(name), reason
            )
            has_no_scale = self.nominal and not self.measured and name in SCALED
            # What rows have told by a torque is no guess, where windows add little.
            by_torque = self.measured and before is not None
            is_guess = name in fit.open and not by_torque
            if is_guess or has_no_scale:
                parameter.state = "not_shown"
                parameter.reason = NO_SCALE if name in SCALED else PRIOR_ALONE
            elif name == DERIVATIVE and self._holds_viscous:
                parameter.state = "not_shown"
                parameter.reason = VISCOUS_TOO
            by_name[name] = parameter
        return list(by_name.values())


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
    if name in fit.refused and INTERVAL * fit.refused[name] < _least(fit, name):
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


def _least(fit: JointFit, name: str) -> float:
    """Return the size of a part from which on it matters, in its own unit."""
    if name == INTEGRAL:
        return LEAST_INTEGRAL * fit.values[PROPORTIONAL]
    if name == GRAVITY:
        return LEAST_GRAVITY
    if name == VELOCITY_FEEDFORWARD and DERIVATIVE in fit.values:
        return LEAST_FEEDFORWARD * fit.values[DERIVATIVE]
    return np.inf


def _why_not_shown(fit: JointFit, name: str) -> str:
    if name in fit.refused:
        return (
            f"it may be as large as {INTERVAL * fit.refused[name]:.2g}: {RECORD[name]}"
        )
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


def _verdict(name: str, described: _Described, limits: DriveVerdictSettings) -> Verdict:
    """Judge a joint by its rows, or by its windows where these tell the gains."""
    windows = described.windows
    rows = described.rows
    if windows is None or PROPORTIONAL not in windows.values:
        assert rows is not None or windows is not None
        if rows is not None:
            return verdict_of_joint(name, rows, limits)
    assert windows is not None
    share = windows.rms / max(windows.rms_of_guess, 1e-300)
    beside = (
        f"held-out windows are off by {windows.rms:.2g}, start and change of the"
        f" command by {windows.rms_of_guess:.2g}"
    )
    if share >= 1.0:
        return Verdict(joint=name, good=False, reason=beside)
    has_no_scale = described.nominal and not described.measured
    if PROPORTIONAL in windows.open or has_no_scale:
        return Verdict(
            joint=name, good=False, level="usable", reason=f"{PROPORTIONAL}: {NO_SCALE}"
        )
    error = windows.std_errors[PROPORTIONAL] / windows.values[PROPORTIONAL]
    if not are_good(share, error, limits):
        reason = f"{beside}; the proportional gain is known to {percent(error)}"
        return Verdict(joint=name, good=False, level="usable", reason=reason)
    return Verdict(joint=name, good=True)


def are_good(share: float, error: float, limits: DriveVerdictSettings) -> bool:
    """Tell whether windows are followed well by gains that are known.

    Parameters
    ----------
    share : float
        Of the error of a guess without a model.
    error : float
        Of the proportional gain, relative.
    limits : DriveVerdictSettings
    """
    return share <= limits.good_windows and error <= MAX_ERROR


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
    joints: Mapping[str, JointDrive], common: DriveParameter | None, arm: DrivenArm
) -> list[str]:
    notes = []
    if arm.nominal:
        notes.append(
            "the model is that of the URDF's inertials: gains are as right as its"
            " masses"
        )
    if joints and common is None:
        notes.append("the joints' command delays differ by more than their errors")
    return notes
