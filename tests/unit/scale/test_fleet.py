"""Robots that drift are told from the others, and a healthy fleet is left in peace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from seqid_cli.errors import UsageError
from seqid_cli.params.schema import Parameter, ParameterFile
from tests.studies.fleet import study as fleet
from tests.studies.fleet.comparison import judge_fleet
from tests.unit.params.documents import full_file

FILE = full_file()
SPREAD, ERROR = 0.03, 0.01  # of parameters of size 1


def result(values: np.ndarray, error: float = ERROR) -> ParameterFile:
    """Return a robot's file with parameters k1, k2, ... in its inertia stage and nothing else."""
    file = FILE
    stage = file.stages.inertia
    assert stage is not None
    parameters = [
        Parameter(name=f"k{i}", value=float(x), std_error=error, unit="kg m^2")
        for i, x in enumerate(values)
    ]
    stages = type(file.stages)(inertia=replace(stage, parameters=parameters))
    return replace(file, stages=stages)


def robots(count: int, rng: np.random.Generator, parameters: int = 8) -> dict[str, ParameterFile]:
    scatter = np.hypot(SPREAD, ERROR)
    values = 1.0 + scatter * rng.normal(size=(count, parameters))
    return {f"r{k}": result(row) for k, row in enumerate(values)}


@pytest.mark.parametrize("count", [5, 8, 20, 40])
def test_healthy_fleets_raise_the_promised_false_alarms_at_most(count: int) -> None:
    rng, fleets, alpha = np.random.default_rng(count), 100, 0.05
    alarms = sum(bool(judge_fleet(robots(count, rng), alpha=alpha).drifting) for _ in range(fleets))
    assert alarms <= fleets * alpha + 3 * np.sqrt(fleets * alpha * (1 - alpha))


def test_a_drift_is_found_in_spite_of_others_and_the_worst_comes_first() -> None:
    found = robots(30, np.random.default_rng(1))
    for name, far in (("r7", 0.35), ("r11", -0.5), ("r12", 0.3)):
        values = np.array([p.value for p in found[name].stages.inertia.parameters])  # type: ignore[union-attr]
        values[3] += far
        found[name] = result(values)
    judged = judge_fleet(found)
    assert set(judged.drifting) == {"r7", "r11", "r12"}
    worst = judged.deviations[0]
    assert (worst.robot, worst.quantity.name, worst.z < 0) == ("r11", "k3", True)
    assert worst.fleet == pytest.approx(1.0, abs=0.03)
    assert 0.5 * SPREAD < worst.spread < 2 * SPREAD
    assert len(judged.deviations) == 30


def test_standard_errors_count_beside_the_spread() -> None:
    """A robot known badly is not accused of what one known well would be."""
    rng = np.random.default_rng(2)
    found = robots(30, rng)
    far = np.full(8, 1.0)
    far[0] = 1.4
    assert judge_fleet(found | {"odd": result(far)}).drifting == ("odd",)
    assert not judge_fleet(found | {"odd": result(far, error=0.2)}).drifting


def test_differences_of_no_use_are_no_drift() -> None:
    found = {f"r{k}": result(np.array([1.0, 2.0]), error=1e-9) for k in range(10)}
    found["r3"] = result(np.array([1.005, 2.0]), error=1e-9)
    judged = judge_fleet(found)
    assert not judged.drifting
    assert abs(judged.deviations[0].z) > judged.limit
    found["r3"] = result(np.array([1.05, 2.0]), error=1e-9)
    assert judge_fleet(found).drifting == ("r3",)


def test_what_cannot_be_compared_is_said() -> None:
    rng = np.random.default_rng(3)
    found = robots(6, rng)
    with pytest.raises(UsageError, match="3 robots are no fleet"):
        judge_fleet(dict(list(found.items())[:3]))
    with pytest.raises(UsageError, match="probability"):
        judge_fleet(found, alpha=0.0)
    other = replace(found["r1"], robot=replace(found["r1"].robot, joints=["slide"]))
    with pytest.raises(UsageError, match="has the joints slide") as caught:
        judge_fleet(found | {"r1": other})
    assert caught.value.where == "r1"
    short = result(np.ones(7))
    judged = judge_fleet(found | {"r1": short})
    assert len(judged.quantities) == 7
    assert judged.notes == ("inertia k7 is not compared, it is not known of r1",)
    empty = replace(found["r1"], stages=type(short.stages)())
    with pytest.raises(UsageError, match="share no parameter"):
        judge_fleet(found | {"r1": empty})


def test_a_recorded_fleet_gives_away_its_worn_bearing(tmp_path: Path) -> None:
    members = fleet.fleet(6, 1)
    (worn,) = [member.name for member in members if member.fault]
    seconds = fleet.identified(tmp_path, members, jobs=2)
    assert set(seconds) == {member.name for member in members}
    judged = judge_fleet(fleet.results(tmp_path), alpha=0.05)
    assert judged.drifting == (worn,)
    first = judged.deviations[0]
    assert (first.quantity.stage, first.quantity.joint) == ("friction", "joint_1")
    text = fleet.table(judged, {worn: "bearing"}, most=3)
    assert text.splitlines()[1].split()[0] == worn
    assert "drifts" in text
