"""A session of logs as a user has them: files on disk, kept by case."""

import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

import tests.studies.outside as outside
from tests import Array
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm
from tests.studies.outside.robotfiles import STEP_S, robot_toml, urdf
from tests.studies.outside.simulate import Log, logged
from tests.studies.records import sources_of
from tests.studies.truth.follow import Followed, follow
from tests.studies.truth.plan import Case
from tests.studies.truth.tolerances import TOLERANCES
from tests.unit.logs.writers import (
    arm_messages,
    joint_messages,
    write_messages,
    write_parquet,
)

SPEEDS = np.geomspace(0.1, 0.85, 7)  # of friction trials, shares of the joint's limit
GRAVITY_SPEEDS = np.array([0.2, 0.4])
POSTURES = 3  # of gravity trials beside the friction trials' own
PAUSE_S = 5.0  # between two logs
INERTIA_S = 12.0
MOVES = {"inertia": ("lively", "spline", "points"), "held_out": ("spline", "lively")}
SLOW = 0.3  # of the joint's limit, below which a coarse encoder's joint hunts


@dataclass(frozen=True, kw_only=True)
class Session:
    """Files of one case.

    `logs` are by stage; `warmth` (n,) is each joint's mean temperature above the cold
    arm during its own friction trial, K, `warmth_of_moves` (n,) that during the inertia
    logs; `noise` (n,) the standard deviation of a torque sample, N m.
    """

    folder: Path
    logs: dict[str, list[Path]]
    warmth: list[float]
    warmth_of_moves: list[float]
    noise: list[float]

    @property
    def robot(self) -> Path:
        return self.folder / "robot.toml"


def sources() -> str:
    """Return the hash of everything that the logs depend on."""
    return sources_of(Path(outside.__file__).parent, Path(__file__).parent, but=_OTHERS)


# Files of these folders that the logs do not depend on.
_OTHERS = (
    *("__", "score", "tabulate", "truths", "rigs", "cases", "numbers", "refined"),
    *("groups", "changes", "foreign", "pushes", "questions"),
)


def session_of(case: Case, cache: Path) -> Session:
    """Return the case's files, made where the cache does not hold them."""
    folder = cache / sources() / case.label.replace(":", "-").replace(", ", "_")
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as name:
            made = Path(name) / "made"
            made.mkdir()
            record(case, made)
            if not folder.is_dir():  # another process may have been faster
                shutil.move(made, folder)
    about = json.loads((folder / "session.json").read_text(encoding="utf-8"))
    logs = {
        stage: [folder / x for x in names] for stage, names in about.pop("logs").items()
    }
    return Session(folder=folder, logs=logs, **about)


def record(case: Case, folder: Path) -> None:
    """Record all logs of a case into a folder, with the user's robot file and URDF."""
    write_robot(case, folder)
    recorder = _Recorder(case, folder)
    rng = np.random.default_rng([case.seed, 621])
    arm = case.arm
    stage_of_logs: dict[str, list[str]] = {"friction": [], "gravity": []}
    warmth = [0.0] * arm.n

    # Trials of one joint each: at many speeds, then at few in other postures.
    postures = _postures(arm.n, rng)
    for stage, speeds, chosen in (
        ("friction", SPEEDS, postures[:1]),
        ("gravity", GRAVITY_SPEEDS, postures[1:]),
    ):
        for posture in chosen:
            for j in case.joints:
                path, followed = recorder.add(motions.trial(arm, j, posture, speeds))
                stage_of_logs[stage].append(path.name)
                if stage == "friction":
                    warmth[j] = float(followed.warmth[:, j].mean())

    # Motions of all joints; one of the inertia logs may be with a tool.
    tool = case.sizes("tool")
    moved_warmth = []
    for stage, names in MOVES.items():
        stage_of_logs[stage] = []
        for number, name in enumerate(names):
            carries = tool is not None and stage == "inertia" and number == tool["log"]
            motion = MOTIONS[name](arm, rng, INERTIA_S)
            path, followed = recorder.add(motion, with_tool=carries, all_joints=True)
            stage_of_logs[stage].append(path.name)
            if stage == "inertia":
                moved_warmth.append(followed.warmth)

    about = {
        "logs": stage_of_logs,
        "warmth": warmth,
        "warmth_of_moves": np.concatenate(moved_warmth).mean(axis=0).tolist(),
        "noise": noise_of(case).tolist(),
    }
    (folder / "session.json").write_text(json.dumps(about), encoding="utf-8")


def lively(arm: Arm, rng: np.random.Generator, seconds: float) -> Array:
    """Harmonics of a quarter of a hertz that reach the joints' speeds, faded in and
    out.
    """
    t = np.arange(0.0, seconds, STEP_S)
    order = np.arange(1, 7)
    phases = rng.uniform(0.0, 2.0 * np.pi, (arm.n, len(order), 1))
    sizes = rng.uniform(0.3, 1.0, (arm.n, len(order))) / order
    waves = np.sin(2.0 * np.pi * 0.25 * order[:, None] * t + phases)
    q = np.einsum("jk,jkt->tj", sizes, waves)
    fade = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0.0, 1.0)
    fade = fade**3 * (10.0 - 15.0 * fade + 6.0 * fade**2)
    return motions.fitted(arm, q / np.abs(q).max(axis=0) * fade[:, None])


MOTIONS = {**motions.MOTIONS, "lively": lively}


def _postures(n: int, rng: np.random.Generator) -> Array:
    """Postures (P, n), shares of the joints' reach, that differ at every joint."""
    levels = np.linspace(-0.8, 0.8, POSTURES + 1)
    return np.column_stack([rng.permutation(levels) for _ in range(n)])


def noise_of(case: Case) -> Array:
    """Return the standard deviation (n,) of a torque sample's noise, N m."""
    return case.arm.noise * case.arm.of("coulomb")


def write_robot(case: Case, folder: Path) -> None:
    """Write the robot file and the URDF as the user believes them."""
    arm = case.arm
    declared = [TOLERANCES[x.kind] for x in case.imperfections if x.declared]
    of_robot = [x.entry for x in declared if not x.of_joint]
    of_joints = [x.entry for x in declared if x.of_joint]
    if off := case.sizes("geometry"):
        places, turns = np.array(off["places"]), np.array(off["turns"])
        links = [
            replace(link, place=link.place + place, turn=link.turn + turn)
            for link, place, turn in zip(arm.links, places, turns, strict=True)
        ]
        arm = replace(arm, links=tuple(links))
    (folder / "arm.urdf").write_text(urdf(arm), encoding="utf-8")
    text = robot_toml(arm, joints=case.joints, of_robot=of_robot, of_joints=of_joints)
    (folder / "robot.toml").write_text(text, encoding="utf-8")


class _Recorder:
    """Records one log after the other, on one clock."""

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder = case, folder
        self.clock, self.count = 0.0, 0

    def add(
        self, motion: Array, *, with_tool: bool = False, all_joints: bool = False
    ) -> tuple[Path, Followed]:
        """Record a motion (N, n) rad; a left-out joint moves in motions of all joints
        alone.
        """
        case = self.case
        motion = _as_it_goes(case, motion, all_joints=all_joints)
        followed = follow(case, motion, self.clock, with_tool=with_tool)
        self.count += 1
        seed = 100 * case.seed + self.count
        rng = np.random.default_rng([seed, 622])
        log = as_logged(case, followed, seed, rng)
        suffix = "mcap" if case.sizes("second_publisher") else "parquet"
        path = self.folder / f"log_{self.count:02}.{suffix}"
        _write(path, case, log, rng)
        self.clock += len(motion) * STEP_S + PAUSE_S
        return path, followed


def _as_it_goes(case: Case, motion: Array, *, all_joints: bool) -> Array:
    """Return the motion with what a hunting or a left-out joint does instead."""
    motion = motion.copy()
    if (out := case.sizes("left_out")) and not (out["moves"] and all_joints):
        motion[:, out["joint"]] = out["radians"]
    if hunts := case.sizes("hunting"):
        j = hunts["joint"]
        speed = np.abs(np.gradient(motion[:, j], STEP_S))
        slow = (speed > 1e-3) & (speed < SLOW * case.arm.links[j].speed)
        t = np.arange(len(motion)) * STEP_S
        size = hunts["counts"] * case.arm.drives[j].count
        # It comes and goes within a tenth of a second, so that the reference has no
        # steps.
        window = np.hanning(201) / np.hanning(201).sum()
        motion[:, j] += (
            size
            * np.convolve(slow, window, "same")
            * np.sin(2.0 * np.pi * hunts["hertz"] * t)
        )
    return motion


def as_logged(
    case: Case, followed: Followed, seed: int, rng: np.random.Generator
) -> Log:
    """Return what the logger gets to see."""
    arm, torque, q = case.arm, followed.torque, followed.q
    if sizes := case.sizes("constant"):
        torque = torque * (1.0 + np.array(sizes["shares"]))
    if sizes := case.sizes("filter"):
        sos = butter(sizes["order"], sizes["hertz"], fs=1.0 / STEP_S, output="sos")
        start = sosfilt_zi(sos)[:, :, None] * torque[0]
        torque, _ = sosfilt(sos, torque, axis=0, zi=start)
    if sizes := case.sizes("delay"):
        t = followed.t
        late = zip(torque.T, sizes["seconds"], strict=True)
        torque = np.column_stack(
            [np.interp(t - seconds, t, column) for column, seconds in late]
        )
    if sizes := case.sizes("offset"):
        torque = torque + np.array(sizes["shares"]) * arm.of("coulomb")
    if sizes := case.sizes("zero"):
        q = q.copy()
        q[:, sizes["joint"]] += sizes["radians"]
    if sizes := case.sizes("coloured"):
        every = round(1.0 / (STEP_S * arm.rate_hz))
        slow = _one_over_f(-(-len(torque) // every), arm.n, rng).repeat(every, axis=0)
        torque = torque + np.sqrt(sizes["share"]) * noise_of(case) * slow[: len(torque)]
        arm = replace(arm, noise=arm.noise * np.sqrt(1.0 - sizes["share"]))
    truth = (q, torque, followed.warmth, followed.sensed)
    return logged(arm, followed.t, truth, seed, ())


def _one_over_f(count: int, n: int, rng: np.random.Generator) -> Array:
    """Noise (count, n) of variance 1 whose density falls as 1/f."""
    spectrum = np.fft.rfft(rng.normal(size=(count, n)), axis=0)
    spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1.0))[:, None]
    spectrum[0] = 0.0
    noise = np.fft.irfft(spectrum, count, axis=0)
    return np.asarray(noise / noise.std(axis=0))


def _write(path: Path, case: Case, log: Log, rng: np.random.Generator) -> None:
    arm, t = case.arm, log.t - log.t[0]
    own: dict[str, Any] = {"accelerometers": log.accelerometers, "gyros": log.gyros}
    if sizes := case.sizes("noisy_velocity"):
        rate = np.gradient(log.q, t, axis=0)
        own["dq"] = rate + sizes["rad_s"] * rng.normal(size=rate.shape)
    effort = (
        log.torque / (arm.of("ratio") * arm.of("constant"))
        if arm.currents
        else log.torque
    )
    if sizes := case.sizes("second_publisher"):
        _write_two(path, arm, t, log, effort, own, sizes["hertz"])
        return
    own["current" if arm.currents else "torque"] = effort
    own["temperature"] = log.temperature if arm.temperatures else None
    write_parquet(path, log.t, arm.names, log.q, **own)


def _write_two(
    path: Path,
    arm: Arm,
    t: Array,
    log: Log,
    effort: Array,
    own: dict[str, Any],
    hertz: float,
) -> None:
    """Write the arm's messages, and between them zeros from another program."""
    origin = 1_700_000_000_000_000_000 + int(log.t[0]) * 10**9
    messages = arm_messages(t, arm.names, log.q, effort=effort, t0_ns=origin, **own)
    stamps = origin + (np.arange(0.003, t[-1], 1.0 / hertz) * 1e9).astype(np.int64)
    nothing = np.zeros((len(stamps), arm.n))
    others = joint_messages(stamps, arm.names, nothing, dq=nothing, effort=nothing)
    both = sorted([*messages, *others], key=_stamp)
    write_messages(path, both, encoding="cdr")


def _stamp(message: tuple[str, int, SimpleNamespace]) -> int:
    return message[1]


def paths(session: Session, stages: Sequence[str]) -> list[Path]:
    """Return the logs of some stages."""
    return [path for stage in stages for path in session.logs[stage]]
