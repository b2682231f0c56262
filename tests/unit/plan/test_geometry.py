"""Collisions: found where shapes meet, with boxes around the arm, and kept out of a
plan.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.motion.planned import sampled
from seqid_cli.plan.functions import plan
from seqid_cli.plan.options import PlanOptions
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf_model import geometry_of
from tests.plants.robots.small import joint, link, urdf
from tests.plants.robots.stages import save_robot

LENGTH = 0.5
OPTIONS = PlanOptions(duration_s=16.0, move_s=4.0, pool=60, sweeps=1)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Three bars of half a metre in a plane; elbow and wrist fold onto the first."""
    folder = tmp_path_factory.mktemp("arm")
    parts = [link("base")]
    for k in range(3):
        box = (
            f'<origin xyz="{LENGTH / 2} 0 0"/><geometry><box size="{LENGTH} 0.06'
            ' 0.06"/></geometry>'
        )
        body = link(f"link_{k}", mass=2.0, x=0.25)
        parent, x = (f"link_{k - 1}", LENGTH) if k else ("base", 0.0)
        parts += [
            body.replace("</link>", f"<collision>{box}</collision></link>"),
            joint(f"j{k}", parent, f"link_{k}", xyz=f"{x} 0 0"),
        ]
    return save_robot(folder, urdf(*parts), ("j0", "j1", "j2"))


def tips(q: np.ndarray) -> np.ndarray:
    """Ends (N, 4, 2) of the bars in the plane, by hand."""
    angle = np.cumsum(q, axis=1)
    steps = LENGTH * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    return np.concatenate([np.zeros((len(q), 1, 2)), np.cumsum(steps, axis=1)], axis=1)


def test_folded_bars_collide_and_stretched_ones_do_not(arm: Robot) -> None:
    geometry = geometry_of(arm, np.zeros((1, 3)))
    assert len(geometry.shapes.collisionPairs) == 1  # the first bar with the third
    stretched = [0.0, 0.0, 0.0]
    folded = [0.7, -2.6, -2.6]
    crossed = [0.0, 2.6, 2.6]
    collides = geometry.collides(np.array([stretched, folded, crossed]))
    assert collides.tolist() == [False, True, True]


def test_boxes_and_the_workspace_count(arm: Robot) -> None:
    box = (0.9, -0.1, -0.1, 1.1, 0.1, 0.1)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3))
    ends = tips(q)
    inside = geometry_of(
        arm, np.zeros((1, 3)), workspace=(-0.8, -0.8, -1.0, 0.8, 0.8, 1.0)
    )
    with_box = geometry_of(arm, np.zeros((1, 3)), boxes=[box])
    out = np.abs(ends).max(axis=(1, 2)) > 0.8
    assert inside.collides(q)[out].all()
    near = np.abs(ends - np.array([1.0, 0.0])).max(axis=2).min(axis=1) < 0.1
    assert near.any()
    assert with_box.collides(q)[near].all()
    assert not with_box.collides(np.array([[1.5, 0.0, 0.0]]))[0]


@pytest.mark.parametrize("what", ["friction", "inertia", "validation", "gravity"])
def test_no_planned_move_collides(arm: Robot, what: str) -> None:
    box = (0.7, 0.3, -1.0, 1.5, 1.5, 1.0)
    planned = plan(what, arm, options=replace(OPTIONS, keep_out=(box,)))  # type: ignore[arg-type]
    geometry = geometry_of(arm, np.zeros((1, 3)), boxes=[box], clearance_m=0.0)
    for move in planned.moves:
        q = sampled(move, arm.joint_names, 200.0)[1]
        assert not geometry.collides(q).any()
    assert planned.moves or what == "gravity"  # gravity loads no joint of this arm
    assert any("ways between moves" in note for note in planned.notes)


def test_a_cell_without_room_and_an_arm_without_shapes_are_told(
    arm: Robot, tmp_path: Path
) -> None:
    full = (-2.0, -2.0, -1.0, 2.0, 2.0, 1.0)
    for what, text in (
        ("inertia", "keeps the arm off itself"),
        ("friction", "touches something"),
    ):
        with pytest.raises(ConfigError, match=text):
            plan(what, arm, options=replace(OPTIONS, keep_out=(full,)))  # type: ignore[arg-type]
    text = (arm.source.parent / "arm.urdf").read_text()
    text = text.replace("<collision>", "<!--").replace("</collision>", "-->")
    bare = save_robot(tmp_path, text, arm.joint_names)
    assert geometry_of(bare, np.zeros((1, 3))) is None
    with pytest.raises(ConfigError, match="need the shapes of the links"):
        plan("inertia", bare, options=replace(OPTIONS, workspace=full))
