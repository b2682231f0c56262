"""The function `payload`: logs and a model without the load in, the document out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from seqid_cli.errors import ConfigError
from seqid_cli.identify.inputs import Inputs, Models, imu_stage_for, prepare
from seqid_cli.identify.options import Keywords, documented
from seqid_cli.logs.given import Logs, PathLike
from seqid_cli.params.document import present
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.payload.options import PayloadOptions
from seqid_cli.payload.settings import PayloadSettings

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot


@documented(Keywords)
def payload(
    logs: Logs,
    robot: PathLike | Robot,
    parameters: Models,
    options: PayloadOptions = PayloadOptions(),
    *,
    settings: PayloadSettings = PayloadSettings(),
    **keywords: Unpack[Keywords],
) -> PayloadFile:
    """Identify the body that the last link carries.

    Parameters
    ----------
    logs : path, table, recording, or a sequence of them
        Moves with the payload; those of the last joints against gravity tell most.
    parameters : path or ParameterFile, or a sequence of them
        The model without the payload.
    """
    needs = imu_stage_for(options.source)
    inputs = prepare(logs, robot, parameters, options, needs=needs, **keywords)
    _check_rigid_body(inputs)

    # Imported here because they import numpy: a mistake in the arguments is told first.
    from seqid_cli.identify.common_cutoff import inherited
    from seqid_cli.identify.log_set import LogSet
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.payload.body import carried_body
    from seqid_cli.payload.fit import fit_payload
    from seqid_cli.payload.result import payload_file
    from seqid_cli.payload.verdicts import judged

    # The logs are filtered as those of the model were, so that both see the same band.
    log_set = LogSet.of(inputs)
    motion_options = inherited(inputs.stages, options.cutoff_hz)
    fit = fit_payload(
        log_set,
        inputs.robot,
        inputs.stages,
        options=InertiaOptions(motion=motion_options, source=options.source),
        friction_change=options.friction_change,
    )
    names = inputs.robot.joint_names
    body = carried_body(fit, names[-1])
    judgement = judged(
        fit, body, names, good_error=options.good_error, limits=settings.fit
    )

    file = payload_file(
        fit,
        body,
        judgement,
        inputs,
        log_set,
        cutoff_origin=motion_options.origin,
        settings=settings,
    )
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file


def _check_rigid_body(inputs: Inputs) -> None:
    """Raise ConfigError where the parameter files hold neither gravity nor inertia."""
    if {"gravity", "inertia"} & present(inputs.stages).keys():
        return
    where = ", ".join(name for name, _ in inputs.models)
    hint = "Give the result of seqid inertia, or of seqid gravity for slow moves."
    raise ConfigError("holds no rigid body", where=where, hint=hint)
