"""The sample logs of one robot, their truth,
and every stage identified from them once.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.imu_calibration import calibrate_imus
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, predict
from seqid_cli.identify.rigid.gravity import GravityResult, identify_gravity
from seqid_cli.identify.rigid.inertia import InertiaResult, identify_inertia
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import (
    FrictionStage,
    ImuStage,
    Parameter,
    RigidStage,
    Stages,
)
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array

SAMPLES = ROOT / "sample_logs"


def sample_robot(name: str) -> Robot:
    return load_robot(SAMPLES / name / "robot.toml")


@cache
def sample_rig(name: str) -> Rig:
    """A sample robot whose stages are identified once in a process."""
    return Rig(name)


@dataclass(frozen=True)
class Rig:
    """One robot of the sample logs; stages are identified when first asked for."""

    name: str
    read: dict[str, list[Recording]] = field(default_factory=dict, compare=False)

    @property
    def folder(self) -> Path:
        return SAMPLES / self.name

    @cached_property
    def robot(self) -> Robot:
        return sample_robot(self.name)

    @cached_property
    def truth(self) -> dict[str, Any]:
        return json.loads((self.folder / "truth.json").read_text())

    @cached_property
    def standard(self) -> dict[str, float]:
        """True standard parameters and rotor inertias by name."""
        return dict(self.truth["parameters"] | self.truth["rotor_inertia"])

    def logs(self, stage: str) -> list[Recording]:
        """The recordings of one stage, read once; none where it has no folder."""
        if stage not in self.read:
            paths = sorted((self.folder / stage).glob("*"))
            self.read[stage] = [read_recording(path, self.robot) for path in paths]
        return self.read[stage]

    @cached_property
    def friction(self) -> FrictionStage:
        return identify_friction(
            self.logs("friction"), self.robot, options=FrictionOptions()
        )

    @cached_property
    def gravity_result(self) -> GravityResult:
        """The gravity stage, and friction with what its trials show of the drives."""
        logs = self.logs("gravity") + self.logs("friction")
        return identify_gravity(logs, self.robot, Stages(friction=self.friction))

    @cached_property
    def gravity(self) -> RigidStage:
        return self.gravity_result.gravity

    @cached_property
    def imu(self) -> ImuStage:
        return calibrate_imus(self.logs("imu"), self.robot, options=MotionOptions())

    @cached_property
    def inertia(self) -> RigidStage:
        return self.inertia_of(self.logs("inertia"))

    @cached_property
    def known(self) -> Stages:
        """What the inertia stage starts from."""
        friction = self.gravity_result.friction
        return Stages(friction=friction, gravity=self.gravity, imu=self.imu)

    def inertia_of(self, logs: list[Recording], source: str = "auto") -> RigidStage:
        """The inertia stage from some of the logs, or with another source of motion."""
        return self.inertia_result(logs, source).inertia

    def inertia_result(
        self, logs: list[Recording], source: str = "auto"
    ) -> InertiaResult:
        """The inertia stage, and friction with what its logs show of the drives."""
        return identify_inertia(
            logs, self.robot, self.known, options=InertiaOptions(source=source)
        )

    @cached_property
    def stages(self) -> Stages:
        result = self.inertia_result(self.logs("inertia"))
        return replace(self.known, inertia=result.inertia, friction=result.friction)

    @cached_property
    def simultaneous(self) -> Stages:
        logs, options = self.logs("inertia"), MotionOptions()
        friction, inertia = identify_simultaneous(logs, self.robot, options=options)
        return Stages(friction=friction, inertia=inertia)

    def predictions(self, stages: Stages) -> list[LogPrediction]:
        return list(
            predict(
                self.logs("validation"), self.robot, stages, options=InertiaOptions()
            )
        )

    def true_value(self, parameter: Parameter) -> float:
        return sum(
            factor * self.standard[name] for name, factor in parameter.terms.items()
        )


def rmse(predictions: list[LogPrediction]) -> Array:
    """RMS torque error (n,) N m over the used samples of all logs."""
    errors = np.vstack([p.beyond[p.used] for p in predictions])
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))
