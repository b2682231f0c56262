"""Every recorded robot, from its files to the held-out error, by commands.

Beside it stands a plain weighted least squares, written apart from the program: the
regressor is Pinocchio's, from the URDF or the DH parameters of the robot file. For each
joint j

    tau_j = Y_j(q, dq, ddq) phi + ia_j ddq_j + fv_j dq_j + fc_j sign(dq_j) + b_j,

with all ten parameters of each link, of which a QR decomposition with pivots picks the
columns that are independent. A first fit gives each joint's residual variance, a
second one is weighted by it. Motion and torque go through one low-pass there and back,
derivatives are differences. No sample is left out of the fit. Both are compared on the
same samples of the held-out logs: those in which the program says that a joint slides.
"""

import resource
import subprocess
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
from scipy.linalg import qr
from scipy.signal import butter, sosfiltfilt

from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.studies.recorded import DATA, TRIALS
from tests.studies.tables import number, table

# Rows of a log that are fitted at most; low-passed samples lie closer than they tell.
MOST_ROWS = 4000
RANK_TOLERANCE = 1e-7  # of the largest pivot, with columns of one length
BETTER = 0.02  # share of an error by which one fit is better than another


@dataclass(frozen=True)
class RecordedRobot:
    """A robot: its folder and robot file, logs to fit and logs to hold out.

    `published` are errors of other programs on the same held-out log, made by hand.
    """

    name: str
    folder: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    robot_file: str = "robot.toml"
    unit: str = "N m"
    published: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def paths(self, names: Sequence[str]) -> list[Path]:
        """Return the files of logs, patterns filled in."""
        folder = DATA / self.folder
        return [path for name in names for path in sorted(folder.glob(name))]

    @property
    def robot(self) -> Path:
        """The robot file."""
        return DATA / self.folder / self.robot_file


ROBOTS = (
    RecordedRobot(
        "Staubli TX40",
        "staubli_tx40",
        ("train.parquet",),
        ("holdout.parquet",),
        published={
            "FIGAROH 1.0.2, WLS with care": (2.00, 1.52, 1.19, 0.644, 7.59, 2.39)
        },
    ),
    RecordedRobot(
        "UR10e",
        "ur10e_innopolis",
        tuple(f"{name}.parquet" for name in TRIALS[:3]),
        (f"{TRIALS[3]}.parquet",),
        published={
            "FIGAROH 1.0.2, WLS with care": (2.16, 3.21, 1.04, 0.171, 0.246, 0.139)
        },
    ),
    RecordedRobot(
        "Rokae xMate", "rokae_xmate", ("train.parquet",), ("holdout.parquet",)
    ),
    RecordedRobot("UR5", "ur5_xsens", ("train/*.parquet",), ("held/*.parquet",)),
    RecordedRobot(
        "UR5e, joint 1 alone",
        "ur5e_joints",
        ("joint_0_train.parquet",),
        ("joint_0_holdout.parquet",),
        robot_file="joint_0_robot.toml",
    ),
    RecordedRobot(
        "UR5e, joint 6 alone",
        "ur5e_joints",
        ("joint_5_train.parquet",),
        ("joint_5_holdout.parquet",),
        robot_file="joint_5_robot.toml",
    ),
    RecordedRobot(
        "SO-101",
        "so101_sage",
        ("train/*.parquet",),
        ("held/*.parquet",),
        unit="the driver's N m",
    ),
    RecordedRobot(
        "AK80-6 pendulum",
        "dfki_simple_pendulum",
        (
            "energy_shaping.parquet",
            "direct_collocation.parquet",
            "pd_system_identification.parquet",
        ),
        ("ddp.parquet", "sac.parquet"),
    ),
    RecordedRobot(
        "LAAS motor",
        "laas_cogging",
        ("acc_current.parquet", "speed_test.parquet"),
        ("speed_test1.parquet",),
        unit="A",
    ),
)


def study(chosen: Namespace) -> str:
    """Return a table of all robots, then one of each with its joints."""
    present = [robot for robot in ROBOTS if robot.robot.is_file()]
    if not present:
        return "Left out: the recorded robots are not beside the project."
    results = [_measured(robot, chosen.cache / "recorded_all") for robot in present]
    header = [
        "robot",
        "logs fitted",
        "held out",
        "verdict of the fit",
        "of the prediction",
        "effects added",
        "fit, CPU s",
        "refine, CPU s",
        "WLS better than fit",
        "than refined",
    ]
    overview = table(header, [result.row() for result in results])
    return "\n\n".join([overview, NOTE, *(result.table() for result in results)])


NOTE = (
    "The last two columns count the joints at which the plain weighted least squares"
    " errs less, by more than 2 %. Errors below are RMS over the samples of the"
    " held-out logs in which the joint slides, the same for all rows of a table that"
    " have no other source; the least of each joint is set in bold."
)


@dataclass(frozen=True)
class Measured:
    """What came of one robot: errors (n,) of each way, and what it cost.

    `refined` is None where `refine` ended without a model; `refused` says why.
    """

    robot: RecordedRobot
    joints: int
    plain: Array
    fitted: Array
    refined: Array | None
    refused: str
    verdicts: tuple[str, str]
    effects: tuple[str, ...]
    cpu_s: tuple[float, float]

    def row(self) -> list[str]:
        """Return the row of the table of all robots."""
        better = [f"{self._better(self.fitted)} of {self.joints}", "-"]
        if self.refined is not None:
            better[1] = f"{self._better(self.refined)} of {self.joints}"
        counts = [
            str(len(self.robot.paths(names)))
            for names in (self.robot.train, self.robot.held_out)
        ]
        seconds = [f"{s:.0f}" if s >= 10.0 else number(s) for s in self.cpu_s]
        effects = ", ".join(self.effects) or self.refused or "none"
        return [self.robot.name, *counts, *self.verdicts, effects, *seconds, *better]

    def _better(self, errors: Array) -> int:
        """Return at how many joints the plain fit errs less."""
        return int(np.count_nonzero(self.plain < (1.0 - BETTER) * errors))

    def table(self) -> str:
        """Return the errors of all ways, joint by joint."""
        rows: dict[str, Array] = {"plain weighted least squares": self.plain}
        rows |= {
            name: np.array(errors) for name, errors in self.robot.published.items()
        }
        rows["seqid, `simultaneous`"] = self.fitted
        if self.refined is not None:
            rows["seqid, `refine`"] = self.refined
        least = np.nanmin(np.array([*rows.values()]), axis=0)
        cells = [
            [name, *(_cell(x, x <= best) for x, best in zip(row, least, strict=True))]
            for name, row in rows.items()
        ]
        joints = [f"joint {k + 1}" for k in range(self.joints)]
        return table([f"{self.robot.name}, {self.robot.unit}", *joints], cells)


def _cell(error: float, is_least: bool) -> str:
    """Return an error, in bold where it is the least."""
    return f"**{number(error, 3)}**" if is_least else number(error, 3)


def _measured(robot: RecordedRobot, cache: Path) -> Measured:
    """Run the commands for one robot, and the plain fit beside them.

    What the cache holds already is not made again.
    """
    folder = cache / robot.robot.parent.name / robot.robot.stem
    folder.mkdir(parents=True, exist_ok=True)
    train = [str(path) for path in robot.paths(robot.train)]
    held = [str(path) for path in robot.paths(robot.held_out)]
    arm = ["-r", str(robot.robot)]
    fit_s, _ = _command(folder, ["simultaneous", *train, *arm], "fit.json")
    fitted = _prediction(folder, "fit", held, arm)

    holdouts = [word for log in held for word in ("--holdout", log)]
    words = ["refine", *train, *holdouts, *arm, "-p", str(folder / "fit.json")]
    refine_s, said = _command(folder, words, "refined.json")
    refined = None
    effects: tuple[str, ...] = ()
    if (folder / "refined.json").is_file():
        refined = _prediction(folder, "refined", held, arm)
        stages = msgspec.json.decode((folder / "refined.json").read_bytes())["stages"]
        effects = tuple(
            dict.fromkeys(each["effect"] for each in stages.get("effects") or ())
        )

    loaded = load_robot(robot.robot)
    plain = _plain_errors(loaded, train, held, fitted)
    document = msgspec.json.decode((folder / "fit.json").read_bytes())
    levels = [
        each.get("level", "poor") for each in document["stages"]["inertia"]["verdicts"]
    ]
    return Measured(
        robot=robot,
        joints=loaded.n,
        plain=plain,
        fitted=fitted.errors(),
        refined=None if refined is None else refined.errors(fitted),
        refused="" if refined is not None else said,
        verdicts=(_worst(levels), _worst(fitted.levels)),
        effects=effects,
        cpu_s=(fit_s, refine_s),
    )


def _worst(levels: Sequence[str]) -> str:
    """Return the worst of verdicts."""
    order = ["poor", "usable", "good"]
    return min(levels, key=order.index, default="-")


@dataclass(frozen=True)
class Prediction:
    """Torques of the held-out logs as `seqid predict` writes them, by log.

    `torque`, `predicted` [N m] and `counts`, in which samples the joint slides, are
    (N, n).
    """

    times: tuple[Array, ...]
    torque: tuple[Array, ...]
    predicted: tuple[Array, ...]
    counts: tuple[Array, ...]
    cutoff_hz: tuple[float, ...]
    levels: tuple[str, ...]

    def errors(self, judge: "Prediction | None" = None) -> Array:
        """Return the RMS error (n,) on the samples of the one that judges."""
        return rms_of(self.torque, self.predicted, (judge or self).counts)


def rms_of(
    measured: Sequence[Array], predicted: Sequence[Array], counts: Sequence[Array]
) -> Array:
    """Return the RMS (n,) of a difference over the samples that count, NaN for none."""
    squares = np.zeros(measured[0].shape[1])
    number_of = np.zeros(measured[0].shape[1])
    for tau, model, mask in zip(measured, predicted, counts, strict=True):
        mask = mask.astype(bool) & np.isfinite(model) & np.isfinite(tau)
        squares += np.where(mask, tau - model, 0.0).__pow__(2).sum(axis=0)
        number_of += mask.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares / number_of)


def _prediction(
    folder: Path, model: str, held: Sequence[str], arm: Sequence[str]
) -> Prediction:
    """Predict the held-out logs by a model, and read the torques."""
    torques = folder / f"{model}-torques.parquet"
    words = ["predict", *held, *arm, "-p", str(folder / f"{model}.json")]
    _command(folder, [*words, "--torques", str(torques)], f"{model}-prediction.json")
    document = msgspec.json.decode((folder / f"{model}-prediction.json").read_bytes())
    joints = document["robot"]["joints"]
    rows = pq.read_table(torques)
    log = np.array(rows["log"].to_pylist())
    parts = [log == entry["path"] for entry in document["logs"]]

    def of_joints(quantity: str) -> Array:
        columns = [rows[f"{name}.{quantity}"].to_numpy() for name in joints]
        return np.column_stack(columns).astype(np.float64)

    t = rows["t"].to_numpy()
    torque = of_joints("torque")
    predicted = of_joints("predicted")
    counts = of_joints("sliding") * rows["used"].to_numpy().astype(float)[:, None]
    return Prediction(
        times=tuple(t[part] for part in parts),
        torque=tuple(torque[part] for part in parts),
        predicted=tuple(predicted[part] for part in parts),
        counts=tuple(counts[part] for part in parts),
        cutoff_hz=tuple(entry["cutoff_hz"] for entry in document["logs"]),
        levels=tuple(each["level"] for each in document["verdicts"]),
    )


def _command(folder: Path, words: Sequence[str], output: str) -> tuple[float, str]:
    """Run a command unless its result is there; return its CPU time, and why it failed.

    Time and reason are kept beside the result.
    """
    record = folder / f"{output}.said"
    if not record.is_file():
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-m", "seqid_cli", *words, "-o", str(folder / output)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        reason = ""
        if done.returncode > 1 or not (folder / output).is_file():
            lines = [text for text in done.stderr.splitlines() if "error:" in text]
            reason = lines[0].partition("error: ")[2] if lines else "it failed"
        record.write_text(f"{seconds}\n{reason}\n")
        sys.stderr.write(f"{folder.name} {words[0]}: {seconds:.0f} s {reason}\n")
    seconds_text, reason = record.read_text().split("\n")[:2]
    return float(seconds_text), reason


# ---- the plain weighted least squares, which knows nothing of the program's fits


def _plain_errors(
    robot: Robot, train: Sequence[str], held: Sequence[str], judge: Prediction
) -> Array:
    """Fit the training logs, and return the errors (n,) on the held-out ones."""
    cutoff_hz = float(np.median(judge.cutoff_hz))
    model = pinocchio_model(robot)
    fits = [
        _rows(model, read_recording(Path(path), robot), cutoff_hz, most=MOST_ROWS)
        for path in train
    ]
    W = np.concatenate([rows.regressor for rows in fits])  # (N, n, p)
    tau = np.concatenate([rows.torque for rows in fits])  # (N, n)
    theta = weighted_fit(W, tau)

    predicted = []
    for path, t in zip(held, judge.times, strict=True):
        rows = _rows(model, read_recording(Path(path), robot), cutoff_hz, most=None)
        torque = rows.regressor @ theta
        columns = [np.interp(t, rows.t, column) for column in torque.T]
        predicted.append(np.column_stack(columns))
    return rms_of(judge.torque, predicted, judge.counts)


def weighted_fit(W: Array, tau: Array) -> Array:
    """Fit tau (N, n) by W (N, n, p); return theta (p,), zero where a column depends."""
    count, n, p = W.shape
    rows = W.reshape(count * n, p)
    length = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
    factor, pivots = qr(rows / length, mode="r", pivoting=True)
    size = np.abs(np.diag(factor))
    base = np.sort(pivots[: np.count_nonzero(size > RANK_TOLERANCE * size[0])])

    weight = np.ones(n)
    theta = np.zeros(p)
    for _ in range(2):
        weighted = (W[:, :, base] * weight[:, None]).reshape(count * n, -1)
        target = (tau * weight).reshape(-1)
        scaled = weighted / length[base]
        theta[base] = np.linalg.lstsq(scaled, target, rcond=None)[0] / length[base]
        residual = tau - W @ theta
        weight = 1.0 / np.maximum(residual.std(axis=0), 1e-12)
    return theta


@dataclass(frozen=True)
class Rows:
    """Low-passed rows of a log: t (N,) s, regressor (N, n, p), torque (N, n) N m."""

    t: Array
    regressor: Array
    torque: Array


def _rows(model: pin.Model, log: Recording, cutoff_hz: float, most: int | None) -> Rows:
    """Return the rows of a log, some `most` of them, without its damaged samples."""
    assert log.tau is not None
    rate_hz = log.rate_hz
    sos = butter(4, min(cutoff_hz / (0.5 * rate_hz), 0.9), output="sos")
    q = sosfiltfilt(sos, log.q, axis=0)
    dq = np.gradient(q, 1.0 / rate_hz, axis=0)
    ddq = np.gradient(dq, 1.0 / rate_hz, axis=0)
    tau = sosfiltfilt(sos, np.nan_to_num(log.tau), axis=0)
    coulomb = sosfiltfilt(sos, np.sign(dq), axis=0)

    kept = np.arange(len(log.t))
    if most is not None:
        edge = int(rate_hz / cutoff_hz)
        kept = np.flatnonzero(log.valid & np.isfinite(log.tau).all(axis=1))
        kept = kept[(kept >= edge) & (kept < len(log.t) - edge)]
        kept = kept[:: max(1, len(kept) // most)]
    n = model.nv
    data = model.createData()
    regressor = np.zeros((len(kept), n, 14 * n))
    diagonal = np.arange(n)
    for row, k in enumerate(kept):
        rigid = pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
        regressor[row, :, : 10 * n] = rigid
        columns = (ddq[k], dq[k], coulomb[k], np.ones(n))
        for place, values in enumerate(columns):
            regressor[row, diagonal, (10 + place) * n + diagonal] = values
    return Rows(t=log.t[kept], regressor=regressor, torque=tau[kept])


def pinocchio_model(robot: Robot) -> pin.Model:
    """Return the arm as Pinocchio has it: of its URDF, or of its DH parameters."""
    if robot.urdf is not None:
        full = pin.buildModelFromUrdf(str(robot.urdf))
        others = [
            k
            for k in range(1, full.njoints)
            if full.names[k] not in set(robot.joint_names)
        ]
        model = pin.buildReducedModel(full, others, pin.neutral(full))
        assert list(model.names)[1:] == list(robot.joint_names)
    else:
        model = _of_dh(robot.source)
    model.gravity.linear = np.asarray(robot.gravity)
    return model


def _of_dh(robot_file: Path) -> pin.Model:
    """Return the arm of a robot file with modified DH parameters."""
    import tomllib

    model = pin.Model()
    parent = 0
    for entry in tomllib.loads(robot_file.read_text(encoding="utf-8"))["joint"]:
        dh = entry["dh"]
        # Rot(x, alpha) Trans(x, a) Rot(z, theta0 + q) Trans(z, d)
        before = pin.SE3(pin.utils.rotate("x", dh["alpha"]), np.zeros(3))
        along = pin.SE3(np.eye(3), np.array([dh["a"], 0.0, dh["d"]]))
        turned = pin.SE3(pin.utils.rotate("z", dh["theta0"]), np.zeros(3))
        placement = before * along * turned
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, entry["name"])
    return model
