"""The classical way (Eq. 5-6): rigid body and friction in one least squares.

    tau = H(q, dq, ddq) pi + F_c sign(dq) + F_v dq + F_o

for comparison with the sequential way, and for logs that hold no single-joint trials.
F_o is a constant torque per joint, as a current sensor's zero or a warm drive leaves
it. Without it, base parameters stand in for it and are wrong beyond their errors. The
delay of each joint's torque is unknown as well (`identify.nuisances`). It stands in the
file, as the parameters were found beside it, and is never reported: beside this law of
friction it takes what friction is otherwise. The result is written as a friction stage
of orders (0, 1) and an inertia stage with all base parameters, for every later command.

Friction of most gears waves over the position,

    sign(dq) (a cos(q) + b sin(q)),

which this law does not hold and base parameters take, up to many of their errors'
worth. So the same equations are solved once more with a and b unknown, 0 +- 0.1 F_c.
Where they show, the stage is usable, not good. What they change in the rigid body's
parameters counts as an error of these, and their size as the error of the law of
friction (`law_error`). Neither counts in predicted torques, which hold the same law.
"""

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from msgspec.structs import replace as replace_fields

from seqid_cli.errors import QualityError
from seqid_cli.identify.bands.calibrate import calibrate
from seqid_cli.identify.bands.left_out import Fit
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.least_squares import Solution
from seqid_cli.identify.regression.noise_level import (
    LogNoise,
    NoiseLevel,
    noise_of_log,
    noise_of_rows,
)
from seqid_cli.identify.rigid.log_agreement import agreement_verdicts, log_equations
from seqid_cli.identify.rigid.parameters import joint_verdicts, rigid_stage
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.identify.rigid.simultaneous_equations import (
    FRICTION_TERMS,
    SIGN_SHARE,
    WAVE_TERMS,
    SimultaneousEquations,
    surface_entries,
)
from seqid_cli.identify.settings import OneStepSettings, SimultaneousSettings
from seqid_cli.identify.tolerances import constants_note
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import EXTENSION_SIZE, SLIDES
from seqid_cli.model.torque import known_rotors, sliding
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params import schema
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array

# Name of what a wave of friction moves the parameters by, beside the tolerances of the
# robot file: the values are as wrong, predicted torques are not.
WAVES = "waves of friction"


def identify_simultaneous(
    recordings: Iterable[Recording],
    robot: Robot,
    *,
    options: MotionOptions,
    offset: bool = True,
    imu: schema.ImuStage | None = None,
    source: str = "auto",
    source_by_log: Mapping[str, str] | None = None,
    settings: SimultaneousSettings = SimultaneousSettings(),
) -> tuple[schema.FrictionStage, schema.RigidStage]:
    """Identify rigid body and Coulomb-viscous friction together.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs of any motion, read one after the other.
    robot : Robot
    options : MotionOptions
        Cut-off of the low-pass.
    offset : bool
        Whether each joint has a constant torque F_o.
    imu : ImuStage, optional
        Calibrated IMUs, for motion that is fused.
    source : str
        Whose motion counts: "auto", "encoder", "fused", "imu".
    source_by_log : mapping of str to str, optional
        The same of logs that have one of their own, by their SHA-256.
    settings : SimultaneousSettings

    Returns
    -------
    friction : FrictionStage
        Surfaces of orders (0, 1).
    inertia : RigidStage
        All base parameters.

    Raises
    ------
    QualityError
        Where no joint moves.
    """
    motions = []
    uses = []
    noise = []
    for recording in recordings:
        motion = equations.torque_motion(
            recording,
            robot,
            options,
            imu=imu,
            source=(source_by_log or {}).get(recording.sha256, source),
        )
        motions.append(deepcopy(motion))  # without the samples that it was thinned from
        uses.append(equations.motion_use(recording.path, robot, motion))
        fastest = np.abs(np.where(motion.moving, motion.dq, 0.0)).max(axis=0)
        slides = sliding(motion, SLIDES * SIGN_SHARE * fastest)
        noise.append(noise_of_log(recording, motion, slides))

    rows = SimultaneousEquations(robot, motions, offset=offset) if motions else None
    if rows is None or not any(joint.samples for joint in rows.joints):
        raise QualityError(
            "no joint moves in these logs", hint="record moves of every joint"
        )
    return OneStepResult.of(rows, uses, noise, options, settings).stages()


@dataclass(frozen=True, kw_only=True)
class OneStepResult:
    """The solution of one least squares, on its way into the stages of a file.

    `waving` is the solution beside waves of friction, `posterior` holds what they move
    the parameters by. `uses` and `noise` are of the logs.
    """

    rows: SimultaneousEquations
    solution: Solution
    waving: Solution
    posterior: Posterior
    uses: Sequence[schema.MotionUse]
    noise: Sequence[LogNoise]
    options: MotionOptions
    settings: SimultaneousSettings

    @classmethod
    def of(
        cls,
        rows: SimultaneousEquations,
        uses: Sequence[schema.MotionUse],
        noise: Sequence[LogNoise],
        options: MotionOptions,
        settings: SimultaneousSettings,
    ) -> "OneStepResult":
        """Solve the equations."""
        prior = rows.prior()
        solution = rows.solved(prior)
        waving = rows.with_waves(solution)
        # Torque of known rotors is computed, not measured: it does not scale with
        # torque constants.
        by_rotors = {
            j: -rows.independent * solution.bread @ sums / solution.sigma[j] ** 2
            for j, sums in enumerate(rows.rotor_sums)
        }
        posterior = Posterior.of(
            solution, (), rows.robot.torque_constant_errors, {}, by_rotors, prior
        )
        return cls(
            rows=rows,
            solution=solution,
            waving=waving,
            posterior=posterior,
            uses=uses,
            noise=noise,
            options=options,
            settings=settings,
        )

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.rows.robot

    @property
    def moved_joints(self) -> list[int]:
        """Joints of which there are rows."""
        return [j for j in range(self.robot.n) if self.rows.joints[j].samples]

    @property
    def cutoff_hz(self) -> float:
        """Median cut-off [Hz] of the logs."""
        return float(np.median([use.cutoff_hz for use in self.uses]))

    def stages(self) -> tuple[schema.FrictionStage, schema.RigidStage]:
        """Return the friction and the inertia stage, with bands of predictions."""
        friction = self._friction_stage()
        inertia = self._inertia_stage()
        fit = Fit(
            theta=self.solution.theta,
            bread=self.solution.bread,
            sigma=self.solution.sigma,
            independent=self.rows.independent,
            predicting=self.rows.delays.stop,
        )
        model = schema.Stages(friction=friction, inertia=inertia)
        bands = calibrate(
            self.rows.band_rows, fit, model, self.robot, cutoff_hz=self.cutoff_hz
        )
        return friction, replace_fields(inertia, bands=bands)

    def _friction_stage(self) -> schema.FrictionStage:
        names = [name for name, _ in self.rows.terms]
        listed = ", ".join(names[:-1]) + f" and {names[-1]}"
        note = (
            f"friction ({listed}) from one least squares with the rigid body (Eq. 5-6)"
        )
        return schema.FrictionStage(
            joints={
                self.robot.joint_names[j]: self._friction_joint(j)
                for j in self.moved_joints
            },
            method="simultaneous",
            cutoff_hz=self.cutoff_hz,
            notes=[
                note,
                equations.cutoff_note(list(self.uses), self.options),
                *constants_note(self.robot),
            ],
        )

    def _friction_joint(self, j: int) -> schema.FrictionJoint:
        """Return one joint's friction as a surface, tau_f = s(v) (c_0 + c_1 T_1(u))."""
        rows = self.rows
        joint = self.robot.joints[j]
        places = rows.friction[j]
        values = self.solution.theta[places]
        sigma = float(self.solution.sigma[j])
        fastest = float(rows.fastest[j])

        covariance = self.solution.covariance[places, places]
        # Not of waves: a diagnosis starts from these errors, of this very law.
        std_errors = np.sqrt(np.maximum(np.diag(self.posterior.stated)[places], 0.0))
        std_errors[~self.solution.determined[places]] = schema.UNDETERMINED_STD_ERROR

        ahead, back = surface_entries(fastest, len(rows.terms))
        directional = len(rows.terms) == len(FRICTION_TERMS)
        entries = np.vstack([ahead, back]) if directional else ahead
        level = schema.SpeedLevel(speed=fastest, forward=0, backward=0, rmse=sigma)
        return schema.FrictionJoint(
            unit=joint.unit("N m"),
            position_order=0,
            velocity_order=1,
            # of Coulomb friction
            max_error=sigma / max(float(np.abs(values[0])), 1e-12),
            rmse=sigma,
            position_range=[float(rows.low[j]), float(rows.high[j])],
            speed_range=[0.0, fastest],
            sign_width=max(float(rows.width[j]), 1e-6),
            directional=directional,
            positive=[(ahead @ values).tolist()],
            negative=[(back @ values).tolist()],
            covariance=(entries @ covariance @ entries.T).tolist(),
            torque_constant_error=joint.torque_constant_error,
            law_error=self._wave_rms(j),
            nuisances=[self._delay(j)],
            term_moves={"delay": (entries @ self._moves_by_delay(j)).tolist()},
            speeds=[level],
            parameters=[
                schema.Parameter(
                    name=name,
                    value=float(value),
                    std_error=float(std_error),
                    unit=joint.unit(unit),
                )
                for (name, unit), value, std_error in zip(
                    rows.terms, values, std_errors, strict=True
                )
            ],
        )

    def _delay(self, j: int) -> schema.Nuisance:
        """Return the delay of a joint's torque [s], which the fit was made beside."""
        place = self.rows.delays.start + j
        return schema.Nuisance(
            name="delay",
            joint=self.robot.joint_names[j],
            value=float(self.solution.theta[place]),
            std_error=float(np.sqrt(self.solution.covariance[place, place])),
            unit="s",
        )

    def _moves_by_delay(self, j: int) -> Array:
        """Return what a joint's friction (terms,) would be more per second of delay."""
        covariance = self.solution.covariance
        place = self.rows.delays.start + j
        return np.asarray(
            covariance[self.rows.friction[j], place] / covariance[place, place]
        )

    def _inertia_stage(self) -> schema.RigidStage:
        rows = self.rows
        robot = self.robot
        solution = self.solution
        moved_by_waves = self.waving.theta - solution.theta
        stage = rigid_stage(
            robot,
            rows.basis,
            solution,
            replace(self.posterior, tolerances={WAVES: moved_by_waves}),
            np.arange(rows.basis.size),
            known_rotors(robot),
        )
        floor = noise_of_rows(
            stage,
            robot,
            uses=list(self.uses),
            logs=self.noise,
            joints=rows.joints,
            torque_squares=rows.torque_squares,
        )
        with_floor = [
            (name, j) for j, name in enumerate(robot.joint_names) if floor.high[j]
        ]
        moved = {
            name: j
            for j, name in enumerate(robot.joint_names)
            if rows.joints[j].samples
        }
        n_friction = len(rows.terms) * len(self.moved_joints)
        return replace_fields(
            stage,
            noise_floor={name: float(floor.rms[j]) for name, j in with_floor},
            noise_floor_high={name: float(floor.high[j]) for name, j in with_floor},
            rank=solution.rank - n_friction,
            friction_sensitivity=self._friction_sensitivity(),
            rmse={name: float(solution.sigma[j]) for name, j in moved.items()},
            method="simultaneous",
            motion={use.log: equations.source_text(use) for use in self.uses},
            motion_use=list(self.uses),
            cutoff_hz=self.cutoff_hz,
            verdicts=[
                *self._joint_verdicts(floor, n_missing=len(stage.not_excited)),
                *agreement_verdicts(
                    log_equations([use.log for use in self.uses], rows.logs),
                    robot,
                    solution.sigma,
                    rows.torque_squares,
                    rows.basis.size,
                    self.settings.agreement,
                    independent=rows.independent,
                ),
            ],
            notes=[*stage.notes, *self._offset_notes()],
        )

    def _offset_notes(self) -> list[str]:
        """Return a note on joints whose offset resembles other torques too much."""
        names = [
            self.robot.joint_names[j]
            for j in self.moved_joints
            if not self.solution.determined[self.rows.friction[j]][2:].all()
        ]
        if not names:
            return []
        return [
            f"the offset of {', '.join(names)} is not told apart from other torques:"
            " record wider moves, or leave offsets out (--no-offset)"
        ]

    def _friction_sensitivity(self) -> dict[str, schema.Matrix]:
        """Return changes of the reported parameters per entry of joints' friction.

        One least squares gives rigid body and friction correlated errors: what an
        offset has too much, gravity has too little. Their sum is known far better than
        either. With T the change, cov(theta, c) = T cov(c), as in the sequential stages
        (see `posterior`).
        """
        rows = self.rows
        covariance = self.posterior.covariance
        determined = np.flatnonzero(self.solution.determined[: rows.basis.size])
        n_terms = len(rows.terms)
        sensitivity = {}
        for j in self.moved_joints:
            places = rows.friction[j]
            per_term = covariance[determined, places] @ np.linalg.pinv(
                covariance[places, places]
            )
            ahead, back = surface_entries(float(rows.fastest[j]), n_terms)
            entries = ahead
            if n_terms == len(FRICTION_TERMS):
                entries = np.vstack([ahead, back])
            per_entry = per_term @ np.linalg.pinv(entries)
            # Beyond the identified range nothing is known, of parameters neither.
            beyond = EXTENSION_SIZE * len(entries) // len(ahead)
            padded = np.pad(per_entry, ((0, 0), (0, beyond)))
            sensitivity[self.robot.joint_names[j]] = padded.tolist()
        return sensitivity

    def _joint_verdicts(
        self, floor: NoiseLevel, *, n_missing: int
    ) -> list[schema.Verdict]:
        """Judge each joint, and the whole by the parameters that are not excited.

        A joint is poor by what is left of its torque, or where Coulomb friction is
        negative; usable where more than noise is left, or where friction waves over the
        position.
        """
        rows = self.rows
        solution = self.solution
        settings = self.settings.residual
        verdicts = joint_verdicts(
            self.robot,
            solution,
            rows.joints,
            rows.torque_squares,
            floor,
            poor_share=settings.poor_share,
            max_of_noise=settings.max_of_noise,
            idle="does not move",
        )
        for j, joint in enumerate(self.robot.joints):
            place = rows.friction[j].start
            coulomb = float(solution.theta[place])
            std_error = float(np.sqrt(solution.covariance[place, place]))
            if rows.joints[j].samples and (
                coulomb < -settings.negative_sigma * std_error
            ):
                verdicts[j] = _worse(
                    verdicts[j],
                    "poor",
                    f"Coulomb friction of {coulomb:.3g} {joint.unit('N m')} cannot be:"
                    " record both ways",
                )
                continue
            wave = self._wave(j, settings) if verdicts[j].good else ""
            if wave:
                verdicts[j] = _worse(verdicts[j], "usable", wave)
        reason = (
            f"condition {solution.condition:.3g}, {n_missing} parameter(s) not excited"
        )
        if n_missing == self.rows.basis.size:
            reason = (
                "no parameter is excited: these logs are too short, or joints move too"
                " little in them"
            )
        return [*verdicts, schema.Verdict(good=not n_missing, reason=reason)]

    def _wave_rms(self, j: int) -> float:
        """Return the expected RMS [N m] of a joint's friction wave over a whole turn.

        What the logs do not tell of it is what they leave of its prior.
        """
        places = self.rows.waves[j]
        wave = self.waving.theta[places]
        variance = float(np.trace(self.waving.covariance[places, places]))
        return float(np.sqrt((wave @ wave + variance) / WAVE_TERMS))

    def _wave(self, j: int, settings: OneStepSettings) -> str:
        """Describe a joint's friction wave over q, where it is certain and matters."""
        places = self.rows.waves[j]
        wave = self.waving.theta[places]
        covariance = self.waving.covariance[places, places]
        n_sigma = float(np.sqrt(wave @ np.linalg.pinv(covariance) @ wave))
        coulomb = abs(float(self.waving.theta[self.rows.friction[j].start]))
        share = float(np.linalg.norm(wave)) / max(coulomb, 1e-12)
        if n_sigma < settings.wave_sigma or share < settings.wave_share:
            return ""
        return (
            f"its friction waves by {percent(share)} over the position, which Coulomb"
            " and viscous friction do not hold"
        )


def _worse(verdict: schema.Verdict, level: schema.Level, reason: str) -> schema.Verdict:
    """Return the verdict at a lower level, with one reason more."""
    return replace_fields(
        verdict, good=False, level=level, reason=f"{verdict.reason}; {reason}"
    )
