"""How often the stated errors of a drive hold: drawn arms of one, three and six joints.

    python -m tests.studies.drive.coverage [ARMS] [SITUATION ...]

Each situation prints, for every number, in how many joints the truth lies in the stated
interval, how large the error is in stated ones, and how far the number is off. Parts
that are not there and were not found are counted apart: they hold always. A log of the
same arm that was not fitted is replayed by the drive and by the true numbers.

Seeds from `FIRST_SEED` on are this study's; nothing is tuned on them. Those from 500 to
511 are spent: what they showed was mended.
"""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from seqid_cli import drive as drives
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.results.drive import (
    DRIVE_SCHEMA,
    DriveFile,
    DriveParameter,
    JointDrive,
)
from seqid_cli.params.schema import ParameterFile
from tests.plants.driven import DrivenArm, drawn_arm, multisine, simulate_drive

FIRST_SEED = 600
SECONDS = 20.0
JOINTS = (1, 3, 6)  # of one arm after the other
HELD_OUT_SEED = 50_000  # beside the arm's own
MOST_RATIO = 1.1  # asked of a replay, of that of the true numbers


@dataclass(frozen=True, kw_only=True)
class Situation:
    """What the logs hold, and what is given.

    `sent`: commands come at 50 Hz in messages of their own and hold. `nominal`: there
    is no model but the URDF's links, without friction and rotors. `links`: these,
    positions and commands are all there is.
    """

    sent: bool = False
    no_torque: bool = False
    nominal: bool = False

    def arm(self, seed: int, n: int) -> DrivenArm:
        drawn = drawn_arm(seed, n)
        if self.sent:
            # What steps has no slope that a controller could feed forward.
            drawn = drawn.with_drive(velocity_feedforward=np.zeros(n))
        return replace(drawn, robot=replace(drawn.robot, nominal=drawn.phi))

    def log(self, arm: DrivenArm, seed: int) -> Recording:
        n = arm.robot.n
        own: dict[str, Any] = {}
        if self.sent:
            own = {"command_hz": 50.0, "own_clock": True}
        log = simulate_drive(
            arm, multisine(seed, n, SECONDS), SECONDS, seed=seed, **own
        )
        return replace(log, tau=None) if self.no_torque else log

    def drive(self, arm: DrivenArm, log: Recording) -> DriveFile:
        model = () if self.nominal else model_of(arm)
        return drives.drive([log], arm.robot, model)


SITUATIONS = {
    "torque": Situation(),
    "sent": Situation(sent=True),
    "motion": Situation(no_torque=True),
    "nominal": Situation(nominal=True),
    "links": Situation(nominal=True, no_torque=True),
}


class Estimate(NamedTuple):
    """One parameter of one joint against the truth."""

    name: str
    true: float
    value: float
    low: float
    high: float
    error: float  # the stated one
    state: str

    @property
    def holds(self) -> bool:
        return self.low <= self.true <= self.high

    @property
    def sigmas(self) -> float:
        return abs(self.value - self.true) / max(self.error, 1e-300)


def model_of(arm: DrivenArm) -> ParameterFile:
    return ParameterFile(
        **head("seqid/params@1", "2026-01-01T00:00:00Z"),
        robot=robot_id(arm.robot),
        inputs=[],
        stages=arm.stages(),
    )


def true_values(arm: DrivenArm, j: int) -> dict[str, float]:
    drive = arm.drive
    columns = {
        "proportional": drive.proportional,
        "derivative": drive.derivative,
        "integral": drive.integral,
        "velocity_feedforward": drive.velocity_feedforward,
        "gravity_compensation": drive.gravity_compensation,
        "armature": arm.armature,
        "coulomb": arm.coulomb,
        "viscous": arm.viscous,
    }
    return {name: float(column[j]) for name, column in columns.items()} | {
        "acceleration_feedforward": 0.0,
        "friction_factor": 1.0,
        "command_delay": drive.command_delay,
        "torque_lag": drive.torque_lag,
    }


def estimates(file: DriveFile, arm: DrivenArm) -> Iterator[Estimate]:
    """Compare what a drive states with the truth."""
    for j, name in enumerate(arm.robot.joint_names):
        if name not in file.joints:
            continue
        true = true_values(arm, j)
        for found in file.joints[name].parameters:
            stated = (found.value, found.std_error, found.low, found.high)
            if found.name not in true or None in stated:
                continue
            if found.state not in ("identified", "absent"):
                continue
            yield Estimate(
                name=found.name,
                true=true[found.name],
                value=float(found.value or 0.0),
                low=float(found.low or 0.0),
                high=float(found.high or 0.0),
                error=float(found.std_error or 0.0),
                state=found.state,
            )


def with_truth(file: DriveFile, arm: DrivenArm) -> DriveFile:
    """Return a drive file with the true numbers in place of the identified ones."""
    joints = {}
    for j, (name, joint) in enumerate(file.joints.items()):
        true = true_values(arm, j)
        names = ["proportional", "derivative", "integral", "velocity_feedforward"]
        names += ["gravity_compensation", "command_delay"]
        joints[name] = JointDrive(
            parameters=[
                DriveParameter(
                    name=part,
                    value=true[part],
                    std_error=0.0,
                    unit="",
                    state="identified",
                )
                for part in names
            ],
            command=joint.command,
            command_known=True,
            left=0.0,
            rmse=0.0,
            samples=0,
        )
    return DriveFile(
        **head(DRIVE_SCHEMA, file.created),
        robot=file.robot,
        inputs=[],
        models=[],
        method=file.method,
        command_delay=None,
        joints=joints,
        stages=arm.stages(),
    )


def replay_ratios(file: DriveFile, arm: DrivenArm, log: Recording) -> list[float]:
    """Return held-out errors of position over 1 s, by those of the true numbers."""
    own = drives.replay([log], arm.robot, file).joints
    true = drives.replay([log], arm.robot, with_truth(file, arm)).joints
    return [own[name].position.rms / true[name].position.rms for name in own]


def table(title: str, found: Sequence[Estimate]) -> str:
    """Write how often intervals hold, number by number."""
    shown = [each for each in found if each.state == "identified"]
    absent = [each for each in found if each.state == "absent"]
    holds = np.mean([each.holds for each in shown])
    lines = [
        f"{title}: {len(shown)} numbers identified, {holds:.1%} in their interval;"
        f" {len(absent)} parts said to be absent,"
        f" {sum(each.true == 0.0 for each in absent)} of them rightly"
    ]
    for name in dict.fromkeys(each.name for each in shown):
        of_name = [each for each in shown if each.name == name]
        relative = [abs(each.value / each.true - 1.0) for each in of_name if each.true]
        off = np.median(relative) if relative else np.nan
        sigmas = np.array([each.sigmas for each in of_name])
        lines.append(
            f"  {name:25} {np.mean([each.holds for each in of_name]):6.1%} of"
            f" {len(of_name):3}, RMS of errors {np.sqrt(np.mean(sigmas**2)):5.2f}"
            f" stated ones, off by {off:.3%} (median)"
        )
    return "\n".join(lines) + "\n"


def study(name: str, situation: Situation, arms: int) -> Mapping[str, Any]:
    """Run a situation for some arms and print its table."""
    found: list[Estimate] = []
    ratios: list[float] = []
    cpu_s = 0.0
    joints = 0
    for k in range(arms):
        seed = FIRST_SEED + k
        arm = situation.arm(seed, JOINTS[k % len(JOINTS)])
        log = situation.log(arm, seed)
        start_s = time.process_time()
        file = situation.drive(arm, log)
        cpu_s += time.process_time() - start_s
        joints += arm.robot.n
        found += estimates(file, arm)
        if len(file.joints) == arm.robot.n:
            held_out = situation.log(arm, seed + HELD_OUT_SEED)
            ratios += replay_ratios(file, arm, held_out)
    sys.stdout.write(table(name, found))
    sys.stdout.write(
        f"  held-out replay over 1 s: {np.median(ratios):.3f} of that of the true"
        f" numbers (median), {max(ratios):.3f} at most,"
        f" {sum(ratio > MOST_RATIO for ratio in ratios)} of {len(ratios)} above"
        f" {MOST_RATIO}; {cpu_s / joints:.1f} CPU s a joint\n"
    )
    return {"found": found, "ratios": ratios}


def main(arguments: Sequence[str]) -> None:
    arms = int(arguments[0]) if arguments else 12
    for name in arguments[1:] or SITUATIONS:
        study(name, SITUATIONS[name], arms)


if __name__ == "__main__":
    main(sys.argv[1:])
