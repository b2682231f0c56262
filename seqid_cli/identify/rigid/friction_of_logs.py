"""Friction log by log: whether a joint rubs alike in all constant-velocity trials.

Gravity is the same both ways and friction is not, so that trials of the gravity stage
measure friction once more, in other postures and at other times. With f the surface's
torque in the rows of log k and r what gravity leaves there,

    r = s_k f + noise,

s_k is the share by which friction is larger in that log than the surface. A drive that
warms up while its temperature is not logged rubs a little less in every log (strain
wave gears by 1 to 3 % per kelvin). Then the trials of friction themselves, whose speeds
follow one another, hold the warmth as if it were a dependence on the speed, and nothing
in them shows it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.rigid.gravity_rows import JointRows
from seqid_cli.identify.settings import GravityFitSettings
from seqid_cli.params.schema import FrictionJoint, Verdict
from seqid_cli.typing import Array, Index


@dataclass(frozen=True, kw_only=True)
class FrictionShares:
    """Shares (K,) by which a joint's friction in K logs is larger than its surface.

    `std_errors` (K,) are those of what gravity leaves; `surface_std` is the surface's
    stated error as a share of friction, common to all logs. `unexplained` (N,) N m is
    what gravity and these shares leave.
    """

    logs: Index
    shares: Array
    std_errors: Array
    surface_std: float
    unexplained: Array

    @classmethod
    def of(cls, joint: JointRows, theta: Array) -> "FrictionShares":
        """Return the shares in the logs of a joint, beside unknowns (q,)."""
        rows = joint.rows
        residual = joint.residual(theta)
        logs = np.unique(rows.log)
        shares = np.zeros(len(logs))
        std_errors = np.zeros(len(logs))
        unexplained = residual.copy()
        for k, log in enumerate(logs):
            in_log = rows.log == log
            friction = rows.friction[in_log]
            weight = rows.samples[in_log]
            power = float(np.sum(weight * friction**2))
            if power == 0.0:
                continue
            shares[k] = np.sum(weight * friction * residual[in_log]) / power
            unexplained[in_log] -= shares[k] * friction
            # Rows of one trial share their slow noise: trials are counted, not rows.
            trials = len(np.unique(rows.trial[in_log]))
            power_left = np.sum(weight * unexplained[in_log] ** 2)
            std_errors[k] = np.sqrt(power_left / power / trials)
        friction_rms = max(joint.rms(rows.friction), 1e-300)
        return cls(
            logs=logs,
            shares=shares,
            std_errors=std_errors,
            surface_std=joint.rms(rows.friction_std) / friction_rms,
            unexplained=unexplained,
        )

    @property
    def spread(self) -> float:
        """Largest difference between the shares of two logs."""
        return float(np.ptp(self.shares))

    @property
    def spread_std(self) -> float:
        """Standard error of the largest difference, the surface's error in one log."""
        ends = [int(self.shares.argmin()), int(self.shares.argmax())]
        of_logs = float(np.hypot(*self.std_errors[ends]))
        return float(np.hypot(of_logs, self.surface_std))

    def has_changed(self, settings: GravityFitSettings) -> bool:
        """Return whether friction differs between logs by enough, beyond errors."""
        least = max(
            settings.min_friction_change, settings.shown_sigma * self.spread_std
        )
        return self.spread > least

    def verdict(self, name: str, logs: Sequence[str]) -> Verdict:
        """Return the usable verdict of the friction, with the logs that differ most."""
        low = int(self.shares.argmin())
        high = int(self.shares.argmax())
        reason = (
            f"friction is not the same in all trials: {100.0 * self.spread:.2g} +-"
            f" {100.0 * self.spread_std:.1g} % less in {logs[self.logs[low]]} than in"
            f" {logs[self.logs[high]]}. The joint has warmed up, or its load changes"
            " its friction: log the joints' temperatures, or warm the arm up first"
        )
        return Verdict(joint=name, good=False, level="usable", reason=reason)

    def widened(self, joint: FrictionJoint) -> FrictionJoint:
        """Return the joint's friction as uncertain as it differs between the logs."""
        entries = [np.array(joint.positive).ravel()]
        if joint.directional:
            entries.append(np.array(joint.negative).ravel())
        friction = np.concatenate(entries)
        variance = float(np.mean(self.shares**2))
        covariance = np.array(joint.covariance) + variance * np.outer(
            friction, friction
        )
        return replace(joint, covariance=covariance.tolist())
