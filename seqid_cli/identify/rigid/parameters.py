"""From a least-squares solution to a stage of the file; shared by gravity and inertia.

Also which pairs of joints must move together to determine what is still open (Sec.
2.2.4), and physical consistency as a constraint. Least squares does not know that
masses are positive. Of all models that bodies with positive density and rotors of
positive inertia can have, the constrained one is the nearest to the unconstrained in
units of its covariance, which is the maximum of the posterior under the constraint (see
`model.bodies.consistent`).
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.regression.least_squares import Accumulator, Solution
from seqid_cli.identify.regression.noise_level import NoiseLevel
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.model.bodies.nearest import identified, nearest_bodies
from seqid_cli.params.schema import Level, Parameter, RigidStage, Stages, Verdict
from seqid_cli.robot.base_parameters import Basis, base_regressor, standard_names
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index

NO_TORQUE = "its torque is zero in all rows: nothing is known of it"


def parameters_of(
    robot: Robot, basis: Basis, chosen: Index, theta: Array, covariance: Array
) -> list[Parameter]:
    """Return the `chosen` parameters, with standard errors, units, expressions.

    They are chosen by their places.
    """
    parameters = []
    for place in chosen:
        k = int(place)
        parameters.append(
            Parameter(
                name=basis.names[k],
                value=float(theta[k]),
                std_error=float(np.sqrt(max(covariance[k, k], 0.0))),
                unit=basis.unit(k),
                joint=robot.joint_names[basis.joint_index(k)],
                expression=basis.expression_text(k),
                terms=basis.terms(k),
            )
        )
    return parameters


def representative_of(basis: Basis, theta: Array, rotors: Array) -> dict[str, float]:
    """Return standard parameters that give the model's torque, known rotors included.

    Zeros are left out.
    """
    phi = basis.representative @ theta
    phi[len(phi) - len(rotors) :] += rotors
    return _named(phi, len(rotors))


def _named(phi: Array, n: int) -> dict[str, float]:
    """Return standard parameters (11 n,) by name, zeros left out."""
    return {
        name: float(x)
        for name, x in zip(standard_names(n), phi, strict=True)
        if x != 0.0
    }


def rigid_stage(
    robot: Robot,
    basis: Basis,
    solution: Solution,
    posterior: Posterior,
    chosen: Index,
    rotors: Array,
) -> RigidStage:
    """Return what a solution tells of some parameters.

    Parameters
    ----------
    robot : Robot
    basis : Basis
        Of b base parameters.
    solution : Solution
        Of the first b parameters at least, where the stage has that many.
    posterior : Posterior
        With everything that widens the solution's errors.
    chosen : array of int
        Places of the parameters that the stage is about.
    rotors : (n,) array
        Known rotor inertias [kg m^2], which join the representative.
    """
    is_determined = solution.determined[chosen]
    determined = chosen[is_determined]
    missing = [basis.expression_text(int(k)) for k in chosen[~is_determined]]
    notes = []
    if missing:
        notes.append("not excited by these logs: " + "; ".join(missing))

    theta = np.zeros(basis.size)
    theta[: min(len(solution.theta), basis.size)] = solution.theta[: basis.size]
    names = robot.joint_names
    friction = posterior.friction
    return RigidStage(
        parameters=parameters_of(robot, basis, determined, theta, posterior.stated),
        condition=solution.condition,
        rank=solution.rank,
        structural_rank=basis.size,
        representative=representative_of(basis, theta, rotors),
        covariance=posterior.covariance[np.ix_(determined, determined)].tolist(),
        friction_sensitivity={
            name: friction[j][determined].tolist() if j in friction else []
            for j, name in enumerate(names)
        },
        torque_constant_moves={
            names[j]: move[determined].tolist()
            for j, move in posterior.constants.items()
        },
        tolerance_moves={
            name: move[determined].tolist()
            for name, move in posterior.tolerances.items()
        },
        not_excited=missing,
        notes=notes,
    )


def made_consistent(
    stage: RigidStage, stages: Stages, robot: Robot, *, min_move: float = 0.5
) -> RigidStage:
    """Put the parameters of an inertia stage among those that bodies can have."""
    # Standard errors stay the unconstrained ones. A note names what moved by `min_move`
    # of them.
    unconstrained = identified(Stages(gravity=stages.gravity, inertia=stage), robot)
    nearest = nearest_bodies(robot, unconstrained)
    deviations = unconstrained.deviations(nearest.links, nearest.rotor)
    moved = {deviation.name: deviation for deviation in deviations}
    parameters = [
        replace(p, value=moved[p.name].exported) if p.name in moved else p
        for p in stage.parameters
    ]
    phi = _named(np.concatenate([nearest.links.ravel(), nearest.rotor]), robot.n)
    note = "physically consistent as identified: bodies with these parameters exist"
    if not nearest.exact:
        named = []
        for name, deviation in moved.items():
            n_errors = deviation.std_errors or 0.0
            if abs(n_errors) >= min_move:
                named.append(f"{name} by {n_errors:+.1f}")
        text = ", ".join(named) or f"none by more than {min_move:g}"
        note = f"made physically consistent; moved, in standard errors: {text}"
    return replace(
        stage, parameters=parameters, representative=phi, notes=[*stage.notes, note]
    )


def joint_verdicts(
    robot: Robot,
    solution: Solution,
    joints: Sequence[Accumulator],
    squares: Array,
    noise: NoiseLevel,
    *,
    poor_share: float,
    max_of_noise: float,
    idle: str,
) -> list[Verdict]:
    """Judge each joint by what is left of its torque.

    Parameters
    ----------
    robot : Robot
    solution : Solution
        With the RMS residual of each joint.
    joints : sequence of Accumulator
        The joints' rows.
    squares : (n,) array
        Sums of the squared torque of the rows [(N m)^2].
    noise : NoiseLevel
        What noise alone would leave.
    poor_share : float
        Of the torque's RMS, from which a joint is poor if it is left.
    max_of_noise : float
        Times the upper end of the noise's interval that may be left: the end scatters
        too.
    idle : str
        Why a joint has no rows.

    Returns
    -------
    list of Verdict
        Good where noise is left, usable where more is but less than `poor_share`.
    """
    times_noise = noise.times(solution.sigma)
    verdicts = []
    for j, (joint, rows) in enumerate(zip(robot.joints, joints, strict=True)):
        if not rows.samples:
            verdicts.append(Verdict(joint=joint.name, good=False, reason=idle))
            continue
        residual_rms = float(solution.sigma[j])
        torque_rms = float(np.sqrt(squares[j] / rows.samples))
        if torque_rms == 0.0:
            verdicts.append(Verdict(joint=joint.name, good=False, reason=NO_TORQUE))
            continue
        share = residual_rms / torque_rms
        unit = joint.unit("N m")
        reason = f"leaves {percent(share)} of the torque ({residual_rms:.3g} {unit})"
        if noise.high[j] > 0.0:
            reason += f", noise up to {noise.high[j]:.3g} {unit}"
        level: Level = "good"
        if share >= poor_share:
            level = "poor"
        elif times_noise[j] > max_of_noise:
            level = "usable"
            reason += f": {times_noise[j]:.2g} times that, so something is missing"
        verdicts.append(
            Verdict(joint=joint.name, good=level == "good", level=level, reason=reason)
        )
    return verdicts


def imu_moves(
    robot: Robot,
    basis: Basis,
    inertia: Array,
    reflected: Array,
    errors: Mapping[str, float],
) -> Array:
    """Return moves (b, d) of parameters by IMUs' errors, one deviation a column.

    Accelerations that a calibration takes for too large by a share leave inertias too
    small by as much: those of the links between the IMU before and its own. A known
    rotor's share of it comes upon the inertia about the joint that it turns.

    Parameters
    ----------
    robot : Robot
    basis : Basis
    inertia : (b,) array
        Base parameters, zero where accelerations do not show them.
    reflected : (n,) array
        Known rotor inertias at the joints [kg m^2].
    errors : mapping of str to float
        Relative standard errors of the accelerations by the IMUs that took part.
    """
    links = np.array([basis.joint_index(k) for k in range(basis.size)], dtype=int)
    turns_rotor = np.array([name.startswith("Izz_") for name in basis.names])
    accelerated = inertia + np.where(turns_rotor, reflected[links], 0.0)
    moves = []
    first_link = 0
    for imu in sorted(robot.imus, key=lambda imu: imu.after_joint):
        if imu.name in errors:
            measured = (links >= first_link) & (links <= imu.after_joint)
            moves.append(np.where(measured, errors[imu.name] * accelerated, 0.0))
            first_link = imu.after_joint + 1
    return np.column_stack(moves) if moves else np.zeros((basis.size, 0))


def missing_pairs(
    robot: Robot, basis: Basis, left_open: Array, *, states: int = 120
) -> list[list[str]]:
    """Choose pairs of joints that show what is left open when they move together.

    Pairs are chosen greedily until all base parameters are seen; those that others make
    idle are dropped. An arm of one joint has that alone.

    Parameters
    ----------
    robot : Robot
    basis : Basis
        Of b base parameters.
    left_open : (b, k) array
        Directions along which nothing is known.
    states : int
        Random states of two moving joints, the others at random angles, by which a
        pair is judged.

    Returns
    -------
    list of lists of str
        Names of joints; empty where no pair would add anything.
    """
    regressors: dict[tuple[int, int], Array] = {}
    for pair in list(combinations(range(robot.n), 2)) or [(0, 0)]:
        rng = np.random.default_rng(0)
        moving = list(pair)
        q = rng.uniform(-2.5, 2.5, (states, robot.n))
        dq = np.zeros_like(q)
        dq[:, moving] = rng.normal(size=(states, 2))
        ddq = np.zeros_like(q)
        ddq[:, moving] = 3 * rng.normal(size=(states, 2))
        H = base_regressor(robot, basis, q, dq, ddq)[:, moving]
        regressors[pair] = H.reshape(-1, basis.size)
    norms = [np.linalg.norm(H, axis=0) for H in regressors.values()]
    scale = np.max(norms, axis=0)
    scale = np.where(scale > 0, scale, 1.0)

    all_open = np.asarray(np.linalg.qr(scale[:, None] * left_open)[0])
    still_open = all_open
    chosen: list[tuple[int, int]] = []
    while still_open.shape[1]:
        open_with = {
            pair: _still_open(H / scale, still_open) for pair, H in regressors.items()
        }
        best = min(open_with, key=lambda pair: open_with[pair].shape[1])
        if open_with[best].shape[1] == still_open.shape[1]:
            break
        chosen.append(best)
        still_open = open_with[best]

    for pair in list(chosen):
        without_pair = [
            regressors[kept_pair] / scale for kept_pair in chosen if kept_pair != pair
        ]
        if not without_pair:
            continue
        open_without = _still_open(np.vstack(without_pair), all_open)
        if open_without.shape[1] <= still_open.shape[1]:
            chosen.remove(pair)
    return [[robot.joint_names[j] for j in dict.fromkeys(pair)] for pair in chosen]


def _still_open(H: Array, directions: Array, *, min_share: float = 1e-6) -> Array:
    """Return the part of orthonormal `directions` (b, k) that rows H (N, b) miss."""
    # Singular values below `min_share` of the largest are rounding.
    _, s, Vt = np.linalg.svd(H @ directions, full_matrices=True)
    rank = int(np.sum(s > min_share * float(np.linalg.norm(H, 2))))
    return np.asarray(directions @ Vt[rank:].T)
