"""From the fit of a payload to the document: numbers where the logs give them, and a verdict.

The estimate need not belong to a body: noise makes an inertia negative, and what the
logs do not excite is whatever the least squares left. The body that is given is the one
with a positive semidefinite pseudo-inertia J nearest to the estimate in its own errors,

    min over J >= 0 of  (phi(J) - phi)' C^-1 (phi(J) - phi),

a conic problem (Wensing, Kim, Slotine, "Linear matrix inequalities for physically
consistent inertial parameter identification", RA-L 2018). Where the estimate is a body,
the two are the same.

The body also stands there in the words of robot controllers. Universal Robots:
`set_target_payload(m, cog, inertia)` of URScript, inertia about the centre of mass as
[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]; `set_payload(m, cog)` before software 5.10. Franka
Robotics: `Robot::setLoad(load_mass, F_x_Cload, load_inertia)` of libfranka, the inertia
column by column. ROS 2: `geometry_msgs/msg/Inertia`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from seqid_cli.identify.common_cutoff import inherited
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.model.bodies.consistent import nearest_body
from seqid_cli.model.bodies.nearest import whitening
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia
from seqid_cli.params.document import head, robot_id, used_settings
from seqid_cli.params.results import payload
from seqid_cli.params.schema import Matrix, Parameter, Verdict
from seqid_cli.payload.fit import PayloadFit, fit_payload
from seqid_cli.payload.options import PayloadOptions
from seqid_cli.payload.settings import PayloadFitSettings, PayloadSettings
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.shares import percent
from seqid_cli.typing import Array


def payload_file(
    inputs: Inputs, options: PayloadOptions, numbers: PayloadSettings
) -> payload.PayloadFile:
    """Read the logs, fit, and describe the result; `numbers` are the settings."""
    rigid = InertiaOptions(inherited(inputs.stages, options.cutoff_hz), options.source)
    given, names = LogSet.of(inputs), inputs.robot.joint_names
    logs = given, inputs.robot, inputs.stages
    fit = fit_payload(*logs, options=rigid, friction_change=options.friction_change)
    entry, settings = _entry(fit, names[-1])
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return payload.PayloadFile(
        **head(payload.PAYLOAD_SCHEMA, given.created(inputs.documents)),
        robot=robot_id(inputs.robot),
        inputs=given.inputs(),
        models=inputs.ids(),
        payload=entry,
        parameters=[
            Parameter(
                name=f"payload_{kind}",
                value=float(fit.phi[k]),
                std_error=float(errors[k]),
                unit=parameter_unit(f"{kind}_1"),
                joint=names[-1],
            )
            for k, kind in enumerate(STANDARD)
            if fit.determined[k]
        ],
        covariance=fit.covariance[np.ix_(fit.determined, fit.determined)].tolist(),
        settings=settings,
        joints={name: _joint(fit, j) for j, name in enumerate(names)},
        cutoff_origin=rigid.motion.origin,
        verdicts=[
            *given.verdicts(),
            *_verdicts(fit, entry, names, options.good_error, numbers.fit),
        ],
        effective_settings=used_settings(numbers),
        notes=[*given.notes(), *_notes(fit, entry, names)],
    )


def _entry(
    fit: PayloadFit, joint: str
) -> tuple[payload.CarriedBodyEntry, dict[str, str]]:
    """The body, and how controllers take it where it has a mass and a centre."""
    known, whole = fit.determined[:4].copy(), bool(fit.determined.all())
    values, errors, distance = (
        fit.phi,
        np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)),
        0.0,
    )
    if known[0] and fit.phi[0] > 0.0:
        values, errors, distance = carried(fit.phi, fit.covariance, whole=whole)
    else:
        known[1:] = whole = False
    mass, *center = (
        payload.Measured(
            value=float(values[k]) if there else None,
            std_error=float(errors[k]) if there else None,
            unit="m" if k else "kg",
        )
        for k, there in enumerate(known)
    )
    entry = payload.CarriedBodyEntry(
        frame=f"of joint {joint}",
        mass=mass,
        center_of_mass=center,
        inertia=values[4:].reshape(3, 3).tolist() if whole else [],
        inertia_std_errors=errors[4:].reshape(3, 3).tolist() if whole else [],
        distance=distance,
    )
    return entry, (
        settings_of(values[0], values[1:4], entry.inertia) if known.all() else {}
    )


def carried(
    phi: Array, covariance: Array, *, whole: bool = True
) -> tuple[Array, Array, float]:
    """Mass, centre, inertia about it (13,) of the body nearest to an estimate; their errors.

    `phi` (10,): standard parameters of positive mass, inertia about the frame's origin.
    `covariance` (10, 10). `whole`: whether the inertia is known as well. The distance
    between the estimate and the body comes last, in standard errors (chi); zero where
    it is one.
    """
    distance = 0.0
    if whole and np.linalg.eigvalsh(pseudo_inertia(phi))[0] < 0.0:
        phi, distance = nearest_body(
            phi, whitening(covariance, 1e-9 * float(np.abs(phi).max()))
        )
    step = 1e-6 * np.maximum(np.abs(phi), 1e-3 * np.abs(phi).max())
    moved = _moments(phi + np.diag(step)) - _moments(phi - np.diag(step))
    slopes = moved.T / (2.0 * step)
    variances = np.einsum("ik,kl,il->i", slopes, covariance, slopes)
    return _moments(phi), np.sqrt(np.maximum(variances, 0.0)), distance


def _moments(phi: Array) -> Array:
    """Mass, centre of mass and inertia about it (..., 13) of standard parameters (..., 10)."""
    J = pseudo_inertia(phi)
    mass, h = J[..., 3:, 3], J[..., :3, 3]
    S = J[..., :3, :3] - h[..., :, None] * h[..., None, :] / mass[..., None]
    inertia = np.trace(S, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - S
    return np.concatenate(
        [mass, h / mass, inertia.reshape(*mass.shape[:-1], 9)], axis=-1
    )


def _joint(fit: PayloadFit, j: int) -> payload.JointWithPayload:
    seen, after = bool(fit.samples[j]), float(fit.after[j])
    return payload.JointWithPayload(
        before=float(fit.before[j]) if seen else None,
        after=after if seen else None,
        relative=after / max(float(fit.measured[j]), 1e-300) if seen else None,
        samples=int(fit.samples[j]),
        friction_change=float(fit.friction_change[j]),
    )


def _verdicts(
    fit: PayloadFit,
    entry: payload.CarriedBodyEntry,
    names: tuple[str, ...],
    good_error: float,
    numbers: PayloadFitSettings,
) -> Iterator[Verdict]:
    mass, error = entry.mass.value, entry.mass.std_error
    if mass is None or error is None:
        poses = "move a joint whose torque gravity changes, in more poses"
        yield Verdict(good=False, reason=f"the mass is not determined: {poses}")
        return
    faults = ""
    if not error < good_error * abs(mass):
        faults += (
            f", above {percent(good_error)} of it: record more moves with more of"
            " the arm"
        )
    if mass < -numbers.negative_sigma * error:
        faults += "; the model holds a body that these logs do not carry: swap the two"
    if entry.distance > numbers.max_distance:
        away = f"{entry.distance:.2g} standard errors from any body that can exist"
        faults += f"; the estimate is {away}: what is left is not of the payload alone"
    reason = f"mass {mass:.4g} kg, standard error {error:.2g} kg{faults}"
    yield Verdict(good=not faults, reason=reason)
    for j, name in enumerate(names):
        left = _joint(fit, j).relative
        if left is not None and left > numbers.max_left:
            reason = f"{percent(left)} of the torque is left with the body in the model"
            yield Verdict(joint=name, good=False, reason=reason)


def _notes(
    fit: PayloadFit, entry: payload.CarriedBodyEntry, names: tuple[str, ...]
) -> Iterator[str]:
    if missing := [kind for k, kind in enumerate(STANDARD) if not fit.determined[k]]:
        yield f"not determined by these logs: {', '.join(missing)} of the payload"
    if entry.distance > 0.0:
        away = f"{entry.distance:.2g} standard errors away"
        yield f"the least-squares estimate is no body; the nearest one is given, {away}"
    changes = zip(names, fit.friction_change.tolist(), strict=True)
    if changed := [
        f"{name} {percent(change)}" for name, change in changes if abs(change) > 0.05
    ]:
        yield f"friction differs from the model's: {', '.join(changed)}"


def settings_of(
    mass: float, center: Sequence[float] | Array, inertia: Matrix
) -> dict[str, str]:
    """Write a payload as controllers take it.

    `mass`: kg. `center` (3,): centre of mass in the flange's frame, m. `inertia` (3,
    3): about the centre of mass, in the axes of the flange's frame, kg m^2; empty if
    not known.
    """
    m, (x, y, z) = _number(mass), map(_number, center)
    I = [[_number(value) for value in row] for row in inertia or [[0.0] * 3] * 3]
    six = ", ".join([*(I[k][k] for k in range(3)), I[0][1], I[0][2], I[1][2]])
    by_column = ", ".join(I[i][k] for k in range(3) for i in range(3))
    upper = [(i, k) for i in range(3) for k in range(i, 3)]
    named = ", ".join(f"i{'xyz'[i]}{'xyz'[k]}: {I[i][k]}" for i, k in upper)
    at = f"{x}, {y}, {z}"
    script = (
        f"set_target_payload({m}, [{at}], [{six}])"
        if inertia
        else f"set_payload({m}, [{at}])"
    )
    return {
        "urscript": script,
        "libfranka": f"robot.setLoad({m}, {{{at}}}, {{{by_column}}});",
        "ros2": f"{{m: {m}, com: {{x: {x}, y: {y}, z: {z}}}, {named}}}",
    }


def _number(value: float) -> str:
    return f"{value:.5g}" if value else "0.0"
