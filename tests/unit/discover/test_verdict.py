"""The verdict: what the file leaves, against its noise and a model that is fitted to
the logs.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.discover import base
from seqid_cli.discover.diagnosis import telling_function
from seqid_cli.discover.investigate import FileResidual
from seqid_cli.discover.noise.floor import NoiseFloor
from seqid_cli.discover.nuisances import DELAY, Nuisance, nuisances_of
from seqid_cli.discover.select.model import SelectionProblem
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import ScoredTerm
from seqid_cli.discover.select.rows import Observations, Score, TermFit
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.verdict import _since, joint_states, verdict_of
from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.params.results.diagnosis import UnexplainedPart
from seqid_cli.params.schema import Stages
from tests import Array
from tests.unit.discover.arms import arm_scenes, at_joint, ground_of, selected

BLOCKS, EACH = 10, 40
FLOOR, HIGH = 1.0, 1.4  # N m


@dataclass
class Left:
    """An investigation of one joint, as far as a verdict looks at it."""

    by_file: float
    fitted: float
    samples: int = BLOCKS * EACH
    torque: float = 50.0  # RMS, of the file's model
    explained_joints: set[int] = field(default_factory=set)
    floor: NoiseFloor = field(
        default_factory=lambda: NoiseFloor(*(np.array([x]) for x in (FLOOR, 0.9, HIGH)))
    )

    @property
    def file_rms(self) -> Array:
        return np.array([self.by_file])

    @property
    def file_residual(self) -> SimpleNamespace:
        return SimpleNamespace(samples=[self.samples])

    @property
    def model(self) -> SimpleNamespace:
        linear = SimpleNamespace(left_out=[np.full(BLOCKS * EACH, self.fitted)])
        return SimpleNamespace(linear=linear, rms=lambda: np.array([self.fitted]))

    @property
    def ground(self) -> SimpleNamespace:
        y = np.full(BLOCKS * EACH, self.by_file)
        block = np.repeat(np.arange(BLOCKS), EACH)
        rows = Observations(y=(y,), block=(block,), blocks=BLOCKS)
        base = SimpleNamespace(y=[y])
        torque = (np.full(BLOCKS * EACH, self.torque),)
        return SimpleNamespace(
            n=1, rows=rows, base=base, torque=torque, options=Options()
        )


@pytest.mark.parametrize(
    ("left", "verdict"),
    [
        (Left(1.2, 1.2), "nothing_missing"),
        (Left(35.0, 1.1), "values_changed"),
        # less than 2.5 floors, but surely the file's values
        (Left(2.0, 1.1), "values_changed"),
        (Left(2.0, 2.0), "too_short"),  # noise may be larger than it seems
        (Left(35.0, 80.0), "too_short"),  # a part of the logs does not tell the rest
        (Left(1.2, 1.2, samples=0), "nothing_seen"),
        (Left(1.2, 1.2, torque=0.9), "nothing_seen"),  # noise is as large as the torque
        (replace(Left(1.2, 1.2), floor=NoiseFloor(*np.zeros((3, 1)))), "too_short"),
    ],
)
def test_nothing_is_missing_within_the_noise_alone(left: Left, verdict: str) -> None:
    states = joint_states(left, np.array([FLOOR]), left.floor.high)
    assert verdict_of([], [], states) == verdict


def test_what_a_fitted_model_leaves_as_well_is_unexplained() -> None:
    (state,) = joint_states(Left(35.0, 30.0), np.array([FLOOR]), np.array([HIGH]))
    part = UnexplainedPart(joint="elbow", depends_on=[], share=0.9)
    assert (state, verdict_of([], [part], [state])) == ("unexplained", "unexplained")


def test_a_joint_of_which_nothing_was_seen_does_not_pass_for_fine() -> None:
    assert verdict_of([], [], ["noise", "noise"]) == "nothing_missing"
    assert verdict_of([], [], ["noise", "unseen"]) == "nothing_seen"
    assert verdict_of([], [], ["changed", "unseen"]) == "values_changed"


def test_a_joint_whose_effect_has_no_sure_name_is_unexplained() -> None:
    """The model has the effect and leaves noise: that does not make the file right."""
    left = Left(35.0, 1.1)
    for nameless, expected in (((), "changed"), ((0,), "unexplained")):
        (state,) = joint_states(
            left, np.array([FLOOR]), np.array([HIGH]), nameless=nameless
        )
        assert state == expected
    quiet = joint_states(
        Left(1.2, 1.2), np.array([FLOOR]), np.array([HIGH]), nameless=(0,)
    )
    assert quiet == ["noise"]


def worn_since(first: int) -> list[Scene]:
    """Three logs; from one of them on the first joint rubs more."""
    return arm_scenes(
        at_joint(0, lambda scene: 2.0 * scene.sign[:, 0] * (scene.log >= first))
    )


@pytest.mark.parametrize(("first", "path"), [(0, None), (1, "1"), (2, "2")])
def test_the_first_log_in_which_values_do_not_hold_is_told(
    first: int, path: str | None
) -> None:
    ground = ground_of(worn_since(first))
    found = SimpleNamespace(
        file_residual=FileResidual.of(ground),
        floor=NoiseFloor(*(np.full(2, x) for x in (0.2, 0.1, 0.4))),
        ground=ground,
        logs=[SimpleNamespace(path=Path(str(number))) for number in range(3)],
    )
    assert _since(found, 0) == path


def test_the_file_is_judged_on_all_rows_that_count() -> None:
    scenes = worn_since(0)
    whole = FileResidual.of(ground_of(scenes))
    masks = [np.zeros_like(scene.slides) for scene in scenes]
    masks[0][:] = True
    rest = whole.without(masks)
    assert whole.rms[0] == pytest.approx(2.0, rel=0.2)
    assert rest.samples[0] < whole.samples[0]
    assert np.isnan(rest.rms_by_log[0]).all()
    np.testing.assert_array_equal(rest.rms_by_log[1:], whole.rms_by_log[1:])


LATE_S = 0.02


def late(scene: Scene) -> Array:
    """Torque (N, n) that is late by more than a sample, to first order."""
    motion = scene.motion
    return np.asarray(
        -LATE_S * differentiate(scene.modelled, motion.rate_hz, motion.valid)[0]
    )


def test_a_delay_that_the_file_knows_is_no_skew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenes = arm_scenes(late)
    keys = {
        taken.term.name for taken in selected(scenes, ["time_skew", "spring"]).terms
    }
    assert keys == {"time_skew"}

    def known(scenes: list[Scene], stages: Stages) -> list[Nuisance]:
        return [replace(one, mean=LATE_S) for one in nuisances_of(scenes, stages)]

    monkeypatch.setattr(base, "nuisances_of", known)
    assert selected(scenes, ["time_skew", "spring"]).terms == ()


def test_a_delay_in_the_model_is_taken_off_before_anything_is_looked_for() -> None:
    scenes = arm_scenes(late)
    delays = np.full(2, LATE_S)
    told = [replace(x, model=replace(x.model, delays_s=delays)) for x in scenes]
    assert selected(told, ["time_skew", "spring"]).terms == ()


def test_one_delay_may_be_that_of_all_joints(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = arm_scenes(late)

    def common(scenes: list[Scene], stages: Stages) -> list[Nuisance]:
        own = nuisances_of(scenes, stages)
        columns = {joint: one.columns[joint] for joint, one in enumerate(own)}
        return [Nuisance(name=DELAY, columns=columns, std=1.0)]

    monkeypatch.setattr(base, "nuisances_of", common)
    ground: SelectionProblem = ground_of(scenes)
    (rows,) = ground.base.nuisances
    assert rows.term.joint is None
    assert sorted(rows.columns) == [0, 1]
    assert selected(scenes, ["time_skew", "spring"]).terms == ()


ROWS = 100.0  # independent ones, all together


@pytest.fixture(scope="module")
def one_arm() -> SelectionProblem:
    return ground_of(arm_scenes(logs=2, seconds=8.0))


@pytest.mark.parametrize(
    ("gains", "named"),
    [
        # nats, of which 100 take two thirds of the squared error
        ({"position": 100.0, "time since the log's start": 99.0}, ("position",)),
        ({"position": 20.0, "time since the log's start": 19.0}, ("time",)),
        ({"position": 20.0, "time since the log's start": 2.0}, None),
        ({"position": 20.0}, None),
        ({}, None),
    ],
)
def test_what_is_left_depends_on_what_takes_a_good_part_of_it(
    one_arm: SelectionProblem, gains: dict[str, float], named: tuple[str, ...] | None
) -> None:
    terms = {term.name: term for term in one_arm.smooth_terms(0)}
    telling = telling_function([scored(terms[n], gain) for n, gain in gains.items()])
    assert (telling and telling.quantities) == named


def scored(term: Term, gain: float) -> ScoredTerm:
    """Return a term and what it gains; a function of time more in every other block."""
    uneven = np.resize([1.0, -1.0], BLOCKS) if term.name.startswith("time") else 0.0
    fit = TermFit(
        log_bayes_factor=gain,
        coefficients=np.zeros(1),
        covariance=np.eye(1),
        visible_share=1.0,
    )
    score = Score(
        part_gains=np.full(BLOCKS, gain / BLOCKS) + uneven,
        rows=np.full(BLOCKS, ROWS / BLOCKS),
    )
    return ScoredTerm(term=term, fit=fit, score=score)
