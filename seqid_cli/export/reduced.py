"""The best model that a form can hold, and what it loses of the file's.

URDF, MJCF and parameter files know links, an armature, Coulomb and viscous friction.
The torque tau that they have to meet (`equations` has the letters) is

- on the file's logs the measured one,
- on as much made motion, within the identified positions and speeds, the file's own.

The first is what the arm did. The second makes the numbers right for other motion than
that of the logs: effects that a form lacks are taken over by links and friction, in a
way that fits the logs' motion and no other. With sigma_j the error that the form itself
leaves at joint j,

    min over bodies, c_j, d_j of   sum_j |tau_j - H_j pi - c_j s_j - d_j dq_j - o_j|^2 / sigma_j^2
                                 + w |pi - pi_file|^2_C + w (the surface's own friction),

for bodies that can exist, c_j and d_j not negative, o_j only where the form has a place
for it. Bodies and friction are found together: friction that is fitted after the bodies
cannot make up for what these had to give way. sigma_j does not depend on how well the
file does, so that a refined file and the one before it come out alike where a form has
no place for what was refined. The prior's small weight w decides only where the motion
does not tell.

What is lost by that, `loss` says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from seqid_cli.export.equations import CoulombViscous, JointSums
from seqid_cli.export.fitting import fitted_bodies, surface_grid
from seqid_cli.export.loss import lost_torque, stated_loss
from seqid_cli.export.model import LEFT_OUT, ExportModel, Loss
from seqid_cli.export.motions import (
    FullModel,
    Motions,
    TorqueSamples,
    made_motions,
)
from seqid_cli.model.bodies.nearest import Identified, identified
from seqid_cli.model.effects.fitted import Fitted, FittedEffect
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.results.export import ExportedFriction, ExportedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.typing import Array

# Coulomb and viscous friction hold a surface well up to this share of it.
WELL_HELD = 0.2
# Standard errors by which bodies that can exist may miss a base parameter before their
# numbers are fitted to the torque instead: as many as --strict allows.
MOST_DEVIATION = 4.0
_FITTED = (
    "has no place in this form, whose links and friction are fitted to the torque"
    " with it"
)


@dataclass(frozen=True, kw_only=True)
class Form:
    """What a form has a place for, beside links, armature, Coulomb and viscous friction."""

    offset: bool = False
    effects: tuple[str, ...] = ()


def needs_refit(model: ExportModel, left_over: Sequence[Fitted]) -> bool:
    """Return whether the file holds torque that the form's usual numbers leave out.

    `left_over` are effects that the form has no place for. Without any, the file's own
    parameters are the best, where Coulomb and viscous friction hold the surfaces well
    and bodies that can exist have the parameters.
    """
    fits = [fit for fit in model.friction if fit is not None]
    poor = any(fit.rms_misfit > WELL_HELD * fit.rms for fit in fits)
    missed = not model.nearest.exact and model.largest_deviation > MOST_DEVIATION
    return bool(left_over) or poor or missed


def reduced(
    model: ExportModel, stages: Stages, motions: Motions, form: Form
) -> ExportModel:
    """Return the model with the numbers that lose least of the file's torque.

    Parameters
    ----------
    model : ExportModel
        With the file's own parameters, and friction fitted to its surfaces.
    stages : Stages
        Those of the file.
    motions : Motions
        On which torque counts.
    form : Form
        What the form has a place for.
    """
    model = replace(model, writes_offset=form.offset)
    full = FullModel.of(model.robot, stages)
    in_bodies = [item for item in full.effects if _is_of_bodies(item, model)]
    held = [item for item in full.effects if _name(item) in form.effects]
    unseen = [item for item in held if _name(item) == "backlash"]
    exact = [item for item in [*in_bodies, *held] if not _is_among(item, unseen)]
    taken = [*exact, *unseen]
    left_over = [item for item in full.effects if not _is_among(item, taken)]
    samples = list(motions.samples(full, held=exact, unseen=unseen))

    made: list[TorqueSamples] = []
    if not motions.made:
        more = Motions(recordings=tuple(made_motions(full)), made=True)
        made = list(more.samples(full, held=exact, unseen=unseen))

    added = _added_parameters(in_bodies, model)
    if needs_refit(model, left_over):
        model = _refitted(model, stages, samples, made, added)
    others = list(motions.samples(full, held=exact, unseen=unseen, held_out=True))
    loss = Loss(
        rms=stated_loss(model, [*samples, *others], made, added),
        replayed_rms=lost_torque(model, others, added),
        logs=len(samples),
        made=motions.made,
    )
    notes = [text.replace(LEFT_OUT, _FITTED) for text in model.notes]
    return replace(model, loss=loss, notes=(*notes, *motions.notes))


def _is_among(item: Fitted, others: Sequence[Fitted]) -> bool:
    # By identity: effects hold arrays, which have no truth value when they are
    # compared.
    return any(item is other for other in others)


def _name(item: Fitted) -> str:
    return item.effect.name if isinstance(item, FittedEffect) else ""


def _is_of_bodies(item: Fitted, model: ExportModel) -> bool:
    """Return whether an effect is part of the links' and rotors' own parameters."""
    if _name(item) == "payload":
        return True
    alone = isinstance(item, FittedEffect) and not item.settings.get("coupling")
    return _name(item) == "rotor_inertia" and model.coupling == "diagonal" and alone


def _added_parameters(effects: Sequence[Fitted], model: ExportModel) -> Array:
    """Return what effects add to the standard parameters (11 n,), rotors last."""
    n = model.robot.n
    added = np.zeros((PER_LINK + 1) * n)
    for item in effects:
        assert isinstance(item, FittedEffect)
        if _name(item) == "payload":
            added[PER_LINK * (n - 1) : PER_LINK * n] += item.coefficients
        else:
            added[PER_LINK * n + (item.joint or 0)] += float(item.coefficients[0])
    return added


def _refitted(
    model: ExportModel,
    stages: Stages,
    samples: Sequence[TorqueSamples],
    made: Sequence[TorqueSamples],
    added: Array,
) -> ExportModel:
    """Return the model with bodies and friction fitted to both sets of motions alike."""
    robot = model.robot
    of_file = identified(stages, robot)
    sums = JointSums.of(model, of_file, samples, added)
    if made:
        of_made = JointSums.of(model, of_file, made, added)
        # Made motion has no end: as a whole it counts as much as the logs do.
        share = sums.counts.sum() / max(of_made.counts.sum(), 1.0)
        sums = sums.plus(of_made.scaled(share))
    fit = fitted_bodies(sums, model, of_file, added, writes_offset=model.writes_offset)

    with_added = identified(stages, robot, more=added)
    rows = of_file.basis.expression[list(of_file.rows)]
    asked = replace(with_added, values=fit.values + rows @ added)
    bodies = (fit.nearest.links + model.kept).ravel()
    friction = tuple(
        _described(law, before, surface, slides=bool(count))
        for law, before, surface, count in zip(
            fit.friction, model.friction, model.surfaces, sums.counts, strict=True
        )
    )
    return replace(
        model,
        nearest=fit.nearest,
        friction=friction,
        deviations=_deviations(
            with_added, asked, np.concatenate([bodies, fit.nearest.rotor])
        ),
        refitted=True,
    )


def _described(
    law: CoulombViscous,
    before: ExportedFriction | None,
    surface: FrictionSurface | None,
    *,
    slides: bool,
) -> ExportedFriction | None:
    """Return friction as a result, with its misfit to the file's surface.

    None where neither the file nor the motion knows it.
    """
    if before is None and not slides:
        return None
    if before is None or surface is None:
        return ExportedFriction(
            coulomb=law.coulomb,
            viscous=law.viscous,
            offset=law.offset,
            rms_misfit=0.0,
            rms=0.0,
            speed_range=[0.0, 0.0],
        )
    q, v = surface_grid(surface)
    misfit = surface.torque(q, v) - law.torque(q, v)
    return msgspec.structs.replace(
        before,
        coulomb=law.coulomb,
        viscous=law.viscous,
        offset=law.offset,
        rms_misfit=float(np.sqrt(np.mean(misfit**2))),
    )


def _deviations(
    of_file: Identified, demand: Identified, standard: Array
) -> tuple[ExportedParameter, ...]:
    """Compare the bodies (11 n,) with what they were to meet, in the file's standard errors."""
    split = PER_LINK * (len(standard) // (PER_LINK + 1))
    bodies, rotor = standard[:split], standard[split:]
    against_fit = replace(of_file, values=demand.values).deviations(bodies, rotor)
    return tuple(
        msgspec.structs.replace(
            entry, identified=float(value), refitted=entry.identified
        )
        for entry, value in zip(against_fit, of_file.values, strict=True)
    )
