"""Parameter files of a two-joint robot, for tests."""

from __future__ import annotations

import msgspec

from seqid_cli.params.document import with_stage
from seqid_cli.params.schema import (
    EffectOfJoint,
    FrictionJoint,
    FrictionStage,
    ImuCalibration,
    ImuStage,
    InputLog,
    Parameter,
    ParameterFile,
    RigidStage,
    RobotId,
    Verdict,
)

JOINTS = ["shoulder", "elbow"]


def robot() -> RobotId:
    return RobotId(name="arm", joints=list(JOINTS), sha256="0" * 64)


def friction_joint() -> FrictionJoint:
    return FrictionJoint(
        position_order=1,
        velocity_order=0,
        max_error=0.25,
        rmse=0.1,
        position_range=[-2.0, 2.0],
        speed_range=[0.1, 1.5],
        sign_width=0.01,
        directional=False,
        positive=[[1.0], [1.0 / 3.0]],
        negative=[[1.0], [1.0 / 3.0]],
        covariance=[[0.01, 0.0], [0.0, 0.02]],
    )


def friction_stage(*, good: bool = True) -> FrictionStage:
    verdicts = [Verdict(joint=name, good=True) for name in JOINTS]
    if not good:
        verdicts[1] = Verdict(joint="elbow", good=False, reason="only 1 speed, 3 are needed")
    joints = {name: friction_joint() for name in JOINTS}
    return FrictionStage(joints=joints, verdicts=verdicts, notes=["a remark"])


def rigid_stage(unit: str = "kg m") -> RigidStage:
    parameter = Parameter(name="mx_1", value=1.25, std_error=0.01, unit=unit, joint="shoulder")
    return RigidStage(
        parameters=[parameter],
        condition=12.5,
        rank=1,
        covariance=[[1e-4]],
        rmse=dict.fromkeys(JOINTS, 0.2),
        verdicts=[Verdict(joint=name, good=True) for name in JOINTS],
    )


def imu_stage() -> ImuStage:
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    calibration = ImuCalibration(rotation=turn, std_error_deg=0.3, configurations=4)
    return ImuStage(imus={"imu_a": calibration}, verdicts=[Verdict(joint="imu_a", good=True)])


def log(name: str, stage: str) -> InputLog:
    return InputLog(path=name, sha256=name.ljust(64, "f"), samples=1000, stage=stage)


def friction_file() -> ParameterFile:
    return with_stage(None, robot(), [log("a", "friction")], friction=friction_stage())


def gravity_file() -> ParameterFile:
    logs = [log("b", "gravity")]
    return with_stage(friction_file(), robot(), logs, gravity=rigid_stage())


def imu_file() -> ParameterFile:
    return with_stage(friction_file(), robot(), [log("c", "imu")], imu=imu_stage())


def full_file() -> ParameterFile:
    file = with_stage(gravity_file(), robot(), [log("c", "imu")], imu=imu_stage())
    file = with_stage(file, robot(), [log("d", "inertia")], inertia=rigid_stage("kg m^2"))
    effect = EffectOfJoint(effect="stribeck", joint="elbow", settings={"iterations": 3})
    file = with_stage(file, robot(), [log("e", "effects")], effects=[effect])
    file.closed_loop = {"rounds": msgspec.Raw(b'[{"effect": "stribeck", "joint": "elbow"}]')}
    return file
