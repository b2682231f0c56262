"""The best model that a form can hold, and what it loses of the file's.

URDF, MJCF and parameter files know links, an armature, Coulomb and viscous friction.
For a file with more than that there are two answers:

- the numbers that come nearest to the torque that the file's logs have measured (that
  of the whole file on motions without logs), which `fitting` finds;
- the numbers that the form had before the refinement that found the effects.

The second came from a fit of the same form, often to more logs, with more care for what
torque does not show. The first are better where the file has learnt what the form can
hold. `kept` decides joint by joint, on pieces of the logs that a fit has not seen. So
no joint gets worse by a refinement.

What is lost is the RMS of the difference to the file's torque, while a joint slides. It
is stated for motion that no number was fitted to: that of the held-out logs, else that
of the left-out pieces.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.effects.fitted import Fitted
from seqid_cli.export.equations import Numbers, joint_sums, sum_of
from seqid_cli.export.fitting import Fitting, deviations
from seqid_cli.export.kept import decided
from seqid_cli.export.loss import LostTorque
from seqid_cli.export.model import (
    ADDED,
    LEFT_OUT,
    WRITTEN,
    ExportModel,
    Loss,
    added_parameters,
    effect_name,
    export_model,
    is_of_bodies,
)
from seqid_cli.export.motions import (
    FullModel,
    Motions,
    TorqueSamples,
    Unrefined,
    is_among,
)
from seqid_cli.model.bodies.nearest import identified
from seqid_cli.params.schema import Stages
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.typing import Array

# Coulomb and viscous friction hold a surface well up to this share of it.
WELL_HELD = 0.2
# Pieces of the logs, each left out once: a fit to three quarters is much like one to
# all, and every piece has a part of every log.
_PIECES = 4
_FITTED = (
    "has no place in this form, whose links and friction are fitted to the torque"
    " with it"
)
_AS_BEFORE = (
    "is left out of this form, whose numbers are those from before the refinement"
)
_KEPT = "the torque of links and friction is that from before the refinement"


@dataclass(frozen=True, kw_only=True)
class Form:
    """What a form has a place for besides links, armature and simple friction.

    `offset`: whether for a constant torque; `effects`: names of those that it holds as
    they are.
    """

    offset: bool = False
    effects: tuple[str, ...] = ()


def needs_refit(model: ExportModel, left_over: Sequence[Fitted]) -> bool:
    """Return whether the file holds torque that the form's usual numbers leave out.

    `left_over` are effects that the form has no place for. Without any, and where
    Coulomb and viscous friction hold the surfaces well, the file's own parameters are
    the best.
    """
    fits = [fit for fit in model.friction if fit is not None]
    poor = any(fit.rms_misfit > WELL_HELD * fit.rms for fit in fits)
    return bool(left_over) or poor


def reduced(
    model: ExportModel,
    stages: Stages,
    unrefined: Unrefined,
    motions: Motions,
    form: Form,
) -> ExportModel:
    """Return the model with the numbers that lose least of the file's torque.

    Parameters
    ----------
    model : ExportModel
        With the file's own parameters, and friction fitted to its surfaces.
    stages : Stages
        Those of the file.
    unrefined : Unrefined
        The file as it came into its refinement.
    motions : Motions
        On which torque counts.
    form : Form
        What the form has a place for.
    """
    model = replace(model, writes_offset=form.offset)
    full = FullModel.of(model.robot, stages)
    in_bodies = [item for item in full.effects if is_of_bodies(item, model.coupling)]
    held = [item for item in full.effects if effect_name(item) in form.effects]
    unseen = [item for item in held if effect_name(item) == "backlash"]
    exact = [item for item in [*in_bodies, *held] if not is_among(item, unseen)]
    placed = [*exact, *unseen]
    left_over = [item for item in full.effects if not is_among(item, placed)]
    samples = list(motions.samples(full, held=exact, unseen=unseen))
    held_out = list(motions.samples(full, held=exact, unseen=unseen, held_out=True))

    added = added_parameters(in_bodies, model.robot.n)
    best = _Reduced(model=model, added=added)
    if needs_refit(model, left_over):
        best = _reduced(
            Fitting(model=model, stages=stages, added=added),
            unrefined,
            samples,
            is_refined=bool(full.effects),
            is_measured=not motions.are_made,
        )

    # A joint that slides in no held-out log has only the pieces that were left out.
    on_fitted = best.lost(samples)
    on_replayed = best.lost(held_out)
    left_out_rms = np.sqrt(on_fitted.rms**2 + best.excess)
    loss = Loss(
        rms=np.where(np.isnan(on_replayed.rms), left_out_rms, on_replayed.rms),
        replayed_rms=on_replayed.rms,
        by_log=np.vstack([on_fitted.by_motion, on_replayed.by_motion]),
        logs=len(samples),
        replayed_logs=len(held_out),
        is_made=motions.are_made,
    )
    notes = (*best.model.notes, *motions.notes)
    return replace(best.model, loss=loss, notes=notes)


@dataclass(frozen=True, kw_only=True)
class _Reduced:
    """A model as it is written, and how it stands to the file's torque.

    Attributes
    ----------
    model : ExportModel
        With the numbers that are written.
    added : (11 n,) array
        Standard parameters of its bodies that are no part of the torque to be met.
    held : float
        1 where it has the held effects, 0 where it has not.
    excess : (n,) array or float
        By how much more it loses where it was not fitted, in the mean square, (N m)^2.
    """

    model: ExportModel
    added: Array
    held: float = 1.0
    excess: Array | float = 0.0

    def lost(self, samples: Sequence[TorqueSamples]) -> LostTorque:
        """Return what the model loses of the file's torque on motions."""
        return LostTorque.of(self.model, samples, self.added, held=self.held)


def _reduced(
    fitting: Fitting,
    unrefined: Unrefined,
    samples: Sequence[TorqueSamples],
    *,
    is_refined: bool,
    is_measured: bool,
) -> _Reduced:
    """Fit a form, but for the joints at which it was better before a refinement.

    On made motion the whole model's torque is no evidence that a refined form predicts
    the robot better: there every joint keeps what it had, where that is known.
    """
    nothing = np.zeros_like(fitting.added)
    earlier = fitting.model
    earlier_numbers = None
    if is_refined:
        earlier = _earlier(fitting.model, unrefined)
        if unrefined.is_known and not is_measured:
            model = _as_before(fitting.model, earlier, fitting.stages)
            return _Reduced(model=model, added=nothing, held=0.0)
        earlier_numbers = Numbers.of(earlier, fitting.identified, nothing, held=0.0)

    pieces = joint_sums(fitting.model, fitting.identified, samples, pieces=_PIECES)
    decision = decided(fitting, pieces, earlier_numbers)
    if decision.fit is None:
        model = _as_before(fitting.model, earlier, fitting.stages)
        return _Reduced(model=model, added=nothing, held=0.0, excess=decision.excess)

    notes = [text.replace(LEFT_OUT, _FITTED) for text in decision.fit.notes]
    joints = zip(fitting.model.robot.joint_names, decision.kept_joints, strict=True)
    names = [name for name, is_kept in joints if is_kept]
    if names:
        notes.append(f"{', '.join(names)}: {_KEPT}")
    return _Reduced(
        model=replace(decision.fit, notes=tuple(notes)),
        added=fitting.added,
        excess=decision.excess,
    )


def _earlier(model: ExportModel, unrefined: Unrefined) -> ExportModel:
    """Return a model as it was written before its refinement."""
    robot = model.robot
    earlier = export_model(robot, unrefined.stages, (), None)
    earlier = replace(earlier, writes_offset=model.writes_offset)
    if not needs_refit(earlier, ()):
        return earlier
    nothing = np.zeros((PER_LINK + 1) * robot.n)
    fitting = Fitting(model=earlier, stages=unrefined.stages, added=nothing)
    samples = unrefined.samples(robot)
    # Summed up as then: where bodies are hardly determined, the last digits tell.
    pieces = joint_sums(earlier, fitting.identified, samples, pieces=_PIECES)
    return fitting.fitted(sum_of(pieces))


def _as_before(model: ExportModel, earlier: ExportModel, stages: Stages) -> ExportModel:
    """Return the model with all numbers of the earlier one, and nothing of the effects.

    Its bodies are compared with the base parameters that the earlier file asked for.
    """
    of_file = identified(stages, model.robot)
    expression = of_file.basis.expression[list(of_file.rows)]
    exported = expression @ earlier.standard

    # A parameter that the earlier file did not determine was not asked for: there the
    # bodies cannot deviate.
    asked_by_name = {
        entry.name: entry.identified if entry.refitted is None else entry.refitted
        for entry in earlier.deviations
    }
    names = [of_file.basis.names[row] for row in of_file.rows]
    asked_values = np.array(
        [
            asked_by_name.get(name, value)
            for name, value in zip(names, exported.tolist(), strict=True)
        ]
    )

    notes = list(model.notes)
    for fate in (LEFT_OUT, ADDED, WRITTEN):
        notes = [text.replace(fate, _AS_BEFORE) for text in notes]
    return replace(
        model,
        nearest=earlier.nearest,
        friction=earlier.friction,
        deviations=deviations(of_file, asked_values, earlier.standard),
        springs=np.zeros_like(model.springs),
        gaps=np.zeros_like(model.gaps),
        refitted=earlier.refitted,
        notes=tuple(notes),
    )
