"""What held-out logs say of a refinement: opened after the last decision.

They choose no effect, no setting and no value. By a rule that is fixed beforehand they
take out what they do not confirm: the effect of the smallest gain among those whose
gain is not certainly more than nothing, or is less than what the other joints lose, as
long as there is one. The rest of its round
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
    BlockErrors,
    Gain,
    WholeLogs,
    gain,
    gain_of,
    held_out_error,
)
from seqid_cli.discover.refinement.loop import (
    PlaceToFill,
    Refinement,
    Step,
    with_effects,
)
from seqid_cli.discover.refinement.reidentify import Refitted
from seqid_cli.discover.scenes import scenes_of, usable_logs, with_own_cutoffs
from seqid_cli.discover.select.options import Options
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.params.evidence_schema import RefinementRound
from seqid_cli.params.results.diagnosis import MORE_THAN_NOISE
from seqid_cli.params.schema import ClosedLoop, Stages, StoppedAt
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
    whole_logs: WholeLogs | None = None,
    *,
    keep_unconfirmed: bool = False,
) -> Confirmed:
    """Measure a refinement on logs that had no say, and take out what fails there.

    Parameters
    ----------
    refinement : Refinement
        What was decided on the logs to fit.
    held_out : sequence of Recording
        With torque or current; before and after are measured on the same samples of
        them.
    whole_logs : WholeLogs, optional
        The held-out logs as they are, where `held_out` are pieces of them.
    keep_unconfirmed : bool
        Leave in what is not confirmed; the verdict is poor then.

    Returns
    -------
    Confirmed
        Each effect's gain is beside the model before its round, with the round's other
        effects. It is confirmed where that is certainly more than nothing, and the
        other joints do not lose more.

    Raises
    ------
    InputError
        No held-out log has a measured torque.
    """
    robot = refinement.material.robot
    options = refinement.material.options
    names = robot.joint_names

    held_out, notes_on_logs = usable_logs(
        held_out, robot, settings=options.settings.echo
    )
    motion_options = with_own_cutoffs(
        held_out,
        robot,
        refinement.incoming_stages,
        options.motion,
        options.settings.evidence,
    )
    errors = _Errors(
        logs=held_out, robot=robot, options=motion_options, whole_logs=whole_logs
    )
    settled = _settled(refinement, errors, keep_unconfirmed=keep_unconfirmed)
    steps = settled.steps
    taken_out = settled.taken_out

    # What the model that is written leaves, beside what the file left.
    model = steps[-1].model if steps else refinement.incoming_model
    error_before = errors.of(refinement.incoming_stages)
    error_after = errors.of_model(model) if steps else error_before
    rmse_after = error_after.rmse()
    sliding_joints = [j for j in range(robot.n) if np.isfinite(rmse_after[j])]
    gains = {
        names[j]: gain_of(error_before.squares[:, j], error_after.squares[:, j])
        for j in sliding_joints
    }

    # The same beside what noise alone would leave.
    floor = _noise_floor(refinement, model, held_out, motion_options)
    floors_left = {
        names[j]: float(rmse_after[j] / floor.rms[j]) for j in sliding_joints
    }

    rounds = [entry for step in steps for entry in step.rounds]
    loop = ClosedLoop(
        verdict="good" if all(entry.confirmed for entry in rounds) else "poor",
        rounds=rounds,
        unconfirmed=taken_out,
        refused=[*refinement.refused, *settled.refused],
        tried=refinement.tried,
        stopped_at=_stopped_at(refinement),
        before=error_before.by_joint(names),
        after=error_after.by_joint(names),
        noise_floor={names[j]: float(floor.rms[j]) for j in sliding_joints},
        noise_floor_interval={
            names[j]: list(floor.interval(j)) for j in sliding_joints
        },
        gain_interval={
            name: change.limits for name, change in gains.items() if change.limits
        },
        evaluated_on=_unique_paths(held_out),
        notes=[
            *refinement.notes,
            *notes_on_logs,
            *errors.notes,
            *_taken_out_note(taken_out, rounds),
            *_loss_note(gains, refinement.material.selection_options),
            *excess_note(floors_left, smooth=options.with_unexplained),
            *floor.doubts(rmse_after, robot.joints),
        ],
    )
    return Confirmed(stages=with_effects(model, robot), loop=loop)


@dataclass(kw_only=True)
class _Errors:
    """Errors of models on the held-out logs, each measured once.

    They are on all samples where all models can be predicted part by part, else on
    pieces of the logs.
    """

    logs: Sequence[Recording]
    robot: Robot
    options: InertiaOptions
    whole_logs: WholeLogs | None
    _uses_pieces: bool = False
    # by the identity of a model, which is kept so that no other one has it
    _measured_models: dict[int, tuple[object, BlockErrors]] = field(
        default_factory=dict
    )

    def of_model(self, model: Refitted) -> BlockErrors:
        """Return the squared errors of a model, block by block."""
        return self._of(model, with_effects(model, self.robot))

    def of(self, stages: Stages) -> BlockErrors:
        """Return the squared errors of the stages of a file."""
        return self._of(stages, stages)

    def measure(self, incoming_stages: Stages, models: Sequence[Refitted]) -> None:
        """Measure models beforehand, so that all are measured on the same samples."""
        is_settled = False
        while not is_settled:
            # The first model that needs pieces has the others measured again.
            used_pieces = self._uses_pieces
            self.of(incoming_stages)
            for model in models:
                self.of_model(model)
            is_settled = used_pieces == self._uses_pieces

    @property
    def notes(self) -> tuple[str, ...]:
        """What the errors are of, where the logs are too long to be held."""
        if self.whole_logs is None:
            return ()
        extent = "pieces of the" if self._uses_pieces else "the whole"
        return (f"errors are of {extent} held-out logs",)

    def _of(self, key: object, stages: Stages) -> BlockErrors:
        measured = self._measured_models.get(id(key))
        if measured is None:
            measured = key, self._measured(stages)
            self._measured_models[id(key)] = measured
        return measured[1]

    def _measured(self, stages: Stages) -> BlockErrors:
        if self.whole_logs is not None and not self._uses_pieces:
            errors = self.whole_logs.errors([stages], self.options)
            if errors:
                return errors[0]
            # A model that cannot be predicted part by part: all are measured on the
            # pieces.
            self._uses_pieces = True
            self._measured_models.clear()
        return held_out_error(self.logs, self.robot, stages, self.options)


@dataclass(frozen=True, kw_only=True)
class _Settled:
    """What a refinement ends with.

    Attributes
    ----------
    steps : list of Step
        The rounds that stay, with gains.
    taken_out : list of RefinementRound
        Effects that the held-out logs do not confirm.
    refused : list of RefinementRound
        Names that were to follow one of these, and that the logs to fit refuse.
    """

    steps: list[Step]
    taken_out: list[RefinementRound]
    refused: list[RefinementRound]


def _settled(
    refinement: Refinement, errors: _Errors, *, keep_unconfirmed: bool
) -> _Settled:
    """Take out what is not confirmed, and go on with its next names."""
    steps = list(refinement.steps)
    taken_out: list[RefinementRound] = []
    refused: list[RefinementRound] = []
    places: list[PlaceToFill] = []
    while True:
        steps = _measured(refinement, steps, errors)
        unconfirmed = [
            (number, entry)
            for number, step in enumerate(steps)
            for entry in step.rounds
            if not entry.confirmed
        ]
        if keep_unconfirmed:
            break
        if not unconfirmed:
            if not places:
                break
            # Beside all that stays, another name of what was taken out may hold.
            next_step = refinement.going_on(steps, places.pop(0))
            refused += next_step.refused
            if next_step.step is not None:
                steps.append(next_step.step)
            continue

        # One at a time: what stands in for another one is confirmed once that is gone.
        number, weakest = min(
            unconfirmed, key=lambda pair: pair[1].held_out_gain or 0.0
        )
        taken_out.append(structs.replace(weakest, reason=_reason_against(weakest)))
        place = steps[number].in_place_of(weakest)
        if place is not None:
            places.append(place)
        later = steps[number + 1 :]
        remainder = steps[number].without(weakest)
        if remainder is not None:
            later = [remainder, *later]
        steps = refinement.fitted_again(steps[:number], later)
    return _Settled(steps=steps, taken_out=taken_out, refused=refused)


def _reason_against(entry: RefinementRound) -> str:
    """Return why an effect does not stay."""
    if entry.interval and entry.interval[1] < 0.0:
        return "the held-out logs are predicted worse with it"
    if entry.interval and entry.interval[0] > 0.0:
        return (
            "the other joints lose more by it on the held-out logs than its own gains"
        )
    return "its gain on the held-out logs is not certainly more than nothing"


def _measured(
    refinement: Refinement, steps: Sequence[Step], errors: _Errors
) -> list[Step]:
    """Return the rounds, each effect with what it gains on the held-out logs."""
    if not steps:
        return []

    first_model = refinement.without(steps)
    models = [model for step in steps for model in step.models]
    errors.measure(refinement.incoming_stages, [first_model, *models])

    measured = []
    model_before = first_model
    for step in steps:
        # Of several effects each is compared with the model with the others alone.
        models_without = step.beside or (model_before,) * len(step.rounds)
        error_after = errors.of_model(step.model)
        rounds = [
            _with_gain(
                entry,
                errors.of_model(without),
                error_after,
                refinement,
                level=_level_after(len(step.refused_names)),
            )
            for entry, without in zip(step.rounds, models_without, strict=True)
        ]
        measured.append(replace(step, rounds=tuple(rounds)))
        model_before = step.model
    return measured


def _level_after(n_refused: int) -> float:
    """Return the level at which a gain must be certain after refusals at its place.

    The more names are tried there, the likelier one of them gains by chance: what may
    be chance is shared among all of them (Bonferroni).
    """
    return 1.0 - (1.0 - LEVEL) / (1 + n_refused)


def _with_gain(
    entry: RefinementRound,
    error_before: BlockErrors,
    error_after: BlockErrors,
    refinement: Refinement,
    *,
    level: float = LEVEL,
) -> RefinementRound:
    """Return an effect with what it gains at all joints that it acts on.

    It is confirmed where that is certain, and where all joints together gain as well:
    both within the identified friction. What it gains beyond is told beside that.
    """
    robot = refinement.material.robot
    every_joint = list(range(robot.n))
    joints = [robot.joint_names.index(name) for name in entry.acts_on]
    change = gain(error_before, error_after, joints, level=level)
    # Stages that are identified anew with an effect may make another joint worse.
    change_of_arm = gain(error_before, error_after, every_joint)
    beyond = gain(error_before, error_after, joints, "beyond")
    is_beyond = beyond.high > beyond.low  # there are samples
    return structs.replace(
        entry,
        held_out_gain=change.value,
        interval=change.limits,
        gain_outside=beyond.value if is_beyond else None,
        interval_outside=beyond.limits if is_beyond else [],
        confirmed=change.certain and change_of_arm.value > 0.0,
    )


def _stopped_at(refinement: Refinement) -> StoppedAt | None:
    """Return the limit of rounds where it has left effects untried."""
    limit = refinement.material.options.max_effects
    if limit is None or not refinement.untried:
        return None
    places = {(item.effect, item.joint): item for item in refinement.untried}
    return StoppedAt(rounds=limit, untried=list(places.values()))


def _taken_out_note(
    taken_out: Sequence[RefinementRound], rounds: Sequence[RefinementRound]
) -> tuple[str, ...]:
    """Say how the model came about where something was taken out of it."""
    if not taken_out:
        return ()
    places = [
        f"{entry.effect} at {entry.joint or 'the whole arm'}" for entry in taken_out
    ]
    listed = ", ".join(places)
    note = f"taken out, as the held-out logs do not confirm it: {listed}"
    if rounds:
        note += (
            "; what was added after it is fitted again without it, and measured again"
        )
    return (note,)


def _loss_note(gains: Mapping[str, Gain], options: Options) -> tuple[str, ...]:
    """Say which joints are certainly predicted worse, by more than is small."""
    losses = {
        name: -change.value
        for name, change in gains.items()
        if change.loses and -change.value > options.negligible_share
    }
    if not losses:
        return ()
    listed = ", ".join(f"{name} ({percent(share)})" for name, share in losses.items())
    return (
        f"predicted worse than before, in squared error where they slide: {listed}",
    )


def excess_note(times: Mapping[str, float], *, smooth: bool) -> tuple[str, ...]:
    """Say which joints leave more than noise, and what to do.

    Parameters
    ----------
    times : mapping of str to float
        By joint, the RMS residual over its noise floor.
    smooth : bool
        Whether smooth terms were asked for already: then no note proposes them.
    """
    excess = {name: ratio for name, ratio in times.items() if ratio > MORE_THAN_NOISE}
    if not excess:
        return ()
    listed = ", ".join(f"{name} ({ratio:.1f} times)" for name, ratio in excess.items())
    advice = "diagnose says on what it depends"
    if not smooth:
        advice += ", refine --with-unexplained adds a smooth term for it"
    return (
        f"more is left than torque noise and encoder account for: {listed}; {advice}",
    )


def _noise_floor(
    refinement: Refinement,
    model: Refitted,
    held_out: Sequence[Recording],
    motion_options: InertiaOptions,
) -> NoiseFloor:
    """Estimate the noise floor of the held-out logs, with help of the training logs."""
    discover_options = replace(refinement.material.options, motion=motion_options)
    material = replace(refinement.material, options=discover_options)

    # Effects are taken off the torque first: the floor is what a right model leaves.
    logs = [*held_out, *material.training]
    without_effects = [
        material.without(log, model.stages, model.effects) for log in logs
    ]
    scenes = scenes_of(
        without_effects, material.robot, model.stages, options=motion_options
    )
    residuals = [residual_of(scene) for scene in scenes]
    encoder_noise = encoder_residuals(without_effects, scenes)
    return noise_floor(
        without_effects, scenes, residuals, encoder_noise, judged=len(held_out)
    )


def _unique_paths(logs: Sequence[Recording]) -> list[str]:
    """Return each log's path once: excerpts of one log share it."""
    return list(dict.fromkeys(str(log.path) for log in logs))
