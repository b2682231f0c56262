"""Lines in time: what stands far out of its surroundings is told, however small."""

from types import SimpleNamespace

import numpy as np
import pytest

from seqid_cli.discover.lines import clear_lines
from seqid_cli.discover.select.selection import select
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.params.results.diagnosis import FindingEntry
from tests import Array
from tests.unit.discover.arms import (
    Extra,
    arm_scenes,
    at_joint,
    ground_of,
    selected,
    stribeck,
)


def line(hertz: float, amplitude: float, *offsets_hz: float) -> Extra:
    """A line at the second joint, off by some hertz in each log."""

    def torque(scene: Scene) -> Array:
        of_log = hertz + (offsets_hz[scene.log] if offsets_hz else 0.0)
        return np.asarray(amplitude * np.sin(2 * np.pi * of_log * scene.time))

    return at_joint(1, torque)


def told(scenes: list[Scene]) -> tuple[set[str], list[FindingEntry]]:
    """What the selection tells, and the lines beside that."""
    names = ("stribeck", "periodic_disturbance", "torque_ripple")
    result = select(ground_of(scenes), [CATALOGUE[name] for name in names]).told()
    found = SimpleNamespace(
        ground=result.model.ground, model=result.model, selection=result
    )
    lines = clear_lines(found, scenes[0].robot)
    return {each.term.name for each in result.terms}, lines


@pytest.mark.slow
@pytest.mark.parametrize("hertz", [14.6, 80.0])
def test_a_line_that_takes_little_of_all_that_is_left_is_told(hertz: float) -> None:
    names, lines = told(arm_scenes(line(hertz, 0.1)))
    assert names == set()
    (found,) = lines
    assert (found.effect, found.joint) == ("periodic_disturbance", "joint_2")
    assert found.confidence > 0.97
    assert found.settings["frequency"] == pytest.approx(hertz, rel=1e-4)
    size = next(value for value in found.parameters if value.name == "amplitude")
    assert size.value == pytest.approx(0.1, rel=0.1)
    assert found.log_gain > 200.0


@pytest.mark.slow
def test_nothing_but_a_line_is_one() -> None:
    for extra in (None, stribeck(0.3), line(80.0, 0.02)):
        assert told(arm_scenes(extra))[1] == []


def test_a_line_is_found_where_the_motion_has_much_torque_but_no_line() -> None:
    (found,) = selected(arm_scenes(line(2.3, 0.1)), ["periodic_disturbance"]).terms
    assert found.term.what.settings["frequency"] == pytest.approx(2.3, rel=1e-3)


def test_a_line_that_wanders_from_log_to_log_has_a_phase_in_each() -> None:
    """The mains are no clock: logs that share one need not share the line's phase."""
    scenes = arm_scenes(line(14.6, 0.3, -0.02, 0.0, 0.02))
    (found,) = selected(scenes, ["periodic_disturbance"]).terms
    assert found.term.what.settings["frequency"] == pytest.approx(14.6, rel=3e-3)
