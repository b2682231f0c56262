"""What held-out logs confirm stays, what they do not is taken out and told."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement import confirm as confirming
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.held_out import BlockErrors, held_out_error
from seqid_cli.discover.refinement.loop import (
    NextName,
    NextStep,
    PlaceToFill,
    Step,
    with_effects,
)
from seqid_cli.discover.refinement.reidentify import RefinementData, Refitted
from seqid_cli.discover.refinement.rounds import on_the_same_samples, refine
from seqid_cli.discover.select.smooth import smooth_functions
from seqid_cli.params.evidence_schema import RefinementRound
from tests.unit.discover.refinement.plants import recorded

SHOULDER = ("quadratic_drag", 0, 1.0)
ELBOW = ("quadratic_drag", 1, 1.0)
REVERSED = ("quadratic_drag", 1, -1.0)


@pytest.mark.slow
@pytest.mark.usefixtures("few_effects")
def test_what_the_held_out_logs_do_not_confirm_does_not_stay() -> None:
    """While held-out logs are recorded, the elbow has the reverse of what it had."""
    before, later = recorded((SHOULDER, ELBOW)), recorded((SHOULDER, REVERSED))
    robot, file = before.robot, before.file()
    found = refine(
        before.training,
        robot,
        file,
        earlier=before.earlier,
        options=DiscoverOptions(),
    )
    assert {(x.effect, x.joint) for x in found.stages.effects} >= {
        ("quadratic_drag", "shoulder"),
        ("quadratic_drag", "elbow"),
    }

    done = confirm(found, later.held_out)
    assert ("quadratic_drag", "shoulder") in {
        (x.effect, x.joint) for x in done.loop.rounds
    }
    assert "elbow" not in {told.joint for told in done.loop.rounds}
    assert done.loop.verdict == "good"
    gone = next(x for x in done.loop.unconfirmed if x.joint == "elbow")
    assert (gone.effect, gone.accepted, gone.confirmed) == (
        "quadratic_drag",
        True,
        False,
    )
    assert gone.training_gain > 0.5
    low, high = gone.interval
    assert low < gone.held_out_gain < high
    assert low < 0.0
    assert "held-out logs" in gone.reason

    # The file has what is confirmed, fitted again to the training logs without the
    # rest.
    written = {(x.effect, x.joint): x for x in done.stages.effects}
    assert set(written) == {(x.effect, x.joint) for x in done.loop.rounds}
    elbow = [s.friction.joints["elbow"].parameters for s in (done.stages, found.stages)]
    assert elbow[0] != elbow[1]
    known = {told.joint for told in done.loop.rounds}
    assert known == {"shoulder"}

    # The error after is that of the model that is written, on the same samples as
    # before.
    motion = on_the_same_samples(DiscoverOptions(), file.stages, robot).motion
    for told, stages in (
        (done.loop.before, file.stages),
        (done.loop.after, done.stages),
    ):
        error = held_out_error(later.held_out, robot, stages, options=motion)
        np.testing.assert_allclose(
            [x.rmse for x in told.values()], error.rmse(), rtol=1e-8
        )

    # The gain that follows from both is in the middle of its interval.
    for name, (low, high) in done.loop.gain_interval.items():
        ratio = done.loop.after[name].rmse / done.loop.before[name].rmse
        assert 0.5 * (low + high) == pytest.approx(1.0 - ratio**2)

    kept = confirm(found, later.held_out, keep_unconfirmed=True)
    assert kept.stages == found.stages
    assert kept.loop.verdict == "poor"
    assert not kept.loop.unconfirmed
    assert "elbow" in {told.joint for told in kept.loop.doubtful}


@pytest.mark.slow
@pytest.mark.usefixtures("few_effects")
def test_where_nothing_is_confirmed_the_file_stays_as_it_came() -> None:
    before, later = recorded((ELBOW,)), recorded((REVERSED,))
    file = before.file()
    found = refine(
        before.training,
        before.robot,
        file,
        earlier=before.earlier,
        options=DiscoverOptions(),
    )
    assert found.steps
    done = confirm(found, later.held_out)
    assert not done.loop.rounds
    assert done.loop.unconfirmed
    assert done.stages.effects == []
    assert done.stages.friction == file.stages.friction
    assert done.stages.inertia == file.stages.inertia
    assert done.loop.after == done.loop.before


SAMPLES = np.ones((16, 1))
NONE = np.zeros((16, 1))


@dataclass
class Path:
    """Stands in for a refinement of one joint: a model is the set of effects that it
    has.
    """

    steps: list[Step]
    fitted: list[tuple[str, ...]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    not_worth_it: tuple[str, ...] = ()  # by the logs to fit
    incoming_stages = frozenset[str]()
    material = SimpleNamespace(robot=SimpleNamespace(n=1, joint_names=("joint",)))

    def without(self, steps: list[Step]) -> frozenset[str]:
        return frozenset()

    def fitted_again(self, steps: list[Step], later: list[Step]) -> list[Step]:
        again = list(steps)
        for step in later:
            before = again[-1].model if again else frozenset[str]()
            names = before | {told.effect for told in step.rounds}
            self.fitted.append(tuple(sorted(names)))
            again.append(step_of(*(told.effect for told in step.rounds), before=before))
        return again

    def going_on(self, steps: list[Step], place: PlaceToFill) -> NextStep:
        before = steps[-1].model if steps else frozenset[str]()
        refused = []
        for number, name in enumerate(place.names):
            if name.entry.effect in self.not_worth_it:
                refused.append(name.entry)
                continue
            step = step_of(name.entry.effect, before=before)
            rest = (place.names[number + 1 :],)
            step = replace(step, next_names=rest, refused_names=place.refused_names)
            return NextStep(step, refused)
        return NextStep(None, refused)


def step_of(*names: str, before: frozenset[str] = frozenset()) -> Step:
    rounds = tuple(
        RefinementRound(effect=name, joint="joint", acts_on=["joint"]) for name in names
    )
    model = before | set(names)
    beside = tuple(model - {name} for name in names) if len(names) > 1 else ()
    return Step(
        rounds=rounds, effects=names, keeps_stages=True, model=model, beside=beside
    )


class Errors:
    """Squared errors that every effect of a model changes by a factor."""

    def __init__(self, factors: dict[frozenset[str], float]) -> None:
        self.factors = factors

    def measure(self, came: frozenset[str], models: list[frozenset[str]]) -> None:
        assert all(model in self.factors for model in models)

    def of_model(self, model: frozenset[str]) -> BlockErrors:
        return BlockErrors(self.factors[model] * SAMPLES, SAMPLES, NONE, NONE)


def settled(path: Path, errors: dict[str, float]) -> tuple[list[str], list[str]]:
    """Return the effects that stay and those taken out; errors by a model's effects."""
    by_model = {frozenset(names): error for names, error in errors.items()}
    done = confirming._settled(path, Errors(by_model), keep_unconfirmed=False)
    entries = [told for step in done.steps for told in step.rounds]
    assert all(told.confirmed for told in entries)
    path.refused = [told.effect for told in done.refused]
    return [told.effect for told in entries], [told.effect for told in done.taken_out]


def path_of(*rounds: str) -> Path:
    """Return a path of rounds, each of effects of one letter."""
    steps, before = [], frozenset[str]()
    for names in rounds:
        steps.append(step_of(*names, before=before))
        before = steps[-1].model
    return Path(steps)


def test_what_came_after_is_fitted_again_and_measured_again() -> None:
    """b makes it worse, and hides what c gains, which is confirmed without it."""
    path = path_of("a", "b", "c")
    errors = {"": 1.0, "a": 0.5, "ab": 0.6, "abc": 0.6, "ac": 0.4}
    assert settled(path, errors) == (["a", "c"], ["b"])
    assert path.fitted == [("a", "c")]


def test_the_weakest_is_taken_out_first() -> None:
    """b and c stand for one thing: one of them stays."""
    path = path_of("a", "bc")
    errors = {"": 1.0, "a": 0.5, "ab": 0.3, "ac": 0.31, "abc": 0.3}
    assert settled(path, errors) == (["a", "b"], ["c"])


def test_what_stood_on_something_that_is_gone_may_go_as_well() -> None:
    """c gains beside b alone."""
    path = path_of("a", "b", "c")
    errors = {"": 1.0, "a": 0.5, "ab": 0.6, "abc": 0.3, "ac": 0.55}
    assert settled(path, errors) == (["a"], ["b", "c"])


def with_next_names(path: Path, *names: str) -> Path:
    """Return a path whose last effect goes on by other names."""
    *first, last = path.steps
    next_names = tuple(
        NextName(
            entry=RefinementRound(effect=name, joint="joint", acts_on=["joint"]),
            effect=None,
        )
        for name in names
    )
    return Path([*first, replace(last, next_names=(next_names,))])


def test_the_next_name_is_tried_where_held_out_logs_refuse_one() -> None:
    """b stands for c, which is its next name but one; d is not asked any more."""
    path = with_next_names(path_of("a", "b"), "e", "c", "d")
    path.not_worth_it = ("e",)
    errors = {"": 1.0, "a": 0.5, "ab": 0.6, "ac": 0.3}
    assert settled(path, errors) == (["a", "c"], ["b"])
    assert path.refused == ["e"]


def test_names_are_tried_until_none_is_left() -> None:
    path = with_next_names(path_of("a", "b"), "c", "d")
    errors = {"": 1.0, "a": 0.5, "ab": 0.6, "ac": 0.5, "ad": 0.7}
    assert settled(path, errors) == (["a"], ["b", "c", "d"])


def test_a_name_that_follows_others_must_be_surer() -> None:
    """What is certain at one of twenty by chance is not, of twenty that are tried."""
    rng = np.random.default_rng(5)
    robot = SimpleNamespace(n=1, joint_names=("joint",))
    refinement = SimpleNamespace(material=SimpleNamespace(robot=robot))
    before = BlockErrors(SAMPLES, SAMPLES, NONE, NONE)
    after = before._replace(squares=SAMPLES * rng.normal(0.9, 0.16, (16, 1)))
    entry = RefinementRound(effect="a", joint="joint", acts_on=["joint"])
    confirmed = [
        confirming._with_gain(
            entry, before, after, refinement, level=confirming._level_after(n_refused)
        ).confirmed
        for n_refused in (0, 3)
    ]
    assert confirmed == [True, False]


@pytest.mark.parametrize(("other", "confirmed"), [(1.1, True), (1.6, False)])
def test_what_the_other_joints_lose_counts(other: float, *, confirmed: bool) -> None:
    """An effect takes half of the error at its joint, and changes that of another."""
    robot = SimpleNamespace(n=2, joint_names=("joint", "other"))
    refinement = SimpleNamespace(material=SimpleNamespace(robot=robot))
    samples = np.ones((16, 2))
    before = BlockErrors(samples, samples, 0.0 * samples, 0.0 * samples)
    after = before._replace(squares=samples * [0.5, other])
    entry = RefinementRound(effect="a", joint="joint", acts_on=["joint"])
    entry = confirming._with_gain(entry, before, after, refinement)
    assert entry.confirmed is confirmed
    assert entry.held_out_gain == pytest.approx(0.5)
    if not confirmed:
        said = confirming._reason_against(entry)
        assert said.startswith("the other joints lose more by it")


def test_an_effect_counts_at_all_joints_that_it_acts_on() -> None:
    """A coupled pair is named at one joint; at the other one it makes things worse."""
    robot = SimpleNamespace(n=2, joint_names=("joint", "other"))
    refinement = SimpleNamespace(material=SimpleNamespace(robot=robot))
    samples = np.ones((16, 2))
    before = BlockErrors(samples, samples, 0.0 * samples, 0.0 * samples)
    after = before._replace(squares=samples * [0.5, 1.3])
    entry = RefinementRound(
        effect="coupling", joint="joint", acts_on=["joint", "other"]
    )
    entry = confirming._with_gain(entry, before, after, refinement)
    assert entry.held_out_gain == pytest.approx(0.5 * (0.5 - 0.3))


def test_the_identified_part_decides_and_the_other_one_is_told() -> None:
    """Half of the error within goes; beyond, in a fifth of the rows, it may grow."""
    rng = np.random.default_rng(3)
    robot = SimpleNamespace(n=1, joint_names=("joint",))
    refinement = SimpleNamespace(material=SimpleNamespace(robot=robot))
    samples = np.full((16, 1), 100.0)
    beyond = 5.0 * rng.gamma(0.5, 2.0, (16, 1))
    moved = beyond * rng.uniform(0.2, 4.0, (16, 1))
    before = BlockErrors(1.0 + beyond, samples, beyond, 0.2 * samples)
    after = BlockErrors(0.5 + moved, samples, moved, 0.2 * samples)
    entry = RefinementRound(effect="a", joint="joint", acts_on=["joint"])
    entry = confirming._with_gain(entry, before, after, refinement)
    assert entry.confirmed
    assert entry.held_out_gain == pytest.approx(0.5)
    assert entry.gain_outside == pytest.approx(1.0 - moved.sum() / beyond.sum())
    low, high = entry.interval_outside
    assert low < entry.gain_outside < high


@pytest.mark.slow
def test_a_smooth_term_is_fitted_again_to_the_training_logs() -> None:
    """On top of a model without the effect it takes in what the effect left."""
    logs = recorded((ELBOW,))
    options = on_the_same_samples(DiscoverOptions(), logs.file().stages, logs.robot)
    material = RefinementData(tuple(logs.training), logs.earlier, logs.robot, options)
    before = Refitted(logs.file().stages, ())
    rows = material.ground(before).stage.rows
    speed = next(
        what for what in smooth_functions(rows, 1) if what.quantities == ("velocity",)
    )
    step = Step(
        rounds=(RefinementRound(effect="unexplained", joint="elbow"),),
        smooth=speed,
        keeps_stages=True,
        model=before,
    )

    after = step.again(material, before).model
    assert after.stages is before.stages
    (term,) = after.effects
    assert (term.joint, term.quantities) == (1, ("velocity",))
    errors = [
        held_out_error(
            logs.training,
            logs.robot,
            with_effects(model, logs.robot),
            options=options.motion,
        ).rmse()
        for model in (before, after)
    ]
    assert errors[1][1] < 0.8 * errors[0][1]
