"""Effects that have become idle are taken back; those that the held-out logs miss stay."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.loop import Loop
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refine import _had
from seqid_cli.discover.reidentify import Key, Material, Refitted, refitted
from seqid_cli.discover.results import Round
from seqid_cli.discover.withdraw import IDLE, withdraw_idle
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import ParameterFile
from tests.discover.test_refine import changed, first_logs, identified, robot

SPRING: Key = ("spring", 0)
DRAG: Key = ("quadratic_drag", 0)
SETTINGS = {SPRING: {"cubic": 0.0}, DRAG: {}}


@pytest.fixture(scope="module")
def before() -> ParameterFile:
    return identified(first_logs())


def looped(file: ParameterFile, *keys: Key) -> Loop:
    """A refinement that has added effects to the arm with a spring, whatever they do."""
    material = Material(tuple(changed("fourier", "trapezoids")), {}, robot(), DiscoverOptions())
    bare = Refitted(file.stages, ())
    candidates = [Candidate(CATALOGUE[name], j, SETTINGS[name, j]) for name, j in keys]
    model = refitted(material, bare, candidates, late=frozenset(keys), kept=True)
    rounds = [Round(name, "joint_1", True, 0.5, 0.5, (0.4, 0.6)) for name, _ in keys]
    held_out, rng = tuple(changed("held_out")), np.random.default_rng(0)
    loop = Loop(material, held_out, bare, None, rounds, {}, rng)  # type: ignore[arg-type]
    loop.model, loop.error = model, loop.judged(model)
    return loop


def test_what_the_held_out_logs_miss_stays(before: ParameterFile) -> None:
    loop = looped(before, SPRING)
    # Held against itself nothing is certainly better, so that it is tried without the spring.
    withdraw_idle(loop, loop.error)
    assert [r.accepted for r in loop.rounds] == [True]
    assert len(loop.model.effects) == 1


def test_what_they_do_not_miss_is_taken_back_and_said_to_be(before: ParameterFile) -> None:
    loop = looped(before, SPRING, DRAG)
    withdraw_idle(loop, loop.error)
    assert [(r.effect, r.accepted, r.reason) for r in loop.rounds] == [
        ("spring", True, ""),
        ("quadratic_drag", False, IDLE),
    ]
    assert [f.effect.name for f in loop.model.effects if hasattr(f, "effect")] == ["spring"]
    assert loop.model.late == {SPRING}


def test_where_all_is_better_nothing_is_tried(before: ParameterFile) -> None:
    loop = looped(before, SPRING, DRAG)
    bare = loop.judged(Refitted(before.stages, ()))
    withdraw_idle(loop, bare)
    assert all(r.accepted for r in loop.rounds)


def test_an_effect_that_the_model_has_is_not_added_once_more(before: ParameterFile) -> None:
    loop = looped(before, SPRING)
    spring, drag = CATALOGUE["spring"], CATALOGUE["quadratic_drag"]
    assert _had(loop, Candidate(spring, 0, {"cubic": 0.0}))
    assert not _had(loop, Candidate(spring, 0, {"cubic": 1.0}))
    assert not _had(loop, Candidate(drag, 0, {}))
