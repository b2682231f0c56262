"""Faulty IMUs from the command line: said, left aside or mended, and never worse than encoders."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from seqid_cli.inspect.screening import Screened
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.commands.conftest import Rig
from tests.plants.robotfile import robot_toml
from tests.plants.robots.lab import true_standard, true_value
from tests.studies.fused_cases import Case, Fault, case
from tests.studies.fused_cases import Rig as Arm

Array = NDArray[np.float64]

ARM = Arm(2, seconds=5.0)
BOTH = ("imu_a", "imu_b")


def without(found: Case, name: str) -> Case:
    kept = {k: v for k, v in found.recording.accelerometers.items() if k != name}
    return replace(found, recording=replace(found.recording, accelerometers=kept))


def turned(found: Case, degrees: Mapping[str, list[float]]) -> Case:
    """The same log with a calibration that has some IMUs turned otherwise, about their own axes."""
    imus = dict(found.stage.imus)
    for name, angles in degrees.items():
        R = np.array(imus[name].rotation) @ Rotation.from_rotvec(angles, degrees=True).as_matrix()
        imus[name] = msgspec.structs.replace(imus[name], rotation=R.tolist())
    return replace(found, stage=ImuStage(imus=imus))


def backwards(found: Case) -> Case:
    """All readings with the wrong sign."""
    flipped = {k: -v for k, v in found.recording.accelerometers.items()}
    return replace(found, recording=replace(found.recording, accelerometers=flipped))


@dataclass(frozen=True)
class Fate:
    """What a fault must lead to: the IMUs that are left, and what is said."""

    made: Callable[[], Case]
    imus: tuple[str, ...]
    said: tuple[str, ...] = ()


FATES: Mapping[str, Fate] = {
    "none": Fate(lambda: case(ARM), BOTH),
    "not recorded": Fate(lambda: without(case(ARM), "imu_b"), BOTH[:1], ("imu_b is not recorded",)),
    "frozen midway": Fate(
        lambda: case(replace(ARM, fault=Fault(lost=True))), BOTH, ("imu_b reads in 50 % of the",)
    ),
    "clock 20 ms late": Fate(lambda: case(replace(ARM, fault=Fault(delay_s=0.02))), BOTH),
    "standstill and back": Fate(lambda: case(replace(ARM, pauses=True)), BOTH),
    "mounting 5 degrees off": Fate(lambda: turned(case(ARM), {"imu_b": [5, 0, 0]}), BOTH),
    "mounted otherwise": Fate(
        lambda: turned(case(ARM), {"imu_b": [90, 0, 0]}), BOTH[:1], ("imu_b is left out",)
    ),
    "all mounted otherwise": Fate(
        lambda: turned(case(ARM), {"imu_a": [180, 0, 0], "imu_b": [180, 0, 0]}),
        (),
        ("imu_a is left out", "imu_b is left out"),
    ),
    "all with the wrong sign": Fate(
        lambda: backwards(case(ARM)), (), ("imu_a is left out", "imu_b is left out")
    ),
}


@cache
def found_case(name: str) -> Case:
    return FATES[name].made()


@dataclass(frozen=True)
class Outcome:
    """What a run says and finds: largest error of the inertias over the largest one."""

    source: str
    imus: tuple[str, ...]
    error: float
    err: str


@dataclass
class Bench:
    """A folder in which commands read one simulated log."""

    rig: Rig
    monkeypatch: pytest.MonkeyPatch

    def simultaneous(self, found: Case, source: str) -> Outcome:
        """Identify everything from the log alone, with its calibrations."""
        self._place(found)
        command = ["simultaneous", "a.parquet", "-r", "robot.toml", "-p", "p.json", "--json"]
        done = self.rig.run(*command, "--motion", source)
        assert done.code == 0, done.err
        stage = json.loads(done.out)["stages"]["inertia"]
        standard = true_standard(found.plant)
        true = np.array([true_value(p["terms"], standard) for p in stage["parameters"]])
        off = np.array([p["value"] for p in stage["parameters"]]) - true
        use = stage["motion_use"][0]
        error = float(np.abs(off).max() / np.abs(true).max())
        return Outcome(use["source"], tuple(use["imus"]), error, done.err)

    def _place(self, found: Case) -> None:
        path = self.rig.folder / "robot.toml"
        path.write_text(robot_toml("two", found.plant), encoding="ascii")
        identity = robot_id(load_robot(path))
        write_json_atomic(
            self.rig.folder / "p.json", with_stage(None, identity, [], imu=found.stage)
        )
        recording = replace(found.recording, path=Path("a.parquet"))

        def read(path: Path, robot: Robot, **options: object) -> Screened:
            return Screened(recording, ())

        self.monkeypatch.setattr("seqid_cli.identify.log_set.read_screened", read)


@pytest.fixture
def bench(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(rig, monkeypatch)


@pytest.mark.parametrize("name", FATES)
def test_a_fault_is_said_and_does_no_harm(bench: Bench, name: str) -> None:
    found, fate = found_case(name), FATES[name]
    encoder = bench.simultaneous(found, "encoder")
    got = bench.simultaneous(found, "auto")
    assert got.imus == fate.imus
    assert got.source == ("fused" if fate.imus else "encoder")
    for text in fate.said:
        assert text in got.err, got.err
    if not fate.said:
        assert "warning" not in got.err
    assert got.error < 0.005  # of which the plain friction of this method is the most
    if not fate.imus:
        assert got.error == encoder.error
    assert (acceleration_error(found, "auto") <= acceleration_error(found, "encoder")).all()


def acceleration_error(found: Case, source: str) -> Array:
    """RMS (n,) rad/s^2 below one cut-off."""
    encoder = estimate_motion(found.recording, found.robot, MotionOptions(8.0))
    motion = best_motion(found.recording, found.robot, found.stage, encoder, source=source)
    off = (motion.ddq - motion.lowpass(found.truth))[motion.usable]
    return np.asarray(np.sqrt(np.mean(off**2, axis=0)))


def test_a_late_clock_is_set_right() -> None:
    """Its offset is found from the motion, though no calibration knows it."""
    found = found_case("clock 20 ms late")
    late = acceleration_error(found, "fused")
    assert (late < 0.1 * acceleration_error(found, "encoder")).all()
    assert (acceleration_error(found, "imu") > 10 * late).all()


@pytest.mark.parametrize("name", ["all mounted otherwise", "all with the wrong sign"])
def test_insisting_on_imus_that_cannot_be_right(bench: Bench, name: str) -> None:
    with pytest.raises(AssertionError, match="no calibrated, healthy IMU for --motion fused"):
        bench.simultaneous(found_case(name), "fused")
