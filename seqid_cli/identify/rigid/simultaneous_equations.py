"""The equations of the classical way (Eq. 5-6): rigid body and friction together.

With H the regressor of the base parameters pi (Eq. 4), s = tanh(dq / w) the direction
of motion, d a delay, and a, b the waves of friction over the position,

    tau = H pi + F_c s + F_v |dq| s + F_o - d dtau/dt + s (a cos(q) + b sin(q)).

Each joint has F_c, F_v, F_o, d, a, b of its own; its rows are accumulated by
themselves. Delays and waves are nuisances: they stand behind the parameters and are
marginalised.
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.identify.bands.rows import BandRowsCollector
from seqid_cli.identify.nuisances import PRIORS
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
    whitened,
)
from seqid_cli.identify.regression.repeats import with_log
from seqid_cli.model.friction import SLIDES
from seqid_cli.model.torque import known_rotors, sliding
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base_parameters import free_basis, gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Share of a joint's speed over which its friction changes sign. The joint's fastest log
# counts: one that moves it hardly, as others shake it, does not say how fast it slides.
SIGN_SHARE = 0.004
# Friction of a joint: names and units; the offset last, as it may be left out.
FRICTION_TERMS = (("coulomb", "N m"), ("viscous", "N m s/rad"), ("offset", "N m"))
WAVE_TERMS = 2  # of a joint: cosine and sine of its position
WAVE_SHARE = 0.1  # of Coulomb friction, that waves over the position usually have


class SimultaneousEquations:
    """Accumulates the rows of every joint, [H, friction, delay, waves | tau].

    `width` (n,) rad/s is the speed over which friction changes its sign, `friction` the
    places of each joint's friction terms, `waves` those of its waves, `delays` those of
    all delays, `nuisances` those of delays and waves.
    """

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        *,
        offset: bool,
        sign_share: float = SIGN_SHARE,
    ) -> None:
        self.robot = robot
        self.basis = free_basis(robot)
        self.terms = FRICTION_TERMS if offset else FRICTION_TERMS[:2]
        n_terms = len(self.terms)
        first_delay = self.basis.size + n_terms * robot.n
        first_wave = first_delay + robot.n
        size = first_wave + WAVE_TERMS * robot.n
        self.friction = [
            slice(first, first + n_terms)
            for first in range(self.basis.size, first_delay, n_terms)
        ]
        self.delays = slice(first_delay, first_wave)
        self.waves = [
            slice(first, first + WAVE_TERMS)
            for first in range(first_wave, size, WAVE_TERMS)
        ]
        self.nuisances = slice(first_delay, size)

        self.joints = [Accumulator(size) for _ in range(robot.n)]
        self.logs: list[list[Accumulator]] = []  # of each log by itself
        # H' times the torque of known rotors
        self.rotor_sums = np.zeros((robot.n, size))
        self.torque_squares = np.zeros(robot.n)
        self.band_rows = BandRowsCollector()
        shares = [equations.independent_share(motion) for motion in motions]
        self.independent = float(np.mean(shares))

        speeds = [np.where(motion.moving, np.abs(motion.dq), 0.0) for motion in motions]
        self.fastest = np.max([speed.max(axis=0) for speed in speeds], axis=0)
        self.width = sign_share * np.max([_usual_fastest(x) for x in speeds], axis=0)
        self.low = np.min([motion.q.min(axis=0) for motion in motions], axis=0)
        self.high = np.max([motion.q.max(axis=0) for motion in motions], axis=0)
        for motion in motions:
            self._add(motion)

    def _add(self, motion: Motion) -> None:
        """Add the rows of one log."""
        assert motion.tau is not None
        usable = sliding(motion, SLIDES * self.width)
        reflected = gear_ratios(self.robot) ** 2 * known_rotors(self.robot)
        rotors = motion.filtered(reflected * motion.ddq)
        y = motion.tau - rotors
        friction, waves = self._friction_columns(motion)
        torque_rate = np.gradient(motion.tau, axis=0) * motion.rate_hz

        log_joints = [Accumulator(joint.size) for joint in self.joints]
        self.band_rows.next_log()
        for part, H in equations.filtered_regressor(motion, self.robot, self.basis):
            inner = motion.part(part)
            chosen = self.band_rows.pick(inner, usable[part])
            samples = np.arange(motion.samples)[part][chosen]
            self.band_rows.add(
                inner,
                chosen,
                H=self._all_columns(
                    H[chosen], friction[samples], torque_rate[samples], waves[samples]
                ),
                y=y[samples],
                used=usable[samples],
                judged=usable[samples],
            )
            for block in equations.blocks(len(H), motion.rate_hz):
                for j, joint in enumerate(log_joints):
                    rows = usable[part][block, j]
                    A = np.zeros((int(rows.sum()), joint.size))
                    A[:, : self.basis.size] = H[block, j][rows]
                    A[:, self.friction[j]] = friction[part][block, j][rows]
                    A[:, self.delays.start + j] = -torque_rate[part][block, j][rows]
                    A[:, self.waves[j]] = waves[part][block, j][rows]
                    joint.add(A, y[part][block, j][rows])
                    self.rotor_sums[j] += A.T @ rotors[part][block, j][rows]

        self.torque_squares += np.sum(np.where(usable, motion.tau, 0.0) ** 2, axis=0)
        self.logs.append(log_joints)
        self.joints = with_log(self.joints, log_joints)

    def _friction_columns(self, motion: Motion) -> tuple[Array, Array]:
        """Return columns of friction (N, n, terms) and waves (N, n, 2), filtered."""
        sign = np.tanh(motion.dq / np.where(self.width > 0, self.width, 1.0))
        friction = np.stack(
            [sign, sign * np.abs(motion.dq), np.ones_like(sign)], axis=2
        )
        phase = self._phase(motion.q)
        waves = sign[:, :, None] * np.stack([np.cos(phase), np.sin(phase)], axis=2)
        columns = np.concatenate([friction[:, :, : len(self.terms)], waves], axis=2)
        filtered = motion.filtered(columns, times=2)
        friction, waves = np.split(filtered, [len(self.terms)], axis=2)
        return friction, waves

    def _phase(self, q: Array) -> Array:
        """Return phases (N, n) rad of waves over positions.

        A slide's travel is half a wave.
        """
        travel = np.maximum(self.high - self.low, 1e-9)
        slides = self.robot.chain.prismatic
        return np.asarray(np.where(slides, np.pi / travel, 1.0) * q)

    def _all_columns(
        self, H: Array, friction: Array, torque_rate: Array, waves: Array
    ) -> Array:
        """Return rows (K, n, p) of all unknowns.

        Parameters
        ----------
        H : (K, n, b) array
            Columns of the rigid body.
        friction : (K, n, terms) array
            Columns of friction.
        torque_rate : (K, n) array
            Change of the torque [N m/s], by which a delay shows.
        waves : (K, n, 2) array
            Columns of friction over the position.
        """
        columns = np.zeros((*H.shape[:2], self.joints[0].size))
        columns[:, :, : self.basis.size] = H
        for j, places in enumerate(self.friction):
            columns[:, j, places] = friction[:, j]
            columns[:, j, self.delays.start + j] = -torque_rate[:, j]
            columns[:, j, self.waves[j]] = waves[:, j]
        return columns

    def prior(self, coulomb: Array | None = None) -> Prior:
        """Return the prior of delays, and of waves with Coulomb friction (n,) N m.

        There are no waves where Coulomb friction is not given.
        """
        n = self.robot.n
        delays = whitened(PRIORS.delay_covariance(n))
        sizes = np.zeros(n) if coulomb is None else WAVE_SHARE * np.abs(coulomb)
        waves = np.diag(np.repeat(1.0 / np.maximum(sizes, 1e-9), WAVE_TERMS))
        rows = np.zeros((len(delays) + len(waves), self.nuisances.stop))
        rows[: len(delays), self.delays] = delays
        rows[len(delays) :, self.delays.stop :] = waves
        return Prior(A=rows, b=np.zeros(len(rows)))

    def solved(self, prior: Prior) -> Solution:
        """Solve for base parameters, friction, delays and waves."""
        return solve(
            self.joints,
            prior=prior,
            nuisances=self.nuisances,
            independent=self.independent,
        )

    def with_waves(self, solution: Solution) -> Solution:
        """Solve once more, beside waves of friction of a usual size."""
        coulomb = solution.theta[[places.start for places in self.friction]]
        return self.solved(self.prior(coulomb))


def _usual_fastest(speed: Array) -> Array:
    """Return the 99 % quantile (n,) of speeds (N, n), the usual fastest of a log.

    It is the fastest of all where a joint moved for a moment only.
    """
    usual = np.quantile(speed, 0.99, axis=0)
    return np.asarray(np.where(usual > 0, usual, speed.max(axis=0)))


def surface_entries(fastest: float, terms: int) -> tuple[Array, Array]:
    """Return entries (2, terms) of a surface, ahead and back, per friction term."""
    # Over [0, fastest] |v| = fastest (1 + T_1(u)) / 2; the offset has the sign of
    # motion taken off.
    ahead = np.array([[1.0, fastest / 2, 1.0], [0.0, fastest / 2, 0.0]])[:, :terms]
    return ahead, ahead * np.array([1.0, 1.0, -1.0])[:terms]
