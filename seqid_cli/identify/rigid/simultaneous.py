"""The classical way (Eq. 5-6): rigid body, Coulomb and viscous friction in one least squares.

    tau = H(q, dq, ddq) pi + F_c sign(dq) + F_v dq + F_o

for comparison with the sequential way, and for logs that hold no single-joint trials.
F_o is a constant torque per joint, as a current sensor's zero or a warm drive leaves
it. Without it, base parameters stand in for it and are wrong beyond their errors. The
delay of each joint's torque is unknown as well (`identify.nuisances`). It is
marginalised and never reported: beside this law of friction it takes what friction is
otherwise. The result is written as a friction stage of orders (0, 1) and an inertia
stage with all base parameters, for every later command.

Friction of most gears waves over the position,

    sign(dq) (a cos(q) + b sin(q)),

which this law does not hold and base parameters take, up to many of their errors'
worth. So the same equations are solved once more with a and b unknown, 0 +- 0.1 F_c.
Where they show, the stage is usable, not good. What they change in the parameters
counts as an error of these, and what they add to friction as one of Coulomb friction
at any one position.
"""

from collections.abc import Iterable, Sequence
from copy import deepcopy

import numpy as np
from msgspec.structs import replace

from seqid_cli.errors import QualityError
from seqid_cli.identify.bands.calibrate import calibrate
from seqid_cli.identify.bands.left_out import Fit
from seqid_cli.identify.bands.rows import BandRowsCollector
from seqid_cli.identify.friction_surface.summary import constants_note
from seqid_cli.identify.nuisances import PRIORS
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
    whitened,
)
from seqid_cli.identify.regression.noise_level import (
    LogNoise,
    NoiseLevel,
    noise_of_log,
    noise_of_rows,
)
from seqid_cli.identify.rigid.log_agreement import agreement_verdicts, log_equations
from seqid_cli.identify.rigid.parameters import joint_verdicts, rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.settings import OneStepSettings, SimultaneousSettings
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.units import UNTOLD
from seqid_cli.model.friction import EXTENSION_SIZE, SLIDES
from seqid_cli.model.torque import known_rotors, sliding
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params import schema
from seqid_cli.robot.base_parameters import free_basis, gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

SIGN_SHARE = 0.004  # of a joint's speed, over which its friction changes sign
TERMS = (("coulomb", "N m"), ("viscous", "N m s/rad"), ("offset", "N m"))
WAVE_TERMS = 2  # of a joint: cosine and sine of its position
WAVE_SHARE = 0.1  # of Coulomb friction, that waves over the position usually have


def identify_simultaneous(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: MotionOptions,
    offset: bool = True,
    imu: schema.ImuStage | None = None,
    source: str = "auto",
    settings: SimultaneousSettings = SimultaneousSettings(),
) -> tuple[schema.FrictionStage, schema.RigidStage]:
    """Identify rigid body and Coulomb-viscous friction, and a torque F_o if `offset`, together."""
    paths, motions, noise = [], [], []
    for recording in recordings:
        paths.append(recording.path)
        motion = equations.torque_motion(
            recording, robot, options, imu=imu, source=source
        )
        motions.append(deepcopy(motion))  # without the samples that it was thinned from
        fastest = np.abs(np.where(motion.moving, motion.dq, 0.0)).max(axis=0)
        slides = sliding(motion, SLIDES * SIGN_SHARE * fastest)
        noise.append(noise_of_log(recording, motion, slides))
    rows = SimultaneousEquations(robot, motions, offset=offset) if motions else None
    if rows is None or not any(joint.samples for joint in rows.joints):
        raise QualityError(
            "no joint moves in these logs", hint="record moves of every joint"
        )
    uses = [
        equations.motion_use(path, robot, x)
        for path, x in zip(paths, motions, strict=True)
    ]
    return rows.stages(uses, options, noise, settings)


class SimultaneousEquations:
    """Accumulates [H, friction columns | tau] of every joint.

    Friction changes its sign over `width` (n,): `share` of the speed of a joint in the
    log in which it is fastest. One that moves it hardly, as others shake it, does not
    say how fast it slides.
    """

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        *,
        offset: bool,
        share: float = SIGN_SHARE,
    ) -> None:
        self.robot, self.basis = robot, free_basis(robot)
        self.terms = TERMS if offset else TERMS[:2]
        first_delay = self.basis.size + len(self.terms) * robot.n
        edges = range(self.basis.size, first_delay, len(self.terms))
        self.own = [slice(k, k + len(self.terms)) for k in edges]
        first_wave = first_delay + robot.n
        size = first_wave + WAVE_TERMS * robot.n
        self.delays = slice(first_delay, first_wave)
        self.nuisances = slice(first_delay, size)
        self.waves = [
            slice(k, k + WAVE_TERMS) for k in range(first_wave, size, WAVE_TERMS)
        ]
        self.joints = [Accumulator(size) for _ in range(robot.n)]
        # H' times the torque of known rotors
        self._rotor_sums = np.zeros((robot.n, size))
        self.torque_squares = np.zeros(robot.n)
        self.band_rows = BandRowsCollector()
        shares = [equations.independent_share(motion) for motion in motions]
        self.independent = float(np.mean(shares))
        speeds = [np.where(motion.moving, np.abs(motion.dq), 0.0) for motion in motions]
        self.fastest = np.max([speed.max(axis=0) for speed in speeds], axis=0)
        usual = [np.quantile(speed, 0.99, axis=0) for speed in speeds]
        # Zero where it moved for a moment only.
        shown = [
            np.where(x > 0, x, v.max(axis=0))
            for x, v in zip(usual, speeds, strict=True)
        ]
        self.width = share * np.max(shown, axis=0)
        self.low = np.min([motion.q.min(axis=0) for motion in motions], axis=0)
        self.high = np.max([motion.q.max(axis=0) for motion in motions], axis=0)
        self.logs: list[list[Accumulator]] = []  # of each log by itself
        for motion in motions:
            self._add(motion)

    def _add(self, motion: Motion) -> None:
        """Add the rows of one log."""
        assert motion.tau is not None
        usable = sliding(motion, SLIDES * self.width)
        reflected = gear_ratios(self.robot) ** 2 * known_rotors(self.robot)
        rotors = motion.filtered(reflected * motion.ddq)
        y = motion.tau - rotors
        # Of sign, velocity and offset, filtered like predicted friction.
        sign = np.tanh(motion.dq / np.where(self.width > 0, self.width, 1.0))
        own_log = [Accumulator(joint.size) for joint in self.joints]
        columns = np.stack([sign, sign * np.abs(motion.dq), np.ones_like(sign)], axis=2)
        phase = self._phase(motion.q)
        waves = sign[:, :, None] * np.stack([np.cos(phase), np.sin(phase)], axis=2)
        columns = np.concatenate([columns[:, :, : len(self.terms)], waves], axis=2)
        friction, waves = np.split(
            motion.filtered(columns, times=2), [len(self.terms)], axis=2
        )
        change = np.gradient(motion.tau, axis=0) * motion.rate_hz
        self.band_rows.next_log()
        for part, H in equations.filtered_regressor(motion, self.robot, self.basis):
            inner = motion.part(part)
            chosen = self.band_rows.pick(inner, usable[part])
            some = np.arange(motion.samples)[part][chosen]
            self.band_rows.add(
                inner,
                chosen,
                H=self._wide(H[chosen], friction[some], change[some], waves[some]),
                y=y[some],
                used=usable[some],
                judged=usable[some],
            )
            for block in equations.blocks(len(H), motion.rate_hz):
                for j, joint in enumerate(own_log):
                    kept = usable[part][block, j]
                    wide = np.zeros((int(kept.sum()), joint.size))
                    wide[:, : self.basis.size] = H[block, j][kept]
                    wide[:, self.own[j]] = friction[part][block, j][kept]
                    wide[:, self.delays.start + j] = -change[part][block, j][kept]
                    wide[:, self.waves[j]] = waves[part][block, j][kept]
                    joint.add(wide, y[part][block, j][kept])
                    self._rotor_sums[j] += wide.T @ rotors[part][block, j][kept]
        self.torque_squares += np.sum(np.where(usable, motion.tau, 0.0) ** 2, axis=0)
        self.logs.append(own_log)
        self.joints = [a + b for a, b in zip(self.joints, own_log, strict=True)]

    def _phase(self, q: Array) -> Array:
        """Return the phases (N, n) rad of waves over positions; a slide's travel is half a wave."""
        travel = np.maximum(self.high - self.low, 1e-9)
        slides = self.robot.chain.prismatic
        return np.asarray(np.where(slides, np.pi / travel, 1.0) * q)

    def prior(self, coulomb: Array | None = None) -> Prior:
        """Return what is known before of delays, and of waves beside Coulomb friction (n,) N m.

        There are no waves where Coulomb friction is not given.
        """
        n = self.robot.n
        delays = whitened(PRIORS.delay_covariance(n))
        sizes = np.zeros(n) if coulomb is None else WAVE_SHARE * np.abs(coulomb)
        waves = np.diag(np.repeat(1.0 / np.maximum(sizes, 1e-9), WAVE_TERMS))
        rows = np.zeros((len(delays) + len(waves), self.nuisances.stop))
        rows[: len(delays), self.delays] = delays
        rows[len(delays) :, self.delays.stop :] = waves
        return Prior(rows, np.zeros(len(rows)))

    def solved(self, prior: Prior) -> Solution:
        """Solve for base parameters, friction, delays and waves."""
        return solve(
            self.joints,
            prior=prior,
            nuisances=self.nuisances,
            independent=self.independent,
        )

    def _wide(self, H: Array, friction: Array, change: Array, waves: Array) -> Array:
        """Return rows (K, n, p) of all unknowns from those of the rigid body and of friction.

        `change` (K, n) N m/s is that of the torque, by which a delay shows; `waves` (K,
        n, 2) are those of friction over the position.
        """
        wide = np.zeros((*H.shape[:2], self.joints[0].size))
        wide[:, :, : self.basis.size] = H
        for j, own in enumerate(self.own):
            wide[:, j, own] = friction[:, j]
            wide[:, j, self.delays.start + j] = -change[:, j]
            wide[:, j, self.waves[j]] = waves[:, j]
        return wide

    def stages(
        self,
        uses: list[schema.MotionUse],
        options: MotionOptions,
        noise: Sequence[LogNoise] = (),
        settings: SimultaneousSettings = SimultaneousSettings(),
    ) -> tuple[schema.FrictionStage, schema.RigidStage]:
        """Solve and describe the result; `uses` and `noise` are of the logs."""
        robot = self.robot
        prior = self.prior()
        solution = self.solved(prior)
        known = {
            j: -self.independent * solution.bread @ sums / solution.sigma[j] ** 2
            for j, sums in enumerate(self._rotor_sums)
        }
        coulomb = solution.theta[[terms.start for terms in self.own]]
        waving = self.solved(self.prior(coulomb))
        moved_by_waves = waving.theta - solution.theta
        posterior = Posterior.of(
            solution, (), robot.torque_constant_errors, {}, known, prior
        ).with_error(moved_by_waves[:, None])
        moved = [j for j in range(robot.n) if self.joints[j].samples]
        named = " and ".join(", ".join(name for name, _ in self.terms).rsplit(", ", 1))
        note = (
            f"friction ({named}) from one least squares with the rigid body (Eq. 5-6)"
        )
        cutoff = float(np.median([use.cutoff_hz for use in uses]))
        friction = schema.FrictionStage(
            joints={
                robot.joint_names[j]: self._joint(j, solution, posterior, waving)
                for j in moved
            },
            method="simultaneous",
            cutoff_hz=cutoff,
            notes=[note, equations.cutoff_note(uses, options), *constants_note(robot)],
        )
        own = np.arange(self.basis.size)
        stage = rigid_stage(
            robot, self.basis, solution, posterior, own, known_rotors(robot)
        )
        free = [j for j in moved if not solution.determined[self.own[j]][2:].all()]
        text = (
            f"the offset of {', '.join(robot.joint_names[j] for j in free)} is not told"
            " apart from other torques: record wider moves, or leave offsets out"
            " (--no-offset)"
        )
        floor = noise_of_rows(
            stage,
            robot,
            uses=uses,
            logs=noise,
            joints=self.joints,
            torque_squares=self.torque_squares,
        )
        named_floor = [
            (name, j) for j, name in enumerate(robot.joint_names) if floor.high[j]
        ]
        rigid = replace(
            stage,
            noise_floor={name: float(floor.rms[j]) for name, j in named_floor},
            noise_floor_high={name: float(floor.high[j]) for name, j in named_floor},
            rank=solution.rank - len(self.terms) * len(moved),
            friction_sensitivity=self._sensitivity(posterior, solution),
            rmse=dict(zip(robot.joint_names, solution.sigma.tolist(), strict=True)),
            method="simultaneous",
            motion={use.log: equations.source_text(use) for use in uses},
            motion_use=uses,
            cutoff_hz=cutoff,
            verdicts=[
                *self._verdicts(
                    solution,
                    waving,
                    floor,
                    n_missing=len(stage.not_excited),
                    settings=settings.residual,
                ),
                *agreement_verdicts(
                    log_equations([use.log for use in uses], self.logs),
                    robot,
                    solution.sigma,
                    self.torque_squares,
                    self.basis.size,
                    settings.agreement,
                    independent=self.independent,
                ),
            ],
            notes=[*stage.notes, *([text] if free else [])],
        )
        fit = Fit(
            theta=solution.theta,
            bread=solution.bread,
            sigma=solution.sigma,
            independent=self.independent,
            predicting=self.delays.start,
        )
        model = schema.Stages(friction=friction, inertia=rigid)
        bands = calibrate(self.band_rows, fit, model, robot, cutoff_hz=cutoff)
        return friction, replace(rigid, bands=bands)

    def _joint(
        self, j: int, solution: Solution, posterior: Posterior, waving: Solution
    ) -> schema.FrictionJoint:
        """Return one joint's friction as a surface, tau_f = s(v) (c_0 + c_1 T_1(u)).

        It is as uncertain as it waves over the position by the solution `waving`.
        """
        own = self.own[j]
        fast = float(self.fastest[j])
        sigma = float(solution.sigma[j])
        joint = self.robot.joints[j]
        values = solution.theta[own]
        covariance = posterior.covariance[own, own].copy()
        wave = waving.theta[self.waves[j]]
        covariance[0, 0] += float(wave @ wave) / 2.0  # its mean square over positions
        ahead, back = surface_entries(fast, len(self.terms))
        directional = len(self.terms) == len(TERMS)
        both = np.vstack([ahead, back]) if directional else ahead
        errors = np.sqrt(np.maximum(np.diag(posterior.stated)[own], 0.0))
        errors[~solution.determined[own]] = UNTOLD
        return schema.FrictionJoint(
            unit=joint.unit("N m"),
            position_order=0,
            velocity_order=1,
            # of Coulomb friction
            max_error=sigma / max(float(np.abs(values[0])), 1e-12),
            rmse=sigma,
            position_range=[float(self.low[j]), float(self.high[j])],
            speed_range=[0.0, fast],
            sign_width=max(float(self.width[j]), 1e-6),
            directional=directional,
            positive=[(ahead @ values).tolist()],
            negative=[(back @ values).tolist()],
            covariance=(both @ covariance @ both.T).tolist(),
            torque_constant_error=joint.torque_constant_error,
            speeds=[schema.SpeedLevel(speed=fast, forward=0, backward=0, rmse=sigma)],
            parameters=[
                schema.Parameter(
                    name=n, value=float(v), std_error=float(e), unit=joint.unit(u)
                )
                for (n, u), v, e in zip(self.terms, values, errors, strict=True)
            ],
        )

    def _sensitivity(
        self, posterior: Posterior, solution: Solution
    ) -> dict[str, schema.Matrix]:
        """Return the change of the reported parameters per entry of each joint's friction.

        One least squares gives rigid body and friction correlated errors: what an
        offset has too much, gravity has too little. Their sum is known far better than
        either. With T the change, cov(theta, c) = T cov(c), as in the sequential stages
        (see `posterior`).
        """
        covariance = posterior.covariance
        own = np.flatnonzero(solution.determined[: self.basis.size])
        found = {}
        for j, name in enumerate(self.robot.joint_names):
            if not self.joints[j].samples:
                continue
            terms = self.own[j]
            crossed = covariance[own, terms] @ np.linalg.pinv(covariance[terms, terms])
            ahead, back = surface_entries(float(self.fastest[j]), len(self.terms))
            both = np.vstack([ahead, back]) if len(self.terms) == len(TERMS) else ahead
            entries = crossed @ np.linalg.pinv(both)
            # Beyond the identified range nothing is known, of parameters neither.
            beyond = EXTENSION_SIZE * len(both) // len(ahead)
            found[name] = np.pad(entries, ((0, 0), (0, beyond))).tolist()
        return found

    def _verdicts(
        self,
        solution: Solution,
        waving: Solution,
        floor: NoiseLevel,
        *,
        n_missing: int,
        settings: OneStepSettings,
    ) -> list[schema.Verdict]:
        """Judge each joint.

        It is poor by what is left of its torque, or where Coulomb friction is negative;
        usable where more than noise is left, or where friction waves over the position.
        """
        verdicts = joint_verdicts(
            self.robot,
            solution,
            self.joints,
            self.torque_squares,
            floor,
            poor_share=settings.poor_share,
            max_of_noise=settings.max_of_noise,
            idle="does not move",
        )
        for j, (joint, own) in enumerate(zip(self.robot.joints, self.own, strict=True)):
            dry, error = (
                solution.theta[own.start],
                np.sqrt(solution.covariance[(own.start,) * 2]),
            )
            if self.joints[j].samples and dry < -settings.negative_sigma * error:
                text = f"Coulomb friction of {dry:.3g} {joint.unit('N m')} cannot be"
                reason = f"{verdicts[j].reason}; {text}: record both ways"
                verdicts[j] = replace(
                    verdicts[j], good=False, level="poor", reason=reason
                )
            elif verdicts[j].good and (wave := self._wave(j, waving, settings)):
                reason = f"{verdicts[j].reason}; {wave}"
                verdicts[j] = replace(
                    verdicts[j], good=False, level="usable", reason=reason
                )
        reason = (
            f"condition {solution.condition:.3g}, {n_missing} parameter(s) not excited"
        )
        return [*verdicts, schema.Verdict(good=not n_missing, reason=reason)]

    def _wave(self, j: int, waving: Solution, settings: OneStepSettings) -> str:
        """Say how a joint's friction waves over the position, where that is certain and matters."""
        place = self.waves[j]
        wave = waving.theta[place]
        covariance = waving.covariance[place, place]
        certainty = float(np.sqrt(wave @ np.linalg.pinv(covariance) @ wave))
        coulomb = abs(float(waving.theta[self.own[j].start]))
        share = float(np.linalg.norm(wave)) / max(coulomb, 1e-12)
        if certainty < settings.wave_sigma or share < settings.wave_share:
            return ""
        return (
            f"its friction waves by {percent(share)} over the position, which Coulomb"
            " and viscous friction do not hold"
        )


def surface_entries(fastest: float, terms: int) -> tuple[Array, Array]:
    """Entries (2, terms) of a friction surface, ahead and back, per Coulomb, viscous and offset."""
    # Over [0, fastest] |v| = fastest (1 + T_1(u)) / 2; the offset has the sign of
    # motion taken off.
    ahead = np.array([[1.0, fastest / 2, 1.0], [0.0, fastest / 2, 0.0]])[:, :terms]
    return ahead, ahead * np.array([1.0, 1.0, -1.0])[:terms]
