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
from seqid_cli.payload.verdicts import joint_verdicts, mass_verdict, payload_notes
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit


def payload_file(
    fit: PayloadFit,
    body: CarriedBodyEntry,
    inputs: Inputs,
    log_set: LogSet,
    *,
    good_error: float,
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
    inputs : Inputs
        Robot and model that it was identified with.
    log_set : LogSet
        The logs, read by the fit.
    good_error : float
        Largest standard error of the mass, as a share of it, with which it is good.
    cutoff_origin : str
        Where the low-pass cut-off of the logs came from, in words.
    settings : PayloadSettings
        Numbers that the verdicts depend on.
    """
    names = inputs.robot.joint_names
    joints = {name: _joint(fit, j) for j, name in enumerate(names)}
    verdicts = [
        *log_set.verdicts(),
        mass_verdict(body, good_error, settings.fit),
        *joint_verdicts(body, joints, settings.fit),
    ]
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
        joints=joints,
        cutoff_origin=cutoff_origin,
        verdicts=verdicts,
        effective_settings=used_settings(settings),
        notes=[*log_set.notes(), *payload_notes(fit, body, names)],
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
    rmse_with = float(fit.rmse_with[j])
    return JointWithPayload(
        before=float(fit.rmse_without[j]),
        after=rmse_with,
        relative=rmse_with / max(float(fit.torque_rms[j]), 1e-300),
        samples=n_samples,
        friction_change=friction_change,
    )
