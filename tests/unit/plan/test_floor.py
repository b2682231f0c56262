"""The floor: found where points are low, kept by every kind of plan, left out when
asked.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.motion.planned import sampled
from seqid_cli.params.results.plan import PlannedMove
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import belief_of
from seqid_cli.plan.functions import plan
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.moves.floor import Floor, floor_of
from seqid_cli.plan.moves.strokes import postures_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.settings import MarginSettings, PlanSettings
from seqid_cli.plan.ways import note_on_ways
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf_model import geometry_of
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.small import joint, link, urdf
from tests.plants.robots.stages import friction_stage, inertia_stage, save_robot

OPTIONS = PlanOptions(duration_s=16.0, move_s=4.0, pool=40, sweeps=1)
RADIUS = 0.05


@pytest.fixture(scope="module")
def pole(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Two bars of 0.4 m that swing in a plane, half a metre above the base; balls at
    their ends.
    """
    sphere = '<geometry><sphere radius="0.05"/></geometry>'
    ball = f'<collision><origin xyz="0.4 0 0"/>{sphere}</collision>'
    parts = [link("base")]
    for k in range(2):
        body = link(f"link_{k}", mass=2.0, x=0.2)
        parent, place = (f"link_{k - 1}", "0.4 0 0") if k else ("base", "0 0 0.5")
        parts += [
            body.replace("</link>", f"{ball}</link>"),
            joint(f"j{k}", parent, f"link_{k}", xyz=place, axis="0 -1 0"),
        ]
    return save_robot(tmp_path_factory.mktemp("pole"), urdf(*parts), ("j0", "j1"))


def floor_for(robot: Robot) -> Floor:
    limits = limits_of(robot, ramp_s=0.5)
    postures = postures_of(limits, 300, np.random.default_rng(0))
    floor = floor_of(robot, limits, postures, geometry_of(robot, postures))
    assert floor is not None
    return floor


def lowest_by_hand(q: np.ndarray) -> np.ndarray:
    """Height (N,) m of the lowest ball's lowest point."""
    first = 0.5 + 0.4 * np.sin(q[:, 0])
    second = first + 0.4 * np.sin(q[:, 0] + q[:, 1])
    return np.asarray(np.minimum(first, second) - RADIUS)


def test_heights_are_those_of_the_lowest_ball(pole: Robot) -> None:
    floor = floor_for(pole)
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))
    assert floor.height(q) == pytest.approx(
        lowest_by_hand(q) - floor.clearance_m, abs=1e-9
    )
    places = np.tile(np.linspace(-2.0, 2.0, 7), (200, 1))
    for j in (0, 1):
        along = floor.height_along(np.full(200, j), q, places)
        for k in range(7):
            moved = q.copy()
            moved[:, j] = places[:, k]
            assert along[:, k] == pytest.approx(floor.height(moved), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["friction", "gravity", "inertia", "validation"])
def test_no_planned_move_goes_below_the_base(pole: Robot, what: str) -> None:
    planned = plan(what, pole, options=OPTIONS)  # type: ignore[arg-type]
    assert planned.moves
    for move in planned.moves:
        assert lowest_by_hand(sampled(move, pole.joint_names, 200.0)[1]).min() > 0.0
    assert any("base plane" in note and "--no-floor" in note for note in planned.notes)


def test_ways_between_moves_that_are_not_free_are_told(pole: Robot) -> None:
    """From one side to the other a straight way leads through the floor."""
    names = pole.joint_names

    def held(name: str, q: tuple[float, float]) -> PlannedMove:
        start = dict(zip(names, q, strict=True))
        return PlannedMove(
            name=name, stage="inertia", joints=[], duration_s=1.0, start=start
        )

    belief = belief_of(
        pole, Stages(), limits_of(pole, ramp_s=0.5), floor=floor_for(pole)
    )
    aside = held("aside", (0.0, 0.0))
    up = held("up", (1.5, 0.0))
    note = note_on_ways(belief, [aside, up])
    assert "are free" in note

    leaning = held("leaning", (1.8, 0.2))
    folded = held("folded", (-2.4, -1.9))
    ends = np.array([list(move.start.values()) for move in (leaning, folded)])
    assert not floor_for(pole).below(ends).any()
    note = note_on_ways(belief, [aside, leaning, folded])
    assert "1 of 2 are not free" in note
    assert "those to folded" in note

    # The posture that it names leads round.
    angles = re.search(r"by way of j0 (\S+), j1 (\S+) rad all of them are", note)
    assert angles is not None
    posture = np.array([float(angle) for angle in angles.groups()])
    for end in ends:
        assert lowest_by_hand(np.linspace(end, posture, 500)).min() > 0.0


def test_the_height_that_is_kept_is_a_setting(pole: Robot) -> None:
    settings = PlanSettings(margins=MarginSettings(floor_clearance=0.2))
    planned = plan("friction", pole, options=OPTIONS, settings=settings)
    for move in planned.moves:
        q = sampled(move, pole.joint_names, 200.0)[1]
        assert lowest_by_hand(q).min() > 0.19  # a millimetre or two between samples
    assert any("20 cm above the base plane" in note for note in planned.notes)
    assert planned.settings is not None
    assert planned.settings.changed == {"margins.floor_clearance": 0.2}
    assert planned.settings.values["margins.torque_sigma"] == 3.0


@pytest.mark.parametrize("what", ["friction", "gravity"])
def test_without_a_floor_sweeps_take_the_whole_range(pole: Robot, what: str) -> None:
    free = plan(what, pole, options=replace(OPTIONS, floor=False))  # type: ignore[arg-type]
    lows = [
        lowest_by_hand(sampled(x, pole.joint_names, 200.0)[1]).min() for x in free.moves
    ]
    assert min(lows) < 0.0
    assert any(note.startswith("floor: none") for note in free.notes)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["imu-calib", "payload", "discriminate", "all"])
def test_frames_stay_above_without_shapes(what: str) -> None:
    robot = sample_robot("six_joint")
    assert robot.nominal is not None
    stages = Stages(
        friction=friction_stage(robot), inertia=inertia_stage(robot, robot.nominal)
    )
    pair = ("stribeck", "quadratic_drag") if what == "discriminate" else ()
    options = replace(OPTIONS, between=pair, joint="elbow" if pair else None)
    limits = limits_of(robot, ramp_s=options.ramp_s)
    floor = floor_of(robot, limits, postures_of(limits, 500, np.random.default_rng(0)))
    planned = make_plan(what, robot, limits, stages, options, floor=floor)
    assert planned.moves
    for move in planned.moves:
        q = sampled(move, robot.joint_names, 100.0)[1]
        assert forward(robot.chain, q).p[..., 2].min() > 0.0, move.name


def test_an_arm_that_hangs_is_told_of_no_floor(pole: Robot, tmp_path: Path) -> None:
    hanging = replace(pole, gravity=-pole.gravity)
    limits = limits_of(hanging, ramp_s=0.5)
    narrow = replace(limits, lower=np.array([-0.3, -0.3]), upper=np.array([0.3, 0.3]))
    postures = postures_of(narrow, 100, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="below the base plane") as caught:
        floor_of(hanging, narrow, postures, geometry_of(hanging, postures))
    assert "--no-floor" in caught.value.hint
    weightless = replace(pole, gravity=np.zeros(3))
    assert floor_of(weightless, limits, postures) is None
