"""Errors of predicted torques, added up log by log, and the torques as Parquet.

Imports numpy and pyarrow: only for use inside a command's body.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from seqid_cli.identify.predict_logs import LogPrediction
from seqid_cli.params.files import replacing, writing

_ROWS = 65536  # per row group
_KINDS = ("torque", "predicted", "residual")
_REST = ("low", "high")
_MOTION = ("position", "velocity")


@dataclass(frozen=True)
class ErrorSums:
    """Sums per joint (n,) over the samples that count; they add up over logs."""

    count: NDArray[np.int64]
    squared_error: NDArray[np.float64]  # (N m)^2
    squared_torque: NDArray[np.float64]  # (N m)^2
    max_abs: NDArray[np.float64]  # N m

    @classmethod
    def none(cls, n: int) -> ErrorSums:
        """Return the sums over no sample of n joints."""
        return cls(np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n), np.zeros(n))

    @classmethod
    def of(cls, log: LogPrediction, *, sliding: bool) -> ErrorSums:
        """Return the sums over one log.

        Over the samples that slide, or over all that count: at rest friction takes any value up to
        its limit, and the error is the distance to that interval.
        """
        counts = log.sliding if sliding else np.broadcast_to(log.used[:, None], log.tau.shape)
        error = np.where(counts, log.residual if sliding else log.beyond, 0.0)
        torque = np.where(counts, log.tau, 0.0)
        return cls(
            count=counts.sum(axis=0, dtype=np.int64),
            squared_error=np.square(error).sum(axis=0),
            squared_torque=np.square(torque).sum(axis=0),
            max_abs=np.abs(error).max(axis=0, initial=0.0),
        )

    def __add__(self, other: ErrorSums) -> ErrorSums:
        """Return the sums over both."""
        return ErrorSums(
            self.count + other.count,
            self.squared_error + other.squared_error,
            self.squared_torque + other.squared_torque,
            np.maximum(self.max_abs, other.max_abs),
        )

    def samples(self, joint: int) -> int:
        """Return how many samples count."""
        return int(self.count[joint])

    def rmse(self, joint: int) -> float | None:
        """Return the RMS error in N m; None without samples."""
        if self.count[joint] == 0:
            return None
        return math.sqrt(self.squared_error[joint] / self.count[joint])

    def relative_rmse(self, joint: int) -> float | None:
        """Return the RMS error over the RMS torque; None without torque."""
        if self.squared_torque[joint] == 0.0:
            return None
        return math.sqrt(self.squared_error[joint] / self.squared_torque[joint])

    def largest(self, joint: int) -> float | None:
        """Return the largest error in N m; None without samples."""
        return float(self.max_abs[joint]) if self.count[joint] else None


class TorqueWriter:
    """Writes `t`, `log`, torques of each joint, then what they are looked at over.

    Of a joint: measured, predicted and residual torque, whether it slides, and at rest (else null)
    the bounds of what the model allows. Then `used` (whether the errors count the sample), and
    position and velocity of each joint.
    """

    def __init__(self, path: Path, writer: pq.ParquetWriter, schema: pa.Schema) -> None:
        self._path = path
        self._writer = writer
        self._schema = schema

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path, joints: Sequence[str]) -> Iterator[TorqueWriter]:
        """Write to `path` in one step: an interrupted run leaves the old file or none."""
        fields = [("t", pa.float64()), ("log", pa.string())]
        for name in joints:
            fields += [(f"{name}.{kind}", pa.float64()) for kind in _KINDS]
            fields += [(f"{name}.sliding", pa.bool_())]
            fields += [(f"{name}.{kind}", pa.float64()) for kind in _REST]
        fields += [("used", pa.bool_())]
        fields += [(f"{name}.{kind}", pa.float64()) for name in joints for kind in _MOTION]
        schema = pa.schema(fields)
        with replacing(path) as temporary:
            with writing(path):
                # Torques hardly repeat: a dictionary of them takes most of the time for nothing.
                writer = pq.ParquetWriter(temporary, schema, use_dictionary=["log"])
            yield cls(path, writer, schema)
            with writing(path):
                writer.close()

    def write(self, log: LogPrediction) -> None:
        """Append a log, or the next part of one, all its samples."""
        columns = [pa.array(log.t), pa.array([str(log.path)] * len(log.t), pa.string())]
        for j in range(log.tau.shape[1]):
            columns += [pa.array(x[:, j]) for x in (log.tau, log.predicted, log.residual)]
            columns.append(pa.array(log.sliding[:, j]))
            columns += [pa.array(x[:, j], mask=log.sliding[:, j]) for x in (log.low, log.high)]
        columns.append(pa.array(log.used))
        for joint in range(log.tau.shape[1]):
            for values in (log.q, log.dq):
                known = np.full(len(log.t), np.nan) if values is None else values[:, joint]
                columns.append(pa.array(known, from_pandas=True))  # NaN is null
        with writing(self._path):
            table = pa.table(columns, schema=self._schema)
            self._writer.write_table(table, row_group_size=_ROWS)
