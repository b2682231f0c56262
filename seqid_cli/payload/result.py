"""The document of a payload: numbers where the logs give them, a verdict, and notes."""

from collections.abc import Iterator

import numpy as np

from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.params.document import head, robot_id, used_settings
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    Measured,
    PayloadFile,
)
from seqid_cli.params.schema import Parameter, Verdict
from seqid_cli.payload.body import carried
from seqid_cli.payload.controllers import settings_of
from seqid_cli.payload.fit import PayloadFit
from seqid_cli.payload.settings import PayloadFitSettings, PayloadSettings
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.shares import percent
from seqid_cli.typing import Array

__all__ = ["carried", "payload_file", "settings_of"]

# Share by which a joint's friction differs from the model's, from which a note says so.
NOTED_FRICTION_CHANGE = 0.05


def payload_file(
    fit: PayloadFit,
    inputs: Inputs,
    log_set: LogSet,
    *,
    good_error: float,
    cutoff_origin: str,
    settings: PayloadSettings,
) -> PayloadFile:
    """Describe a fit as the document of a payload.

    Parameters
    ----------
    fit : PayloadFit
        The body that the logs carry.
    inputs : Inputs
        Robot and model that it was identified with.
    log_set : LogSet
        The logs, read by the fit.
    good_error : float
        Largest standard error of the mass, as a share of it, with which it is good.
    cutoff_origin : str
        Where the low-pass cut-off of the logs came from, in words.
    settings : PayloadSettings
        Numbers that the verdicts depend on.
    """
    names = inputs.robot.joint_names
    body = _body(fit, names[-1])
    joints = {name: _joint(fit, j) for j, name in enumerate(names)}
    verdicts = [
        *log_set.verdicts(),
        _mass_verdict(body, good_error, settings.fit),
        *_joint_verdicts(body, joints, settings.fit),
    ]
    covariance = fit.covariance[np.ix_(fit.determined, fit.determined)]

    return PayloadFile(
        **head(PAYLOAD_SCHEMA, log_set.created(inputs.documents)),
        robot=robot_id(inputs.robot),
        inputs=log_set.inputs(),
        models=inputs.ids(),
        payload=body,
        parameters=_parameters(fit, names[-1]),
        covariance=covariance.tolist(),
        settings=_controller_settings(body),
        joints=joints,
        cutoff_origin=cutoff_origin,
        verdicts=verdicts,
        effective_settings=used_settings(settings),
        notes=[*log_set.notes(), *_notes(fit, body, names)],
    )


def _body(fit: PayloadFit, joint: str) -> CarriedBodyEntry:
    """Describe the body; numbers that the logs do not determine are null."""
    mass_determined = bool(fit.determined[0] and fit.phi[0] > 0.0)
    if mass_determined:
        inertia_determined = bool(fit.determined.all())
        values, std_errors, distance = carried(
            fit.phi, fit.covariance, whole=inertia_determined
        )
        center_determined = fit.determined[1:4].tolist()
    else:
        # Without a positive mass the first moments are those of no centre.
        inertia_determined = False
        values = fit.phi
        std_errors = _std_errors(fit)
        distance = 0.0
        center_determined = [False, False, False]

    mass = _measured(values[0], std_errors[0], "kg", bool(fit.determined[0]))
    center = [
        _measured(values[k + 1], std_errors[k + 1], "m", center_determined[k])
        for k in range(3)
    ]
    inertia = []
    inertia_std_errors = []
    if inertia_determined:
        inertia = values[4:].reshape(3, 3).tolist()
        inertia_std_errors = std_errors[4:].reshape(3, 3).tolist()
    return CarriedBodyEntry(
        frame=f"of joint {joint}",
        mass=mass,
        center_of_mass=center,
        inertia=inertia,
        inertia_std_errors=inertia_std_errors,
        distance=distance,
    )


def _measured(value: float, std_error: float, unit: str, determined: bool) -> Measured:
    """Return a number with its error, both null where it is not determined."""
    if not determined:
        return Measured(value=None, std_error=None, unit=unit)
    return Measured(value=float(value), std_error=float(std_error), unit=unit)


def _std_errors(fit: PayloadFit) -> Array:
    """Return the standard errors (10,) of the standard parameters."""
    return np.asarray(np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)))


def _controller_settings(body: CarriedBodyEntry) -> dict[str, str]:
    """Write the body as controllers take it; none without a mass and a centre."""
    center = [
        number.value for number in body.center_of_mass if number.value is not None
    ]
    if body.mass.value is None or len(center) < 3:
        return {}
    return settings_of(body.mass.value, center, body.inertia)


def _parameters(fit: PayloadFit, joint: str) -> list[Parameter]:
    """Return the standard parameters by least squares that the logs determine."""
    std_errors = _std_errors(fit)
    return [
        Parameter(
            name=f"payload_{kind}",
            value=float(fit.phi[k]),
            std_error=float(std_errors[k]),
            unit=parameter_unit(f"{kind}_1"),
            joint=joint,
        )
        for k, kind in enumerate(STANDARD)
        if fit.determined[k]
    ]


def _joint(fit: PayloadFit, j: int) -> JointWithPayload:
    """Describe the torque error of a joint; null where it never slides."""
    n_samples = int(fit.n_samples[j])
    friction_change = float(fit.friction_change[j])
    if not n_samples:
        return JointWithPayload(
            before=None,
            after=None,
            relative=None,
            samples=0,
            friction_change=friction_change,
        )
    rmse_with = float(fit.rmse_with[j])
    return JointWithPayload(
        before=float(fit.rmse_without[j]),
        after=rmse_with,
        relative=rmse_with / max(float(fit.torque_rms[j]), 1e-300),
        samples=n_samples,
        friction_change=friction_change,
    )


def _mass_verdict(
    body: CarriedBodyEntry, good_error: float, limits: PayloadFitSettings
) -> Verdict:
    """Judge the body by its mass, which every use of it needs."""
    mass = body.mass.value
    std_error = body.mass.std_error
    if mass is None or std_error is None:
        remedy = "move a joint whose torque gravity changes, in more poses"
        return Verdict(good=False, reason=f"the mass is not determined: {remedy}")

    faults = ""
    if not std_error < good_error * abs(mass):
        faults += (
            f", above {percent(good_error)} of it: record more moves with more of"
            " the arm"
        )
    if mass < -limits.negative_sigma * std_error:
        faults += "; the model holds a body that these logs do not carry: swap the two"
    if body.distance > limits.max_distance:
        distance = f"{body.distance:.2g} standard errors from any body that can exist"
        faults += (
            f"; the estimate is {distance}: what is left is not of the payload alone"
        )
    reason = f"mass {mass:.4g} kg, standard error {std_error:.2g} kg{faults}"
    return Verdict(good=not faults, reason=reason)


def _joint_verdicts(
    body: CarriedBodyEntry,
    joints: dict[str, JointWithPayload],
    limits: PayloadFitSettings,
) -> Iterator[Verdict]:
    """Yield a poor verdict for each joint whose torque the body leaves unexplained."""
    if body.mass.value is None:  # its torque is not explained for another reason
        return
    for name, joint in joints.items():
        if joint.relative is not None and joint.relative > limits.max_left:
            share = percent(joint.relative)
            reason = f"{share} of the torque is left with the body in the model"
            yield Verdict(joint=name, good=False, reason=reason)


def _notes(
    fit: PayloadFit, body: CarriedBodyEntry, names: tuple[str, ...]
) -> Iterator[str]:
    """Yield what a reader of the result must know besides."""
    undetermined = [kind for k, kind in enumerate(STANDARD) if not fit.determined[k]]
    if undetermined:
        listed = ", ".join(undetermined)
        yield f"not determined by these logs: {listed} of the payload"

    if body.distance > 0.0:
        yield (
            "the least-squares estimate is no body; the nearest one is given,"
            f" {body.distance:.2g} standard errors away"
        )

    changes = zip(names, fit.friction_change.tolist(), strict=True)
    changed = [
        f"{name} {percent(change)}"
        for name, change in changes
        if abs(change) > NOTED_FRICTION_CHANGE
    ]
    if changed:
        yield f"friction differs from the model's: {', '.join(changed)}"
