"""From the fit of a payload to the document: numbers where the logs give them, and a verdict.

The body also stands there in the words of robot controllers. Universal Robots:
`set_target_payload(m, cog, inertia)` of URScript, inertia about the centre of mass as [Ixx, Iyy,
Izz, Ixy, Ixz, Iyz]; `set_payload(m, cog)` before software 5.10. Franka Robotics:
`Robot::setLoad(load_mass, F_x_Cload, load_inertia)` of libfranka, the inertia column by column. ROS
2: `geometry_msgs/msg/Inertia`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from seqid_cli.identify.common_cutoff import inherited
from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.params.document import now, robot_id, tool
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    Measured,
    PayloadFile,
)
from seqid_cli.params.schema import Parameter, Verdict
from seqid_cli.payload.body import body_of
from seqid_cli.payload.fit import PayloadFit, fit_payload
from seqid_cli.payload.options import PayloadOptions
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.shares import percent

MASS, FIRST_MOMENT = 0, slice(1, 4)
Inertia = Sequence[Sequence[float]] | None


def payload_file(inputs: Inputs, options: PayloadOptions) -> PayloadFile:
    """Read the logs, fit, and describe the result."""
    rigid = InertiaOptions(inherited(inputs.stages, options.cutoff_hz), options.source)
    given = LogSet.of(inputs)
    fit = fit_payload(
        given,
        inputs.robot,
        inputs.stages,
        options=rigid,
        friction_change=options.friction_change,
    )
    names = inputs.robot.joint_names
    entry, settings = _entry(fit, names[-1])
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return PayloadFile(
        schema=PAYLOAD_SCHEMA,
        created=now(),
        tool=tool(),
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
        verdicts=[*given.verdicts(), *_verdicts(fit, entry, names, options.good_error)],
        notes=[*given.notes(), *_notes(fit, entry, names)],
    )


def _entry(fit: PayloadFit, joint: str) -> tuple[CarriedBodyEntry, dict[str, str]]:
    """The body, and how controllers take it where it has a mass and a centre."""
    frame = f"of joint {joint}"
    error = float(np.sqrt(max(fit.covariance[MASS, MASS], 0.0)))
    known = bool(fit.determined[MASS])
    nothing = Measured(value=None, std_error=None, unit="m")
    mass = Measured(
        value=float(fit.phi[MASS]) if known else None,
        std_error=error if known else None,
        unit="kg",
    )
    if not known or fit.phi[MASS] <= 0.0:
        return CarriedBodyEntry(frame=frame, mass=mass, center_of_mass=[nothing] * 3), {}
    whole = bool(fit.determined.all())
    body = body_of(fit.phi, fit.covariance, whole=whole)
    there = fit.determined[FIRST_MOMENT]
    center = [
        Measured(value=float(x), std_error=float(e), unit="m") if t else nothing
        for x, e, t in zip(body.center, body.center_error, there, strict=True)
    ]
    inertia = body.inertia.tolist() if body.inertia is not None else []
    entry = CarriedBodyEntry(
        frame=frame,
        mass=Measured(value=body.mass, std_error=body.mass_error, unit="kg"),
        center_of_mass=center,
        inertia=inertia,
        inertia_std_errors=body.inertia_error.tolist() if inertia else [],
        distance=body.distance,
    )
    if not there.all():
        return entry, {}
    return entry, settings_of(body.mass, body.center.tolist(), inertia or None)


def _joint(fit: PayloadFit, j: int) -> JointWithPayload:
    seen = bool(fit.samples[j])
    torque = max(float(fit.measured[j]), 1e-300)
    return JointWithPayload(
        before=float(fit.before[j]) if seen else None,
        after=float(fit.after[j]) if seen else None,
        relative=float(fit.after[j]) / torque if seen else None,
        samples=int(fit.samples[j]),
        friction_change=float(fit.friction_change[j]),
    )


def _verdicts(
    fit: PayloadFit,
    entry: CarriedBodyEntry,
    names: tuple[str, ...],
    good_error: float,
    *,
    poor_left: float = 0.3,
    negative: float = 3.0,
    far: float = 3.0,
) -> Iterator[Verdict]:
    mass, error = entry.mass.value, entry.mass.std_error
    if mass is None or error is None:
        reason = (
            "the mass is not determined: move a joint whose torque gravity changes, in more poses"
        )
        yield Verdict(good=False, reason=reason)
        return
    reason = f"mass {mass:.4g} kg, standard error {error:.2g} kg"
    good = error < good_error * abs(mass)
    if not good:
        reason += f", above {percent(good_error)} of it: record more moves with more of the arm"
    if mass < -negative * error:
        good = False
        reason += "; the model holds a body that these logs do not carry: swap the two"
    if entry.distance > far:
        good = False
        reason += (
            f"; the estimate is {entry.distance:.2g} standard errors from any body that can exist: "
            "what is left is not of the payload alone"
        )
    yield Verdict(good=good, reason=reason)
    for j, name in enumerate(names):
        left = float(fit.after[j]) / max(float(fit.measured[j]), 1e-300)
        if fit.samples[j] and left > poor_left:
            yield Verdict(
                joint=name,
                good=False,
                reason=f"{percent(left)} of the torque is left with the body in the model",
            )


def _notes(fit: PayloadFit, entry: CarriedBodyEntry, names: tuple[str, ...]) -> Iterator[str]:
    missing = [kind for k, kind in enumerate(STANDARD) if not fit.determined[k]]
    if missing:
        yield f"not determined by these logs: {', '.join(missing)} of the payload"
    if entry.distance > 0.0:
        yield (
            "the least-squares estimate is no body; the nearest one is given, "
            f"{entry.distance:.2g} standard errors away"
        )
    changed = [
        f"{name} {percent(float(change))}"
        for name, change in zip(names, fit.friction_change, strict=True)
        if abs(change) > 0.05
    ]
    if changed:
        yield f"friction differs from the model's: {', '.join(changed)}"


def settings_of(mass: float, center: Sequence[float], inertia: Inertia) -> dict[str, str]:
    """Write a payload as controllers take it.

    `mass`: kg. `center` (3,): centre of mass in the flange's frame, m. `inertia` (3, 3): about the
    centre of mass, in the axes of the flange's frame, kg m^2; zeros if not known.
    """
    m, c = _number(mass), [_number(x) for x in center]
    rows = inertia or [[0.0] * 3] * 3
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    six = {name: _number(rows["xyz".index(name[1])]["xyz".index(name[2])]) for name in names}
    column = [_number(rows[i][k]) for k in range(3) for i in range(3)]
    at, numbers = ", ".join(c), ", ".join(six.values())
    script = f"set_target_payload({m}, [{at}], [{numbers}])"
    found = {
        "urscript": script if inertia else f"set_payload({m}, [{at}])",
        "libfranka": f"robot.setLoad({m}, {{{at}}}, {{{', '.join(column)}}});",
    }
    parts = "".join(f", {name}: {six[name]}" for name in sorted(names))
    found["ros2"] = f"{{m: {m}, com: {{x: {c[0]}, y: {c[1]}, z: {c[2]}}}{parts}}}"
    return found


def _number(value: float) -> str:
    return f"{value:.5g}" if value else "0.0"
