"""Whether a payload can be relied on, and what a reader of it must know besides."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from seqid_cli.params.results.payload import CarriedBodyEntry
from seqid_cli.params.schema import Verdict
from seqid_cli.payload.fit import PayloadFit
from seqid_cli.payload.settings import PayloadFitSettings
from seqid_cli.robot.base_parameters import STANDARD
from seqid_cli.shares import percent

# Share by which a joint's friction differs from the model's, from which a note says so.
NOTED_FRICTION_CHANGE = 0.05


@dataclass(frozen=True)
class PayloadJudgement:
    """Verdicts on a payload, and what a reader of it must know besides."""

    verdicts: list[Verdict]
    notes: list[str]


def judged(
    fit: PayloadFit,
    body: CarriedBodyEntry,
    names: tuple[str, ...],
    *,
    good_error: float,
    limits: PayloadFitSettings,
) -> PayloadJudgement:
    """Judge a payload.

    Parameters
    ----------
    fit : PayloadFit
    body : CarriedBodyEntry
        The body nearest to the fit.
    names : tuple of str
        Of the joints.
    good_error : float
        Largest standard error of the mass, as a share of it, with which it is good.
    limits : PayloadFitSettings
    """
    shares_left = {names[j]: share for j, share in fit.shares_left.items()}
    return PayloadJudgement(
        verdicts=[
            mass_verdict(body, good_error, limits),
            *joint_verdicts(body, shares_left, limits),
        ],
        notes=list(_notes(fit, body, names)),
    )


def mass_verdict(
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


def joint_verdicts(
    body: CarriedBodyEntry,
    shares_left: Mapping[str, float],
    limits: PayloadFitSettings,
) -> Iterator[Verdict]:
    """Yield a poor verdict for each joint whose torque the body leaves unexplained."""
    if body.mass.value is None:  # its torque is not explained for another reason
        return
    for name, share in shares_left.items():
        if share > limits.max_left:
            left = percent(share)
            reason = f"{left} of the torque is left with the body in the model"
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
