"""All joints by windows, and what servos of one type tell of each other."""

from collections.abc import Mapping, Sequence

import numpy as np

from seqid_cli.drive.effects import ArmEffects
from seqid_cli.drive.equations import DERIVATIVE, PROPORTIONAL
from seqid_cli.drive.friction_table import FrictionTable
from seqid_cli.drive.rollouts.course import arm_motion, courses_of
from seqid_cli.drive.rollouts.fit import WindowFit, fit_windows, refitted
from seqid_cli.drive.rollouts.loop import JointLoop
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.drive.settings import DriveSettings
from seqid_cli.drive.signals import DriveSignals, courses_of_all, table_for
from seqid_cli.model.torque import TorqueModel

# Of a window: long against a loop, so that errors show.
WINDOW_S = 1.0
# What servos of one type share.
SHARED = (PROPORTIONAL, DERIVATIVE, "coulomb", "armature")
# Servos of one type differ by so much at least: the standard deviation of a logarithm.
LEAST_SPREAD = 0.1
# A joint tells the others what it knows to so much itself.
KNOWN = 0.3


def fit_all_windows(
    logs: Sequence[DriveSignals],
    model: TorqueModel,
    by_rows: Mapping[int, JointFit | None],
    settings: DriveSettings,
    *,
    nominal: bool,
    same_servos: bool,
    effects: ArmEffects | None = None,
) -> dict[int, WindowFit]:
    """Fit joints by windows of their logs.

    Parameters
    ----------
    logs : sequence of DriveSignals
    model : TorqueModel
    by_rows : mapping of int to JointFit or None
        The joints to fit; None for one of which the fit by rows says too little.
    settings : DriveSettings
    nominal : bool
        Whether the model is that of the URDF: without rotors and friction.
    same_servos : bool
        Whether joints have servos of one type.
    effects : ArmEffects, optional
        What the model's file has beside it.
    """
    effects = effects or ArmEffects.none(model)
    motions, smoother = (
        [arm_motion(log, model, share=share) for log in logs] for share in (1.0, 0.5)
    )
    fits: dict[int, WindowFit] = {}
    loops: dict[int, list[JointLoop]] = {}
    smooth: dict[int, list[JointLoop]] = {}
    for joint, fit in by_rows.items():
        if fit is not None:
            course = fit.course
        else:
            course = courses_of_all(logs)[0]
        torque_lag = 0.0 if fit is None else fit.delays.torque
        limits = (None, None) if fit is None else (fit.limit, fit.speed_limit)
        torque_limit, velocity_limit = (
            np.inf if limit is None else limit.value for limit in limits
        )
        friction = _friction(effects, logs, joint)
        loops[joint], smooth[joint] = (
            [
                JointLoop(
                    course=each,
                    friction=friction,
                    torque_limit=torque_limit,
                    torque_lag=torque_lag,
                    velocity_limit=velocity_limit,
                )
                for each in courses_of(
                    of_arm,
                    joint,
                    course,
                    window_s=WINDOW_S,
                    most=int(settings.windows.most),
                )
            ]
            for of_arm in (motions, smoother)
        )
        result = fit_windows(
            loops[joint],
            smooth[joint],
            fit,
            measured=logs[0].measured,
            nominal=nominal,
        )
        if result is not None:
            fits[joint] = result
    if same_servos:
        for joint, own in list(fits.items()):
            others = [each for j, each in fits.items() if j != joint]
            fits[joint] = refitted(own, loops[joint], smooth[joint], shared(others))
    return fits


def _friction(
    effects: ArmEffects, logs: Sequence[DriveSignals], joint: int
) -> FrictionTable | None:
    surface = effects.model.surfaces[joint]
    added = effects.added_to_table(joint)
    if surface is None and added is None:
        return None
    return table_for(surface, logs, joint, added)


def shared(fits: Sequence[WindowFit]) -> dict[str, tuple[float, float]]:
    """Return what servos share: value, and standard deviation of its logarithm."""
    means = {}
    for name in SHARED:
        logarithms = []
        errors = []
        for fit in fits:
            value = fit.values.get(name, 0.0)
            if not value > 0.0 or fit.std_errors[name] > KNOWN * value:
                continue
            logarithms.append(np.log(value))
            errors.append(fit.std_errors[name] / value)
        if len(logarithms) < 2:
            continue
        x = np.array(logarithms)
        weights = 1.0 / (np.array(errors) ** 2 + LEAST_SPREAD**2)
        mean = float(np.average(x, weights=weights))
        spread = float(np.sqrt(np.average((x - mean) ** 2, weights=weights)))
        std = float(np.hypot(max(spread, LEAST_SPREAD), weights.sum() ** -0.5))
        means[name] = (float(np.exp(mean)), std)
    return means
