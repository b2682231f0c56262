"""Measured, predicted and residual torque as Parquet, with position and velocity."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.params.files import replacing, writing

PARAMETERS = "seqid.parameters"  # of the metadata
_KINDS = ("torque", "predicted", "residual")
_REST = ("low", "high")
_MOTION = ("position", "velocity")


class TorqueWriter:
    """Writes `t`, `log`, torques of each joint, then position and velocity.

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
    def open(
        cls, path: Path, joints: Sequence[str], parameters: Sequence[str] = ()
    ) -> "Iterator[TorqueWriter]":
        """Write to `path` in one step: an interrupted run leaves the old file or none.

        `parameters`: the SHA-256 of the files that the model is from, kept as metadata.
        """
        fields = [("t", pa.float64()), ("log", pa.string())]
        for name in joints:
            fields += [(f"{name}.{kind}", pa.float64()) for kind in _KINDS]
            fields += [(f"{name}.sliding", pa.bool_())]
            fields += [(f"{name}.{kind}", pa.float64()) for kind in _REST]
        fields += [("used", pa.bool_())]
        fields += [(f"{name}.{kind}", pa.float64()) for name in joints for kind in _MOTION]
        schema = pa.schema(fields, {PARAMETERS: " ".join(parameters)} if parameters else None)
        with replacing(path) as temporary:
            with writing(path):
                # Torques hardly repeat: a dictionary of them takes most of the time for nothing.
                writer = pq.ParquetWriter(temporary, schema, use_dictionary=["log"])
            yield cls(path, writer, schema)
            with writing(path):
                writer.close()

    def write(self, log: LogPrediction, *, rows: int = 65536) -> None:
        """Append a log, or the next part of one, all its samples."""
        columns = [pa.array(log.t), pa.array([str(log.path)] * len(log.t), pa.string())]
        for j in range(log.tau.shape[1]):
            columns += [pa.array(x[:, j]) for x in (log.tau, log.predicted, log.residual)]
            columns.append(pa.array(log.sliding[:, j]))
            columns += [pa.array(x[:, j], mask=log.sliding[:, j]) for x in (log.low, log.high)]
        columns.append(pa.array(log.used))
        for joint in range(log.tau.shape[1]):
            for values in (log.q, log.dq):
                columns.append(pa.array(values[:, joint], from_pandas=True))  # NaN is null
        with writing(self._path):
            table = pa.table(columns, schema=self._schema)
            self._writer.write_table(table, row_group_size=rows)
