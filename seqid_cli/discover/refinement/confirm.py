"""What held-out logs say of a refinement: opened after the last decision on the logs to fit.

They choose no effect, no setting and no value. By a rule that is fixed beforehand they
take out what they do not confirm: the effect of the smallest gain among those whose
gain is not certainly more than nothing, as long as there is one. The rest of its round
and what was added after it are then fitted again to the logs to fit, on top of a model
that never had the effect, and measured again. So every effect that stays is confirmed
beside those that stay, and the error after is that of the model that is written.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec import structs

from seqid_cli.discover.base import residual_of
from seqid_cli.discover.noise.floor import NoiseFloor, encoder_residuals, noise_floor
from seqid_cli.discover.refinement.held_out import (
    Gain,
    HeldOutError,
    WholeLogs,
    gain,
    held_out_error,
)
from seqid_cli.discover.refinement.loop import Refinement, Step, with_effects
from seqid_cli.discover.refinement.reidentify import Refitted
from seqid_cli.discover.scenes import scenes_of, usable_logs, with_own_cutoffs
from seqid_cli.discover.select.options import Options
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import ClosedLoop, EffectOfPlace, Stages, StoppedAt
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent


@dataclass(frozen=True, kw_only=True)
class Confirmed:
    """The model that a refinement ends with, and what is said of it."""

    stages: Stages
    loop: ClosedLoop


def confirm(
    refinement: Refinement,
    held_out: Sequence[Recording],
    whole: WholeLogs | None = None,
    *,
    keep_unconfirmed: bool = False,
) -> Confirmed:
    """Measure a refinement on logs that had no say in it, and take out what they do not confirm.

    Parameters
    ----------
    refinement : Refinement
        What was decided on the logs to fit.
    held_out : sequence of Recording
        With torque or current; before and after are measured on the same samples of
        them.
    whole : WholeLogs, optional
        The held-out logs as they are, where `held_out` are pieces of them.
    keep_unconfirmed : bool
        Leave in what is not confirmed; the verdict is poor then.

    Returns
    -------
    Confirmed
        Each effect's gain is beside the model before its round, with the round's other
        effects; it is confirmed where that is certainly more than nothing.

    Raises
    ------
    InputError
        No held-out log has a measured torque.
    """
    robot, options = refinement.material.robot, refinement.material.options
    held_out, notes = usable_logs(held_out, robot)
    motion = with_own_cutoffs(
        held_out, robot, refinement.incoming_stages, options.motion
    )
    errors = _Errors(logs=held_out, robot=robot, options=motion, whole=whole)
    steps, taken_out = _settled(refinement, errors, keep_unconfirmed=keep_unconfirmed)

    model = steps[-1].model if steps else refinement.incoming_model
    before = errors.of(refinement.incoming_stages)
    after = errors.of_model(model) if steps else before
    floor = _floor(refinement, model, held_out, motion)

    names = robot.joint_names
    new = after.rmse()
    judged = [j for j in range(robot.n) if np.isfinite(new[j])]
    changes = {names[j]: gain(before, after, [j]) for j in judged}
    times = {names[j]: float(new[j] / floor.rms[j]) for j in judged}
    rounds = [entry for step in steps for entry in step.rounds]
    return Confirmed(
        stages=with_effects(model, robot),
        loop=ClosedLoop(
            verdict="good" if all(entry.confirmed for entry in rounds) else "poor",
            rounds=rounds,
            unconfirmed=taken_out,
            refused=refinement.refused,
            stopped_at=_stopped_at(refinement),
            before=before.by_joint(names),
            after=after.by_joint(names),
            noise_floor={names[j]: float(floor.rms[j]) for j in judged},
            noise_floor_interval={names[j]: list(floor.interval(j)) for j in judged},
            gain_interval={name: g.limits for name, g in changes.items() if g.limits},
            evaluated_on=list(dict.fromkeys(str(log.path) for log in held_out)),
            notes=[
                *refinement.notes,
                *notes,
                *errors.notes,
                *_taken_out_note(taken_out, rounds),
                *_loss_note(changes),
                *excess_note(times, smooth=options.with_unexplained),
                *floor.doubts(new, robot.joints),
            ],
        ),
    )


@dataclass(kw_only=True)
class _Errors:
    """Errors of models on the held-out logs: on all samples where they can be passed over."""

    logs: Sequence[Recording]
    robot: Robot
    options: InertiaOptions
    whole: WholeLogs | None
    _pieces: bool = False
    _measured_models: dict[int, tuple[object, HeldOutError]] = field(
        default_factory=dict
    )

    def of_model(self, model: Refitted) -> HeldOutError:
        """Squared errors of a model, block by block."""
        return self._of(model, with_effects(model, self.robot))

    def of(self, stages: Stages) -> HeldOutError:
        """Squared errors of the stages of a file."""
        return self._of(stages, stages)

    def measure(self, came: Stages, models: Sequence[Refitted]) -> None:
        """Measure models beforehand, so that all are measured on the same samples."""
        pieces = None
        # the first that needs pieces has the others measured again
        while pieces != self._pieces:
            pieces = self._pieces
            self.of(came)
            for model in models:
                self.of_model(model)

    @property
    def notes(self) -> tuple[str, ...]:
        """Say on what the errors are, where the logs are too long to be held."""
        if self.whole is None:
            return ()
        which = "pieces of the" if self._pieces else "the whole"
        return (f"errors are of {which} held-out logs",)

    def _of(self, key: object, stages: Stages) -> HeldOutError:
        known = self._measured_models.get(id(key))
        if known is None:
            known = key, self._measured(stages)
            self._measured_models[id(key)] = known
        return known[1]

    def _measured(self, stages: Stages) -> HeldOutError:
        if self.whole is not None and not self._pieces:
            if errors := self.whole.errors([stages], self.options):
                return errors[0]
            # A model that cannot be predicted part by part: all are measured on the
            # pieces.
            self._pieces = True
            self._measured_models.clear()
        return held_out_error(self.logs, self.robot, stages, self.options)


def _settled(
    refinement: Refinement, errors: _Errors, *, keep_unconfirmed: bool
) -> tuple[list[Step], list[RefinementRound]]:
    """Return the rounds that stay, each effect with what it gains, and the effects taken out."""
    steps, taken_out = list(refinement.steps), list[RefinementRound]()
    while True:
        steps = _measured(refinement, steps, errors)
        unsure = [
            (number, entry)
            for number, step in enumerate(steps)
            for entry in step.rounds
            if not entry.confirmed
        ]
        if keep_unconfirmed or not unsure:
            return steps, taken_out

        # One at a time: what stands in for another one is confirmed once that is gone.
        number, weakest = min(unsure, key=lambda pair: pair[1].held_out_gain or 0.0)
        taken_out.append(structs.replace(weakest, reason=_why(weakest)))
        rest = steps[number].without(weakest)
        later = steps[number + 1 :] if rest is None else [rest, *steps[number + 1 :]]
        steps = refinement.fitted_again(steps[:number], later)


def _why(entry: RefinementRound) -> str:
    """Return why an effect does not stay."""
    if entry.interval and entry.interval[1] < 0.0:
        return "the held-out logs are predicted worse with it"
    return "its gain on the held-out logs is not certainly more than nothing"


def _measured(
    refinement: Refinement, steps: Sequence[Step], errors: _Errors
) -> list[Step]:
    """Return the rounds, each effect with what it gains on the held-out logs."""
    if not steps:
        return []

    robot = refinement.material.robot
    start = refinement.without(steps)
    errors.measure(
        refinement.incoming_stages,
        [start, *(model for step in steps for model in step.models)],
    )
    measured = []
    for step, last in zip(
        steps, [start, *(step.model for step in steps)], strict=False
    ):
        rounds = []
        earlier = step.beside or (last,) * len(step.rounds)
        for entry, before in zip(step.rounds, earlier, strict=True):
            joints = range(robot.n)
            if entry.joint is not None:
                joints = range(at := robot.joint_names.index(entry.joint), at + 1)
            change = gain(errors.of_model(before), errors.of_model(step.model), joints)
            rounds.append(
                structs.replace(
                    entry,
                    held_out_gain=change.value,
                    interval=change.limits,
                    confirmed=change.certain,
                )
            )
        measured.append(replace(step, rounds=tuple(rounds)))
    return measured


def _stopped_at(refinement: Refinement) -> StoppedAt | None:
    """Return the limit of rounds where it has left effects untried."""
    limit, robot = refinement.material.options.max_effects, refinement.material.robot
    if limit is None or not refinement.untried:
        return None
    places = [
        (effect.effect.name, robot.name_of(effect.joint))
        for effect in refinement.untried
    ]
    untried = [
        EffectOfPlace(effect=name, joint=joint) for name, joint in dict.fromkeys(places)
    ]
    return StoppedAt(rounds=limit, untried=untried)


def _taken_out_note(
    taken_out: Sequence[RefinementRound], rounds: Sequence[RefinementRound]
) -> tuple[str, ...]:
    """Say how the model came about where something was taken out of it."""
    if not taken_out:
        return ()
    places = (
        f"{entry.effect} at {entry.joint or 'the whole arm'}" for entry in taken_out
    )
    names = ", ".join(places)
    note = f"taken out, as the held-out logs do not confirm it: {names}"
    if rounds:
        note += (
            "; what was added after it is fitted again without it, and measured again"
        )
    return (note,)


def _loss_note(changes: Mapping[str, Gain]) -> tuple[str, ...]:
    """Say which joints are certainly predicted worse, by more than is small."""
    lost = {
        n: -g.value for n, g in changes.items() if g.loses and -g.value > Options.small
    }
    worse = ", ".join(f"{name} ({percent(share)})" for name, share in lost.items())
    said = f"predicted worse than before, in squared error where they slide: {worse}"
    return (said,) if lost else ()


def excess_note(times: Mapping[str, float], *, smooth: bool) -> tuple[str, ...]:
    """Say which joints have so many `times` the noise floor left, and what to do."""
    said = ", ".join(
        f"{name} ({x:.1f} times)" for name, x in times.items() if x > MORE_THAN_NOISE
    )
    ask = "diagnose says on what it depends"
    ask += "" if smooth else ", refine --with-unexplained adds a smooth term for it"
    note = f"more is left than torque noise and encoder account for: {said}; {ask}"
    return (note,) if said else ()


def _floor(
    refinement: Refinement,
    model: Refitted,
    held_out: Sequence[Recording],
    options: InertiaOptions,
) -> NoiseFloor:
    """Noise floor of the held-out logs; the training logs help to find it."""
    material = refinement.material
    material = replace(material, options=replace(material.options, motion=options))
    logs = (*held_out, *material.training)
    freed = [material.without(log, model.stages, model.effects) for log in logs]
    scenes = scenes_of(freed, material.robot, model.stages, options=options)
    left, echo = (
        [residual_of(scene) for scene in scenes],
        encoder_residuals(freed, scenes),
    )
    return noise_floor(freed, scenes, left, echo, judged=len(held_out))
