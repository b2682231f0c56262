"""Drawn arms as robot files, for plans."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.plants.drawn import drawn_arm
from tests.plants.robotfile import robot_toml, urdf_text

SAMPLES = ROOT / "sample_logs"


@cache
def drawn_robot(folder: Path, seed: int) -> Robot:
    """Robot file and URDF of a drawn arm."""
    plant = drawn_arm(seed)
    (folder / f"arm_{seed}.urdf").write_text(urdf_text("arm", plant), encoding="ascii")
    path = folder / f"robot_{seed}.toml"
    path.write_text(robot_toml("arm", plant, urdf=f"arm_{seed}.urdf"), encoding="ascii")
    return load_robot(path)


def sample_robot(name: str) -> Robot:
    """One of the sample robots."""
    return load_robot(SAMPLES / name / "robot.toml")
