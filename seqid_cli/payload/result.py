"""The document of a payload: numbers where the logs give them, a verdict, and notes."""

import numpy as np

from seqid_cli.identify.inputs import Inputs
from seqid_cli.identify.log_set import LogSet
from seqid_cli.params.document import head, robot_id, used_settings
from seqid_cli.params.results.payload import (
    PAYLOAD_SCHEMA,
    CarriedBodyEntry,
    JointWithPayload,
    PayloadFile,
)
from seqid_cli.params.schema import Parameter
from seqid_cli.payload.controllers import controller_settings
from seqid_cli.payload.fit import PayloadFit
from seqid_cli.payload.settings import PayloadSettings
from seqid_cli.payload.verdicts import PayloadJudgement
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit


def payload_file(
    fit: PayloadFit,
    body: CarriedBodyEntry,
    judgement: PayloadJudgement,
    inputs: Inputs,
    log_set: LogSet,
    *,
    cutoff_origin: str,
    settings: PayloadSettings,
) -> PayloadFile:
    """Describe a fit as the document of a payload.

    Parameters
    ----------
    fit : PayloadFit
        What the logs carry, by least squares.
    body : CarriedBodyEntry
        The body nearest to it.
    judgement : PayloadJudgement
        Verdicts on the body and on what it leaves of the torque, and notes.
    inputs : Inputs
        Robot and model that it was identified with.
    log_set : LogSet
        The logs, read by the fit.
    cutoff_origin : str
        Where the low-pass cut-off of the logs came from, in words.
    settings : PayloadSettings
        Numbers that the verdicts depended on.
    """
    names = inputs.robot.joint_names
    covariance = fit.covariance[np.ix_(fit.determined, fit.determined)]

    return PayloadFile(
        **head(PAYLOAD_SCHEMA, log_set.created(inputs.documents)),
        robot=robot_id(inputs.robot),
        inputs=log_set.inputs(),
        models=inputs.ids(),
        payload=body,
        parameters=_parameters(fit, names[-1]),
        covariance=covariance.tolist(),
        settings=controller_settings(body),
        joints={name: _joint(fit, j) for j, name in enumerate(names)},
        cutoff_origin=cutoff_origin,
        verdicts=[*log_set.verdicts(), *judgement.verdicts],
        effective_settings=used_settings(settings),
        notes=[*log_set.notes(), *judgement.notes],
    )


def _parameters(fit: PayloadFit, joint: str) -> list[Parameter]:
    """Return the standard parameters by least squares that the logs determine."""
    return [
        Parameter(
            name=f"payload_{kind}",
            value=float(fit.phi[k]),
            std_error=float(fit.std_errors[k]),
            unit=parameter_unit(f"{kind}_1"),
            joint=joint,
        )
        for k, kind in enumerate(STANDARD)
        if fit.determined[k]
    ]


def _joint(fit: PayloadFit, j: int) -> JointWithPayload:
    """Describe the torque error of a joint; null where it never slides."""
    n_samples = int(fit.n_samples[j])
    friction_change = float(fit.friction_change[j])
    if not n_samples:
        return JointWithPayload(
            before=None,
            after=None,
            relative=None,
            samples=0,
            friction_change=friction_change,
        )
    return JointWithPayload(
        before=float(fit.rmse_without[j]),
        after=float(fit.rmse_with[j]),
        relative=fit.shares_left[j],
        samples=n_samples,
        friction_change=friction_change,
    )
