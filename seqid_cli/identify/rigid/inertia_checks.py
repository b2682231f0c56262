"""What the inertia of no arm can be: checks of the inertia stage's result.

Rotors and the inertia that each drive feels are positive, and gravity in the logs of
this stage is the gravity stage's. The result of `simultaneous` is judged alike.
"""

from collections.abc import Iterator

import numpy as np

from seqid_cli.identify.gravity_comparison import (
    POSTURES,
    gravity_of_stage,
    verdicts_by_nominal,
    verdicts_by_stage,
)
from seqid_cli.identify.regression.noise_level import postures
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.model.torque import standard_parameters
from seqid_cli.params.schema import Parameter, RigidStage, Verdict
from seqid_cli.robot.base_parameters import free_basis, standard_regressor
from seqid_cli.robot.types import Robot

IN_LOGS = (
    "gravity in these logs differs from the gravity stage's by {} of it, it is {:.2g}"
    " times that. Check that the logs are of one robot, in one unit and with the joints"
    " in order"
)


def inertia_verdicts(
    stage: RigidStage,
    gravity: RigidStage | None,
    robot: Robot,
    settings: JudgingSettings = JudgingSettings(),
) -> Iterator[Verdict]:
    """Yield the joints whose rotor, inertia or gravity cannot be.

    Parameters
    ----------
    stage : RigidStage
        The inertia stage.
    gravity : RigidStage or None
        The gravity stage that it builds on.
    robot : Robot
    settings : JudgingSettings
    """
    if not stage.parameters:
        return
    for parameter in stage.parameters:
        if _is_negative_rotor(parameter, settings):
            reason = (
                f"{parameter.name} is {parameter.value:.3g} +-"
                f" {parameter.std_error:.2g}: a rotor cannot have negative inertia."
                " Where the torque is of a sensor behind the gear, write torque_side ="
                ' "link" at the top of the robot file'
            )
            yield Verdict(joint=parameter.joint, good=False, reason=reason)
    yield from _negative_inertias(stage, robot, settings)

    # Of a joint that stands no gravity is identified.
    in_logs = {
        j: torque
        for j, torque in gravity_of_stage(stage, robot).items()
        if not stage.rmse or robot.joint_names[j] in stage.rmse
    }
    if gravity is not None and gravity.parameters:
        yield from verdicts_by_stage(in_logs, robot, gravity, IN_LOGS, settings)
    yield from verdicts_by_nominal(in_logs, robot, settings)


def _is_negative_rotor(parameter: Parameter, settings: JudgingSettings) -> bool:
    """Return whether a parameter is of rotors alone, and certainly negative."""
    is_rotor = parameter.terms and all(
        factor > 0.0 and name.startswith("Ia_")
        for name, factor in parameter.terms.items()
    )
    least = -settings.clear_sigma * parameter.uncertainty
    return bool(is_rotor) and parameter.value < least


def _negative_inertias(
    stage: RigidStage, robot: Robot, settings: JudgingSettings
) -> Iterator[Verdict]:
    """Yield the joints whose drive would feel a negative inertia M_jj.

    It is that of the stage's parameters, with their errors. Stages whose parameters are
    not of this robot's basis, or without a covariance, are not looked at.
    """
    basis = free_basis(robot)
    places = [
        basis.names.index(parameter.name)
        for parameter in stage.parameters
        if parameter.name in basis.names
    ]
    count = len(stage.parameters)
    if len(places) != count or np.shape(stage.covariance) != (count, count):
        return

    links, rotors = standard_parameters(stage, robot.n)
    standard = np.concatenate([links.ravel(), rotors])
    q = postures(robot, count=POSTURES)
    still = np.zeros_like(q)
    at_rest = standard_regressor(robot, q, still, still, coupling="diagonal")
    for j, name in enumerate(robot.joint_names):
        if stage.rmse and name not in stage.rmse:
            continue
        ddq = np.zeros_like(q)
        ddq[:, j] = 1.0
        pushed = standard_regressor(robot, q, still, ddq, coupling="diagonal")
        H = pushed[:, j] - at_rest[:, j]
        inertia = H @ standard
        columns = H @ basis.representative[:, places]
        variance = np.sum((columns @ np.array(stage.covariance)) * columns, axis=1)
        error = settings.clear_sigma * np.sqrt(np.maximum(variance, 0.0))

        worst = int(np.argmax(inertia + error))
        if inertia[worst] < -error[worst]:  # in every posture
            reason = (
                f"the inertia that its drive feels is at most {inertia[worst]:.3g} +-"
                f" {error[worst] / settings.clear_sigma:.2g}: it cannot be negative."
                " Check sign and unit of the torque, torque_constant, gear_ratio and"
                " rotor_inertia"
            )
            yield Verdict(joint=name, good=False, reason=reason)
