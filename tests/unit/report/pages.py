"""Documents of the robot of `tests.unit.params.documents`, and torques by their real
writer.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.identify.prediction.torque_files import parquet_writer
from seqid_cli.params.dates import now
from seqid_cli.params.document import head
from seqid_cli.params.encode import encode
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    Measured,
    PayloadFile,
)
from seqid_cli.params.results.plan import (
    PLAN_SCHEMA,
    FourierMotion,
    JointLimits,
    PlanFile,
    PlannedMove,
    PlannedStage,
    PredictedParameter,
)
from seqid_cli.params.results.prediction import (
    PREDICTION_SCHEMA,
    FileId,
    JointError,
    LogPredictionError,
    PredictionFile,
)
from seqid_cli.params.schema import Verdict
from seqid_cli.report.make import make_report
from tests.plants.robots.made import made_prediction
from tests.unit.params.documents import (
    JOINTS,
    diagnosis_file,
    full_file,
    inertia_file,
    log,
    robot,
)

LOGS = ("validation/a.parquet", "validation/b.parquet")
RATE_HZ = 250.0
SAMPLES = 4000
LINE_HZ = 7.0
SPIKE = 0.9  # N m, in one sample of the elbow


def source(path: str, content: Document) -> Source[Document]:
    return Source(path, hashlib.sha256(encode(content).encode()).hexdigest(), content)


def made(kind: Any, schema: str, **content: Any) -> Any:
    return kind(**head(schema, now()), robot=robot(), **content)


def prediction_file(*, shares: Sequence[float] = (0.02, 0.05)) -> PredictionFile:
    """A prediction of two logs, poor above 30 %."""
    counts = {"samples": SAMPLES, "samples_all": 2 * SAMPLES, "share_sliding": 0.5}

    joints = {}
    for name, share in zip(JOINTS, shares, strict=True):
        errors = {"rmse": share * 2.0, "max_abs": share * 6.0, "rmse_all": share * 1.5}
        joints[name] = JointError(relative_rmse=share, **errors, **counts)

    logs = []
    for path in LOGS:
        entry = LogPredictionError(
            path=path,
            sha256=path.ljust(64, "0"),
            samples=SAMPLES,
            cutoff_hz=30.0,
            joints=joints,
        )
        logs.append(entry)
    poor = {
        name: f"misses {x:.0%}"
        for name, x in zip(JOINTS, shares, strict=True)
        if x >= 0.3
    }
    return made(
        PredictionFile,
        PREDICTION_SCHEMA,
        inputs=[log(path, "") for path in LOGS],
        parameters=[FileId(path="elsewhere/inertia.json", sha256="0" * 64)],
        stages=["friction", "gravity", "imu", "inertia"],
        joints=joints,
        logs=logs,
        verdicts=[
            Verdict(joint=x, good=x not in poor, reason=poor.get(x, "")) for x in JOINTS
        ],
    )


def clean_diagnosis() -> DiagnosisFile:
    file = diagnosis_file()
    file.verdict, file.findings, file.unexplained = "nothing_missing", [], []
    residual = file.joints["elbow"]
    residual.rmse, residual.rmse_explained, residual.white = 0.12, 0.12, True
    file.events, file.hidden, file.parameters = [], [], []
    return file


def made_with(
    prediction: PredictionFile, parameters: Source[Document]
) -> PredictionFile:
    prediction.parameters = [FileId(path=parameters.path, sha256=parameters.sha256)]
    return prediction


def good_documents() -> list[Source[Document]]:
    """Parameters and a prediction of new logs with nothing against them."""
    parameters = source("inertia.json", inertia_file())
    return [
        parameters,
        source("prediction.json", made_with(prediction_file(), parameters)),
    ]


def all_documents() -> list[Source[Document]]:
    """One document of every kind, of which a refined file shows every section."""
    return [
        *good_documents(),
        source("diagnosis.json", diagnosis_file()),
        source("refined.json", full_file()),
    ]


def before_and_after() -> list[Source[Document]]:
    """Both models with a prediction each; that before is given first, and poor."""
    documents = all_documents()
    by_first = made_with(prediction_file(shares=(0.02, 0.5)), documents[0])
    by_refined = made_with(prediction_file(shares=(0.01, 0.02)), documents[3])
    results = [source("before.json", by_first), source("after.json", by_refined)]
    return [item for item in documents if item.path != "prediction.json"] + results


def payload_file(used: FileId) -> PayloadFile:
    errors = {
        "before": 2.5,
        "after": 0.125,
        "relative": 0.0625,
        "friction_change": 0.04,
    }
    center_of_mass = [
        Measured(value=0.01, std_error=0.001, unit="m"),
        Measured(value=0.02, std_error=0.001, unit="m"),
        Measured(value=None, std_error=None, unit="m"),
    ]

    return made(
        PayloadFile,
        PAYLOAD_SCHEMA,
        inputs=[log("loaded.parquet", "")],
        models=[used],
        payload=CarriedBodyEntry(
            frame="of joint elbow",
            mass=Measured(value=2.345, std_error=0.012, unit="kg"),
            center_of_mass=center_of_mass,
        ),
        parameters=[],
        covariance=[],
        settings={"urscript": "set_payload(2.345, [0.01, 0.02, 0.0])"},
        joints=dict.fromkeys(JOINTS, JointWithPayload(samples=100, **errors)),
        verdicts=[Verdict(good=True, reason="mass 2.345 kg, standard error 0.012 kg")],
        notes=["friction differs from the model's"],
    )


def plan_file() -> PlanFile:
    move = PlannedMove(
        name="pair_1",
        stage="inertia",
        joints=list(JOINTS),
        duration_s=8.0,
        start=dict.fromkeys(JOINTS, 0.0),
        fourier={
            JOINTS[0]: FourierMotion(centre=0.0, sine=[0.5] * 5, cosine=[0.0] * 5)
        },
        torque_share=0.625,
        torque={name: [10.0, 20.0] for name in JOINTS},
    )
    limit = JointLimits(
        position=[-1.0, 1.0], speed=1.0, acceleration=2.0, torque=40.0, moves=True
    )
    error = PredictedParameter(
        name="Izz_2", joint="elbow", unit="kg m^2", std_error=0.0375, value=None
    )

    return made(
        PlanFile,
        PLAN_SCHEMA,
        what="inertia",
        seed=1,
        parameters=[],
        limits=dict.fromkeys(JOINTS, limit),
        noise_density=dict.fromkeys(JOINTS, 0.01),
        noise_origin="",
        moves=[move],
        stages={
            "inertia": PlannedStage(parameters=[error], rank=9, structural_rank=10)
        },
        duration_s=8.0,
        total_s=12.0,
    )


def predicted_log(path: str, seed: int) -> LogPrediction:
    """Torques of one log: the residual of each joint is noise and a line."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) / RATE_HZ
    q = np.column_stack([np.sin(0.8 * t), np.cos(0.5 * t)])
    dq = np.gradient(q, t, axis=0)
    predicted = 2.0 * np.sin(q) + 0.5 * np.tanh(20.0 * dq)
    line = 0.1 * np.sin(2 * np.pi * LINE_HZ * t)[:, None]
    tau = predicted + line + 0.02 * rng.normal(size=q.shape)
    tau[SAMPLES // 3, 1] = predicted[SAMPLES // 3, 1] + SPIKE
    used = np.ones(SAMPLES, dtype=bool)
    used[:50] = used[-50:] = False
    return made_prediction(path, tau, predicted, t=t, used=used, q=q, dq=dq)


def write_torques(
    path: Path,
    *,
    joints: Sequence[str] = JOINTS,
    logs: Sequence[str] = LOGS,
    motion: bool = True,
    parameters: Sequence[str] = (),
    drop: float = 0.0,
) -> Path:
    """Write a torque file of a model that predicts the share `drop` too little."""
    with parquet_writer(path, joints, parameters) as write:
        for seed, name in enumerate(logs):
            prediction = predicted_log(name, seed)
            less = (1.0 - drop) * prediction.predicted
            prediction = replace(prediction, predicted=less, low=less, high=less)
            if not motion:
                unknown = np.full(prediction.tau.shape, np.nan)
                prediction = replace(prediction, q=unknown, dq=unknown)
            write(prediction)
    return path


def page_of_all(folder: Path) -> str:
    return make_report(
        all_documents(), torques=[write_torques(folder / "t.parquet")]
    ).html


def write_documents(folder: Path, documents: Sequence[Source[Document]]) -> list[str]:
    """Write documents as files; a prediction keeps the hash of its parameter file."""
    for item in documents:
        (folder / item.path).write_text(encode(item.content), encoding="utf-8")
    return [item.path for item in documents]
