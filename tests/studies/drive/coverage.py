"""How often the stated errors of controllers hold: drawn arms of one to three joints.

    python -m tests.studies.drive.coverage [ARMS]

Seeds from 100 on are this study's; nothing is tuned on them.
"""

import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from seqid_cli.drive.fit import fit_joint
from seqid_cli.drive.settings import DriveSettings
from seqid_cli.drive.signals import signals_of
from seqid_cli.model.torque import TorqueModel
from tests.plants.driven import drawn_arm, multisine, simulate_drive

FIRST_SEED = 100
SECONDS = 20.0
SETTINGS = DriveSettings()
# Names of the cases, with the arguments of the simulation.
CASES = {
    "torque, interpolated": {},
    "torque, sent at 50 Hz": {"command_hz": 50.0},
    "motion alone": {"with_torque": False},
}


class Estimate(NamedTuple):
    """One parameter of one joint against the truth; `error` is the stated one."""

    name: str
    true: float
    value: float
    error: float

    @property
    def holds(self) -> bool:
        return abs(self.value - self.true) <= 1.96 * self.error


def estimates(case: str, seed: int, n: int) -> Iterator[Estimate]:
    """Identify the drives of a drawn arm, and compare with the truth."""
    arm = drawn_arm(seed, n)
    if "sent" in case:
        # What steps has no slope that a controller could feed forward.
        arm = arm.with_drive(velocity_feedforward=np.zeros(n))
    log = simulate_drive(
        arm, multisine(seed, n, SECONDS), SECONDS, seed=seed, **CASES[case]
    )
    model = TorqueModel.from_stages(arm.stages(), arm.robot)
    wide, narrow = ([signals_of(log, model, share=share)] for share in (1.0, 0.5))
    drive = arm.drive
    for j in range(n):
        fit = fit_joint(wide, narrow, j, SETTINGS)
        if fit is None:
            continue
        true = {
            name: float(getattr(drive, name)[j])
            for name in (
                "proportional",
                "derivative",
                "integral",
                "velocity_feedforward",
                "gravity_compensation",
            )
        }
        true["acceleration_feedforward"] = 0.0
        true["command_delay"] = drive.command_delay
        if wide[0].measured:
            true["torque_lag"] = drive.torque_lag
        for name, value in fit.values.items():
            if name in true:
                yield Estimate(name, true[name], value, fit.std_errors[name])
        for name, error in fit.refused.items():
            yield Estimate(name, true[name], 0.0, error)


def main(n_arms: int) -> None:
    for case in CASES:
        found: list[Estimate] = []
        for k in range(n_arms):
            found += estimates(case, FIRST_SEED + k, 1 + k % 3)
        holds = np.mean([each.holds for each in found])
        sys.stdout.write(
            f"{case}: {len(found)} numbers, {holds:.1%} in their 95 % interval\n"
        )
        for name in dict.fromkeys(each.name for each in found):
            of_name = [each for each in found if each.name == name]
            relative = [
                abs(each.value / each.true - 1.0) for each in of_name if each.true
            ]
            off = np.median(relative) if relative else np.nan
            sys.stdout.write(
                f"  {name:25} {np.mean([each.holds for each in of_name]):6.1%}"
                f" of {len(of_name):3}, off by {off:.2%} (median)\n"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
