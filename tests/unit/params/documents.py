"""Parameter files of a two-joint robot, for tests."""

from seqid_cli.params import schema as p
from seqid_cli.params.dates import now
from seqid_cli.params.document import head, with_stage
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.results import diagnosis as d
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import (
    EffectOfJoint,
    InputLog,
    ParameterFile,
    RefinementRound,
    RobotId,
    Verdict,
)
from tests.plants.robots.made import friction_joint

JOINTS = ["shoulder", "elbow"]
STRIBECK = {"stribeck_speed": 0.1, "exponent": 2.0}


def robot() -> RobotId:
    return RobotId(name="arm", joints=list(JOINTS), sha256="0" * 64)


def friction_stage(*, good: bool = True) -> p.FrictionStage:
    verdicts = [Verdict(joint=name, good=True) for name in JOINTS]
    if not good:
        verdicts[1] = Verdict(
            joint="elbow", good=False, reason="only 1 speed, 3 are needed"
        )
    ranges = {
        "position_range": [-2.0, 2.0],
        "speed_range": [0.1, 1.5],
        "sign_width": 0.01,
    }
    numbers = {"max_error": 0.25, "rmse": 0.1, "covariance": [[0.01, 0.0], [0.0, 0.02]]}
    surface = [[1.0], [1.0 / 3.0]]
    joints = {name: friction_joint(surface, **ranges, **numbers) for name in JOINTS}
    return p.FrictionStage(joints=joints, verdicts=verdicts, notes=["a remark"])


def rigid_stage(unit: str = "kg m") -> p.RigidStage:
    parameter = p.Parameter(
        name="mx_1", value=1.25, std_error=0.01, unit=unit, joint="shoulder"
    )
    verdicts = [Verdict(joint=name, good=True) for name in JOINTS]
    numbers = {"condition": 12.5, "rank": 1, "covariance": [[1e-4]]}
    rmse = dict.fromkeys(JOINTS, 0.2)
    return p.RigidStage(parameters=[parameter], rmse=rmse, verdicts=verdicts, **numbers)


def imu_stage() -> p.ImuStage:
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    calibration = p.ImuCalibration(rotation=turn, std_error_deg=0.3, configurations=4)
    return p.ImuStage(
        imus={"imu_a": calibration}, verdicts=[Verdict(joint="imu_a", good=True)]
    )


def log(name: str, stage: str) -> InputLog:
    return InputLog(path=name, sha256=name.ljust(64, "f"), samples=1000, stage=stage)


def friction_file() -> ParameterFile:
    return with_stage(None, robot(), [log("a", "friction")], friction=friction_stage())


def gravity_file() -> ParameterFile:
    return with_stage(
        friction_file(), robot(), [log("b", "gravity")], gravity=rigid_stage()
    )


def imu_file() -> ParameterFile:
    return with_stage(friction_file(), robot(), [log("c", "imu")], imu=imu_stage())


def inertia_file() -> ParameterFile:
    file = with_stage(gravity_file(), robot(), [log("c", "imu")], imu=imu_stage())
    return with_stage(
        file, robot(), [log("d", "inertia")], inertia=rigid_stage("kg m^2")
    )


def full_file() -> ParameterFile:
    effect = {"effect": "stribeck", "joint": "elbow", "settings": dict(STRIBECK)}
    effects = [EffectOfJoint(**effect, coefficients=[0.5])]
    file = with_stage(inertia_file(), robot(), [log("e", "effects")], effects=effects)
    file.closed_loop = closed_loop()
    return file


def closed_loop() -> p.ClosedLoop:
    gains = {
        "training_gain": 0.62,
        "training_interval": [0.55, 0.64],
        "held_out_gain": 0.6,
    }
    accepted = RefinementRound(
        effect="stribeck",
        joint="elbow",
        confirmed=True,
        interval=[0.5, 0.63],
        evidence=evidence("elbow", "speed", "rad/s", sided=True),
        rivals=[rival("spring", 9.0, "explains 97.0 % less")],
        **gains,
    )
    gains = {"training_gain": 0.01, "held_out_gain": -0.02, "interval": [-0.04, 0.0]}
    reason = "no gain on the held-out logs"
    refused = {
        "effect": "spring",
        "joint": "shoulder",
        "accepted": False,
        "reason": reason,
    }
    return p.ClosedLoop(
        rounds=[accepted],
        refused=[RefinementRound(**refused, **gains)],
        before={"elbow": p.JointRmse(rmse=0.2, rmse_outside=0.4, share_outside=0.1)},
        after={"elbow": p.JointRmse(rmse=0.1, rmse_outside=0.2, share_outside=0.1)},
        noise_floor={"elbow": 0.09},
        noise_floor_interval={"elbow": [0.08, 0.11]},
        gain_interval={"elbow": [0.7, 0.8]},
        evaluated_on=["v"],
        held_out=[log("v", "")],
        notes=["a remark"],
    )


def rival(
    effect: str, gain: float, why_not: str, joint: str | None = "elbow"
) -> RivalEntry:
    return RivalEntry(effect=effect, joint=joint, log_gain=gain, why_not=why_not)


def evidence(
    joint: str, quantity: str, unit: str, *, sided: bool = False
) -> EvidenceEntry:
    before = {"before": [0.5, -0.5, 0.5], "before_spread": [0.1, 0.2, 0.1]}
    after = {"after": [0.01, -0.02, 0.03], "after_spread": [0.09, 0.08, 0.07]}
    shown = {
        "joint": joint,
        "quantity": quantity,
        "of": joint,
        "unit": unit,
        "sided": sided,
    }
    return EvidenceEntry(
        **shown, x=[-1.0, 0.0, 1.0], count=[50, 51, 50], **before, **after
    )


def diagnosis_file() -> d.DiagnosisFile:
    told = "these logs cannot tell the two apart: it reaches 96.7 % of the gain"
    torque = d.EffectParameter(
        name="stribeck_torque", value=1.5, std_error=0.05, unit="N m"
    )
    finding = d.FindingEntry(
        effect="stribeck",
        joint="elbow",
        confidence=0.97,
        explains=0.81,
        confusable_with=["presliding_hysteresis", "quadratic_drag"],
        separate_by="slow reversals at two accelerations",
        gain=0.7,
        parameters=[torque],
        settings={**STRIBECK, "stribeck_speed": 0.05},
        note="a remark",
        log_gain=300.0,
        evidence=evidence("elbow", "speed", "rad/s", sided=True),
        rivals=[
            rival("presliding_hysteresis", 290.0, told),
            rival("payload", 90.0, "explains 70.0 % less", None),
        ],
    )
    shown = evidence("shoulder", "position", "rad")
    depends_on = ["position", "direction"]
    part = d.UnexplainedPart(
        joint="shoulder", depends_on=depends_on, share=0.4, evidence=shown
    )
    told = {"rmse": 0.3, "rmse_explained": 0.12, "white": False, "samples": 400}
    floor = {"noise_floor": 0.1, "noise_floor_interval": [0.08, 0.13]}
    tried = [rival("spring", 3.0, "gain of 0.9 standard errors; 2 are asked at least")]
    residual = d.ResidualEntry(**told, **floor, tried=tried)
    still = d.ResidualEntry(
        rmse=None, noise_floor=None, white=True, rmse_explained=None, samples=0
    )
    return d.DiagnosisFile(
        **head(d.DIAGNOSIS_SCHEMA, now()),
        robot=robot(),
        inputs=[log("v", "")],
        parameters=[FileId(path="p.json", sha256="0" * 64)],
        stages=["friction", "gravity", "inertia"],
        verdict="effect_found",
        findings=[finding],
        unexplained=[part],
        joints={"shoulder": still, "elbow": residual},
        events=[d.EventEntry(log="v", start=1.5, end=2.0, joints=["elbow"])],
        hidden=[d.HiddenEntry(effect="payload", joint=None, visible=0.02)],
        notes=["another remark"],
    )
