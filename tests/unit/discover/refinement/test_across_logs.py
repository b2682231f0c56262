"""What whole logs say that are left out: of a term, of its rivals, and of a round."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seqid_cli.discover.refinement import across_logs as across
from seqid_cli.discover.refinement.across_logs import AcrossLogs, across_logs
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
