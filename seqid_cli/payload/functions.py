"""Identifying a payload as a function: logs with it and a model without it in, the document out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from seqid_cli.errors import ConfigError
from seqid_cli.identify.inputs import Models, imu_stage_for, prepare
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
    if not {"gravity", "inertia"} & present(inputs.stages).keys():
        where = ", ".join(name for name, _ in inputs.models)
        hint = "Give the result of seqid inertia, or of seqid gravity for slow moves."
        raise ConfigError("holds no rigid body", where=where, hint=hint)
    from seqid_cli.payload.result import payload_file

    file = payload_file(inputs, options, settings)
    if inputs.output is not None:
        write_json_atomic(inputs.output, file, inputs=inputs.sources)
    return file
