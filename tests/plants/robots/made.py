"""Logs and friction that a test makes up: what it does not care about is filled in."""

from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.motion.filters.bandwidth import Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import FrictionJoint
from tests import Array


def made_recording(
    q: Array,
    tau: Array | None = None,
    *,
    rate_hz: float,
    path: str = "log.parquet",
    **further: Any,
) -> Recording:
    """Wrap samples (N, n) at an even rate as a log, all of them valid unless `further`
    says.
    """
    usual = {
        "sha256": "0" * 64,
        "format": "simulated",
        "t": np.arange(len(q)) / rate_hz,
        "valid": np.ones(len(q), dtype=bool),
        "health": Health(rate_hz=rate_hz, jitter=0.0),
    }
    return Recording(path=Path(path), q=q, tau=tau, **(usual | further))


def made_motion(
    q: Array, dq: Array, ddq: Array, lowpass: Lowpass, **further: Any
) -> Motion:
    """Wrap what joints did (N, n) at the low-pass's rate,
    usable unless `further` says.
    """
    zeros, every = np.zeros(q.shape[1]), np.ones(len(q), dtype=bool)
    usual = {
        "t": np.arange(len(q)) / lowpass.rate_hz,
        "tau": None,
        "moving": np.ones_like(q, dtype=bool),
        "usable": every,
        "valid": every,
        "cutoff": Cutoff(lowpass.cutoff_hz, zeros, zeros),
    }
    given = usual | further
    return Motion(
        q=q, dq=dq, ddq=ddq, rate_hz=lowpass.rate_hz, lowpass=lowpass, **given
    )


def made_prediction(
    path: str, tau: Array, predicted: Array, **further: Any
) -> LogPrediction:
    """Wrap torques (N, n) as a log's prediction, used and sliding unless `further`
    says.
    """
    usual = {
        "sha256": path.ljust(64, "0"),
        "samples": len(tau),
        "cutoff_hz": 30.0,
        "t": 0.004 * np.arange(len(tau)),
        "low": predicted,
        "high": predicted,
        "used": np.ones(len(tau), dtype=bool),
        "sliding": np.ones(tau.shape, dtype=bool),
        "outside": np.zeros(tau.shape, dtype=bool),
        "std": np.full(tau.shape, np.nan),
        "parameter_std": np.zeros(tau.shape),
        **dict.fromkeys(("q", "dq", "ddq"), np.full(tau.shape, np.nan)),
    }
    return LogPrediction(
        path=Path(path), tau=tau, predicted=predicted, **(usual | further)
    )


def friction_joint(
    positive: Any, negative: Any = None, **further: Any
) -> FrictionJoint:
    """Friction of a joint; the coefficients of forward motion are those of both unless
    given.
    """
    forward = np.asarray(positive, dtype=np.float64)
    count = forward.size * (1 + bool(further.get("directional")))
    usual = {
        "max_error": 0.0,
        "rmse": 0.0,
        "position_range": [-3.0, 3.0],
        "directional": False,
        "covariance": np.eye(count).tolist(),
    }
    return FrictionJoint(
        position_order=forward.shape[0] - 1,
        velocity_order=forward.shape[1] - 1,
        positive=forward.tolist(),
        negative=np.array(positive if negative is None else negative, float).tolist(),
        **(usual | further),
    )
