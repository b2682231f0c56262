"""What whole logs say that are left out: of a term, of its rivals, and of a round."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seqid_cli.discover.refinement import across_logs as across
from seqid_cli.discover.refinement.across_logs import (
    AcrossLogs,
    NamesAcrossLogs,
    across_logs,
)
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import TermResult
from seqid_cli.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import Extra, arm_scenes, at_joint, drag, selected

SOME = ("quadratic_drag", "spring", "stribeck")
LOSS = 0.3  # N m of friction per N m of load


def named_logs(count: int) -> list[Any]:
    """Return stand-ins for the recordings of so many logs."""
    return [
        SimpleNamespace(path=Path(f"log_{number}"), source_log=None)
        for number in range(count)
    ]


def in_log(number: int, torque: Extra) -> Extra:
    """Return a torque that is there in one log alone."""

    def extra(scene: Scene) -> Array:
        return torque(scene) * (scene.log == number)

    return extra


def only_term(extra: Extra, logs: int, effects: tuple[str, ...] = SOME) -> TermResult:
    """Return the one term that blocks of time speak for."""
    scenes = arm_scenes(extra, logs=logs, seconds=12.0)
    (result,) = selected(scenes, effects).terms
    return result


def test_what_one_log_has_is_disproved_by_the_others() -> None:
    """Its own blocks predict one another, and no other log knows of it."""
    result = only_term(in_log(1, at_joint(0, drag)), logs=4)
    assert result.scored.score.doubt < Options.alpha

    judged = across_logs(result, named_logs(4), Options()).across
    assert judged.is_enough
    assert not judged.is_proven(Options().improvement)
    assert judged.gain.value < 0.04
    assert judged.worst != "log_1"
    assert judged.of_each[judged.worst] < -0.2


def test_what_all_logs_have_is_proven() -> None:
    result = only_term(at_joint(0, drag), logs=3)
    judged = across_logs(result, named_logs(3), Options()).across
    assert judged.is_proven(Options().improvement)
    assert judged.names == ("log_0", "log_1", "log_2")
    assert judged.gain.low > 0.5


def test_two_logs_prove_nothing() -> None:
    result = only_term(at_joint(0, drag), logs=2)
    judged = across_logs(result, named_logs(2), Options()).across
    assert not judged.is_enough
    assert not judged.is_proven(Options().improvement)
    assert not judged.is_disproved(Options().improvement)


@pytest.mark.parametrize(
    ("after", "disproved"), [((1.2, 0.8), True), ((0.7, 0.9), False)]
)
def test_two_logs_may_still_disprove(
    after: tuple[float, float], *, disproved: bool
) -> None:
    logs = AcrossLogs(
        names=("a", "b"),
        before=np.ones(2),
        after=np.array(after),
        predicted=np.full(2, 0.3),
    )
    assert logs.is_disproved(0.04) is disproved


def load_loss(scene: Scene) -> Array:
    return LOSS * np.abs(scene.load[:, 0]) * scene.sign[:, 0]


def test_whole_logs_choose_among_rivals() -> None:
    """Waves over the position follow the load on the blocks of a log."""
    names = ("load_dependent_friction", "position_dependent_friction")
    load = only_term(at_joint(0, load_loss), logs=3, effects=names)
    waves = next(rival for rival in load.rivals if rival.term.name == names[1])
    as_waves = across._in_place(load, waves)
    assert as_waves.term.name == names[1]
    # As if they had done better than they do on blocks.
    chosen = across_logs(as_waves, named_logs(3), Options())
    assert chosen.term.name == names[0]
    assert chosen.term in chosen.model.terms
    assert chosen.across.is_proven(Options().improvement)


def test_places_that_no_other_log_reaches_do_not_count() -> None:
    log = np.repeat([0, 1, 2], 4)
    q = np.array([0.0, 1.0, 2.0, 9.0, 0.1, 0.2, 1.9, 2.1, -3.0, 0.5, 0.6, 0.7])
    motions = [SimpleNamespace(q=q[log == k][:, None]) for k in range(3)]
    rows: Any = SimpleNamespace(
        scenes=[SimpleNamespace(motion=motion) for motion in motions],
        of=lambda _, values: np.concatenate(values),
    )
    covered = across._is_covered(rows, 0, log)
    assert q[~covered].tolist() == [9.0, -3.0]


@pytest.mark.parametrize(
    ("after", "predicted", "proven"),
    [
        ((0.5, 0.6, 0.7), (0.5, 0.5, 0.5), True),
        ((0.97, 0.98, 0.97), (0.5, 0.5, 0.5), False),  # too little
        ((0.1, 1.01, 1.02), (0.9, 0.1, 0.1), False),  # one log alone
        ((0.1, 0.999, 1.001), (0.9, 0.02, 0.02), True),  # two logs do not show it
        ((0.6, 0.8, 1.1), (0.5, 0.5, 0.5), False),  # one log against it
    ],
)
def test_gain_interval_and_each_log_must_speak_for_it(
    after: tuple[float, ...], predicted: tuple[float, ...], *, proven: bool
) -> None:
    logs = AcrossLogs(
        names=("a", "b", "c"),
        before=np.ones(3),
        after=np.array(after),
        predicted=np.array(predicted),
    )
    assert logs.is_proven(0.04) is proven


@pytest.mark.parametrize("logs", [1, 3])
def test_after_a_refusal_the_next_name_is_asked(logs: int) -> None:
    """A drag is a power of the speed as well, and is no spring."""
    effects = ("nonlinear_viscous", "quadratic_drag", "spring")
    result = only_term(at_joint(0, drag), logs=logs, effects=effects)
    names = NamesAcrossLogs(result, named_logs(logs), Options())
    refused: set[str] = set()
    found = []
    while True:
        likeliest = names.likeliest(lambda effect: effect.effect.name in refused)
        if likeliest is None:
            break
        found.append(likeliest.term.name)
        refused.add(likeliest.term.name)
        assert likeliest.term in likeliest.model.terms
    assert found[0] == result.term.name
    assert set(found) == {"nonlinear_viscous", "quadratic_drag"}


def test_what_another_log_gains_is_less_sure_than_what_these_gain() -> None:
    """Student's t with one degree of freedom less than logs, and one log more."""

    def promised(*after: float) -> AcrossLogs:
        count = len(after)
        return AcrossLogs(
            names=tuple(map(str, range(count))),
            before=np.ones(count),
            after=np.array(after),
            predicted=np.full(count, 0.3),
        )

    alike = promised(0.5, 0.52, 0.48, 0.5)
    assert alike.of_another_log.value == pytest.approx(0.5)
    assert alike.of_another_log.low < alike.gain.low
    assert alike.is_promised

    unlike = promised(0.6, 0.65, 0.96)
    assert unlike.is_proven(0.04)
    assert not unlike.is_promised

    alone = promised(0.1)
    assert alone.of_another_log.limits == []
    assert not alone.is_promised


def test_the_gain_of_another_log_is_within_its_interval() -> None:
    """Of logs that differ at random, whatever their number."""
    rng = np.random.default_rng(11)
    for count in (2, 3, 6):
        draws = 1500
        within = 0
        for _ in range(draws):
            before = rng.uniform(0.8, 1.2, count + 1)
            after = before * rng.normal(0.6, 0.15, count + 1)
            logs = AcrossLogs(
                names=tuple(map(str, range(count))),
                before=before[:-1],
                after=after[:-1],
                predicted=before[:-1],
            )
            expected = logs.of_another_log
            gain = 1.0 - after[-1] / before[-1]
            within += expected.low <= gain <= expected.high
        assert 0.93 <= within / draws <= 0.985


def test_what_a_smooth_function_follows_is_tried_by_the_name_of_an_effect() -> None:
    """A drag with a hump that no law has: a smooth function follows both."""

    def drag_with_hump(scene: Scene) -> Array:
        v = np.abs(scene.motion.dq[:, 0])
        hump = 0.25 * np.exp(-(((v - 0.4) / 0.12) ** 2))
        return drag(scene) / 3.0 + hump * scene.sign[:, 0]

    result = only_term(at_joint(0, drag_with_hump), logs=3, effects=SOME)
    assert result.term.smooth
    assert across_logs(result, named_logs(3), Options()).term.smooth

    names = NamesAcrossLogs(result, named_logs(3), Options())
    likeliest = names.likeliest()
    assert likeliest is not None
    assert likeliest.term.name == "quadratic_drag"
    assert likeliest.instead_of is result.term
    assert likeliest.across.is_proven(Options().improvement)
    assert names.likeliest(lambda _: True) is None
