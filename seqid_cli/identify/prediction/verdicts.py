"""Whether a prediction can be relied on, joint by joint.

`poor`: the model has no friction or inertia for the joint, or its error is too large.
`usable`: the torque is predicted, but the error is larger than the noise, or than the
file states. `good`: neither.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

from seqid_cli.identify.bands.coverage import clearly_below
from seqid_cli.identify.settings import PredictionErrorSettings
from seqid_cli.model.torque import friction_surfaces
from seqid_cli.params.results.prediction import JointError
from seqid_cli.params.schema import Stages, Verdict
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent


def noise_floors(stages: Stages, cutoffs_hz: Sequence[float]) -> dict[str, float]:
    """Return the largest RMS error [N m] of each joint that noise explains.

    The inertia stage states it at its own cut-off. The power of white noise is
    proportional to the cut-off, so it is scaled for logs with a higher one.

    Parameters
    ----------
    stages : Stages
        The model.
    cutoffs_hz : sequence of float
        Cut-offs of the predicted logs [Hz].
    """
    stage = stages.inertia
    if stage is None or not stage.cutoff_hz or not cutoffs_hz:
        return {}
    growth = max(1.0, max(cutoffs_hz) / stage.cutoff_hz) ** 0.5
    return {name: growth * highest for name, highest in stage.noise_floor_high.items()}


def joint_verdicts(
    joints: Mapping[str, JointError],
    stages: Stages,
    robot: Robot,
    *,
    noise_floors: Mapping[str, float] = {},
    settings: PredictionErrorSettings = PredictionErrorSettings(),
) -> Iterator[Verdict]:
    """Yield the verdict on every joint that slides.

    Parameters
    ----------
    joints : mapping of str to JointError
        Errors of all logs together.
    stages : Stages
        The model.
    robot : Robot
        The robot.
    noise_floors : mapping of str to float
        Largest RMS error by noise alone [N m], for joints with such a statement.
    settings : PredictionErrorSettings
        Which errors are too large to rely on the prediction, and how often its bands
        must hold.

    Yields
    ------
    Verdict
        `poor`, `usable` or `good`, with the reason.
    """
    max_relative_rmse = settings.max_relative_rmse
    surfaces = friction_surfaces(stages, robot)
    without_inertia = stages.inertia is None and not free_basis(robot).gravity.all()
    calibrated = stages.inertia is not None and stages.inertia.bands is not None

    for joint, surface in zip(robot.joints, surfaces, strict=True):
        error = joints[joint.name]
        if not error.samples:
            continue
        unit = joint.unit("N m")
        relative_rmse = error.relative_rmse
        stated = "-" if relative_rmse is None else percent(relative_rmse)

        faults = []
        if surface is None:
            faults.append("the file holds no friction of this joint")
        if without_inertia:
            faults.append("the file holds no inertia stage")
        if relative_rmse is None or relative_rmse > max_relative_rmse:
            faults.append(
                f"the error is {stated} of the torque's RMS, above"
                f" {percent(max_relative_rmse)}"
            )
        if faults:
            yield Verdict(joint=joint.name, good=False, reason="; ".join(faults))
            continue

        doubts = []
        if joint.name in noise_floors and error.rmse is not None:
            # A new motion shows errors of the parameters that the fitted logs do not.
            expected = math.hypot(noise_floors[joint.name], error.parameter_std or 0.0)
            if error.rmse > expected:
                doubts.append(
                    f"predicted to {stated} of the torque's RMS, but {error.rmse:.3g}"
                    f" {unit} are left where noise and stated errors leave at most"
                    f" {expected:.3g}"
                )

        overall = error.coverage.overall if error.coverage is not None else None
        if (
            calibrated
            and overall is not None
            and clearly_below(overall, least_share=settings.min_band_share)
        ):
            assert overall.band_90 is not None
            doubts.append(
                f"predicted to {stated} of the torque's RMS, but the 90 % band holds in"
                f" {percent(overall.band_90, 0)} of the samples only: these logs are"
                " not of the kind that the file was identified from"
            )

        yield Verdict(
            joint=joint.name,
            good=not doubts,
            level="usable" if doubts else "good",
            reason="; ".join(doubts),
        )
