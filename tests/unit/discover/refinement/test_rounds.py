"""Rounds of a refinement: one effect at all its joints, what is not worth it, the
limit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.held_out import Gain
from seqid_cli.discover.refinement.loop import CandidateModel, Decision, Judgement
from seqid_cli.discover.refinement.reidentify import fitted_smooth
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.discover.select.options import Options
from seqid_cli.effects.fitted import FittedEffect
from seqid_cli.effects.position_dependent_friction import (
    PositionDependentFriction,
)
from seqid_cli.effects.registry import CATALOGUE
from tests.unit.discover.refinement.plants import recorded
from tests.unit.effects.few import only_effects

BOTH = (("presliding_hysteresis", 0, 1.0), ("presliding_hysteresis", 1, 1.0))


@pytest.mark.slow
@pytest.mark.usefixtures("few_effects")
def test_the_same_effect_at_all_joints_is_one_round() -> None:
    """A limit of one round takes it in at every joint, and nothing is left untried."""
    logs = recorded(BOTH)
    found = refine(
        logs.training,
        logs.robot,
        logs.file(),
        earlier=logs.earlier,
        options=DiscoverOptions(max_effects=1),
    )
    done = confirm(found, logs.held_out)

    added = [(told.round, told.effect, told.joint) for told in done.loop.rounds]
    names = logs.robot.joint_names
    assert sorted(added) == sorted((1, "presliding_hysteresis", name) for name in names)
    assert len(done.stages.effects) == len(names)
    assert done.loop.stopped_at is None
    assert all(told.confirmed for told in done.loop.rounds)


@pytest.mark.slow
@pytest.mark.usefixtures("few_effects")
def test_a_limit_that_stops_it_is_told() -> None:
    logs = recorded(
        (("presliding_hysteresis", 0, 1.0), ("load_dependent_friction", 1, 1.0))
    )
    file = logs.file()
    found = refine(
        logs.training,
        logs.robot,
        file,
        earlier=logs.earlier,
        options=DiscoverOptions(max_effects=1),
    )
    done = confirm(found, logs.held_out)

    assert {told.round for told in done.loop.rounds} == {1}
    stopped = done.loop.stopped_at
    assert stopped.rounds == 1
    added = {(told.effect, told.joint) for told in done.loop.rounds}
    untried = {(item.effect, item.joint) for item in stopped.untried}
    assert untried
    assert not untried & added


@pytest.mark.slow
def test_a_limit_binds_smooth_terms_and_they_are_fitted_beside_the_stages() -> None:
    """Both joints have a drag that no effect of the catalogue explains."""
    logs = recorded((("quadratic_drag", 0, 1.0), ("quadratic_drag", 1, 1.0)))
    options = DiscoverOptions(max_effects=1, with_unexplained=True)
    with only_effects(["spring"]):
        found = refine(
            logs.training,
            logs.robot,
            logs.file(),
            earlier=logs.earlier,
            options=options,
        )
    (step,) = found.steps
    (entry,) = step.rounds
    assert entry.effect == "unexplained"
    other = {"shoulder": "elbow", "elbow": "shoulder"}[entry.joint]
    assert [(item.effect, item.joint) for item in found.untried] == [
        ("unexplained", other)
    ]

    term = step.model.effects[-1]
    again = fitted_smooth(found.material, found.incoming_model, step.smooth)
    np.testing.assert_allclose(term.coefficients, again.coefficients)
    assert term.session.logs == [log.sha256 for log in logs.training]
    assert step.model.stages is found.incoming_model.stages


def candidate(waves: float, joint: int = 0) -> Candidate:
    """Return friction in so many waves over a joint's position."""
    settings = {"period": 2.0 * np.pi, "waves": waves}
    return Candidate(PositionDependentFriction(), joint, settings)


def sized(effect: Candidate, size: float) -> float:
    """Return the size that a round sees of an effect: coefficients over errors."""
    count = effect.size
    fitted = FittedEffect(
        effect=effect.effect,
        joint=effect.joint,
        settings=effect.settings,
        coefficients=np.full(count, size * 0.2),
        covariance=0.04 * np.eye(count),
    )
    candidate_model = CandidateModel(
        loop=None, results=(None,), effects=(effect,), keeps_stages=False
    )
    candidate_model.__dict__["model"] = SimpleNamespace(effects=(fitted,))
    return candidate_model._size(0)


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_coefficients_are_measured_by_their_errors(size: float) -> None:
    assert sized(candidate(5.0), size) == pytest.approx(size)


@dataclass(frozen=True)
class Round:
    """Stands in for a candidate model: `gains` by joint and `sizes` by form."""

    effects: tuple[Candidate, ...]
    gains: dict[int, float]  # by joint
    sizes: dict[float, float]  # by number of waves
    results: tuple[Candidate, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "results", self.effects)

    @property
    def judgements(self) -> tuple[Judgement, ...]:
        gains = [self.gains[effect.joint] for effect in self.effects]
        return tuple(
            Judgement(
                change=Gain(gain, gain - 0.01, gain + 0.01),
                min_gain=Options().improvement,
                chance_probability=0.0 if gain > 0.0 else 1.0,
                is_likely=True,
                is_determined=self.sizes.get(effect.settings.get("waves", 0.0), 9.0)
                > 1.0,
                is_shown=True,
                lacking="",
                is_unjudged=False,
            )
            for effect, gain in zip(self.effects, gains, strict=True)
        )

    losing = ()
    accepted, weakest = CandidateModel.accepted, CandidateModel.weakest
    with_simpler = CandidateModel.with_simpler

    def fault_of(self, number: int) -> str:
        return self.judgements[number].fault

    @property
    def without_each(self) -> tuple[Round, ...]:
        every = range(len(self.effects))
        rest = [tuple(self.effects[k] for k in every if k != gone) for gone in every]
        return tuple(replace(self, effects=added) for added in rest)


def decided(*effects: Candidate, gains: dict[int, float], **sizes: float) -> Decision:
    by_waves = {float(name.removeprefix("of_")): size for name, size in sizes.items()}
    return Decision.of(Round(effects, gains, by_waves))


def test_an_effect_that_is_not_worth_it_at_one_joint_is_refused_there_alone() -> None:
    law = CATALOGUE["load_dependent_friction"]
    effects = [Candidate(law, joint, {}) for joint in range(3)]
    done = decided(*effects, gains={0: 0.5, 1: 0.01, 2: 0.3})
    assert [effect.joint for effect in done.candidate_model.effects] == [0, 2]
    ((refused, _, reason),) = done.refused
    assert refused.joint == 1
    assert reason == "the model identified anew with it is not certainly better"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"is_shown": False}, "these logs show too little of it"),
        (
            {"lacking": "no motion tells the rotor"},
            "is not determined by these logs: no motion tells the rotor",
        ),
    ],
)
def test_what_the_logs_cannot_show_is_refused(
    changes: dict[str, Any], reason: str
) -> None:
    law = CATALOGUE["joint_elasticity"]
    (sound,) = Round((Candidate(law, 0, {}),), {0: 0.5}, {}).judgements
    assert sound.fault == ""
    assert replace(sound, **changes).fault == reason


def test_waves_below_their_errors_give_way_to_fewer() -> None:
    done = decided(candidate(5.0), gains={0: 0.5}, of_5=0.6, of_3=0.8, of_2=2.5)
    (effect,) = done.candidate_model.effects
    assert effect.settings["waves"] == 2.0
    assert not done.refused


def test_a_cubic_spring_below_its_errors_gives_way_to_a_linear_one() -> None:
    """Stages that move leave the stiffness, and not by what it grows."""
    cubic = Candidate(CATALOGUE["spring"], 0, {"cubic": 1.0})
    linear = CATALOGUE["spring"].simpler(cubic.settings)
    assert linear == {"cubic": 0.0}
    assert CATALOGUE["spring"].simpler(linear) is None

    @dataclass(frozen=True)
    class OfSpring(Round):
        @property
        def judgements(self) -> tuple[Judgement, ...]:
            (judgement,) = super().judgements
            is_linear = self.effects[0].settings["cubic"] == 0.0
            return (replace(judgement, is_determined=is_linear),)

    done = Decision.of(OfSpring((cubic,), {0: 0.5}, {}))
    (effect,) = done.candidate_model.effects
    assert effect.settings == linear
    assert not done.refused


def test_coefficients_smaller_than_their_errors_are_not_added() -> None:
    none = {"of_5": 0.6, "of_3": 0.8, "of_2": 0.9, "of_1": 0.5}
    done = decided(candidate(5.0), gains={0: 0.5}, **none)
    assert not done.candidate_model.effects
    ((_, _, reason),) = done.refused
    assert reason == "its coefficients are smaller than their errors"
