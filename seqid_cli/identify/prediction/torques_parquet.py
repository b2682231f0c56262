"""Measured, predicted and residual torque as Parquet, with position and velocity."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.params.files import replacing, writing

PARAMETERS = "seqid.parameters"  # of the metadata
# Columns of a joint and what they are of a `LogPrediction`; bounds are null where it slides.
_KINDS = ("predicted", "residual", "sliding", "low", "high")
_TORQUES = {"torque": "tau", **{kind: kind for kind in _KINDS}}
_MOTION = {"position": "q", "velocity": "dq"}


@contextlib.contextmanager
def parquet_writer(
    path: Path, joints: Sequence[str], parameters: Sequence[str] = ()
) -> Iterator[Callable[[LogPrediction], None]]:
    """Write torques to `path` in one step; yields what appends a log, or a part of one."""
    # The columns are `t`, `log`, torques of each joint, `used` (whether the errors count the
    # sample), then position and velocity of each joint. The SHA-256 of the model's files are
    # metadata.
    kinds = {"t": pa.float64(), "log": pa.string()}
    kinds |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _TORQUES}
    kinds |= {f"{name}.sliding": pa.bool_() for name in joints}
    kinds |= {"used": pa.bool_()}
    kinds |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _MOTION}
    schema = pa.schema(kinds.items(), {PARAMETERS: " ".join(parameters)} if parameters else None)
    with replacing(path) as temporary:
        with writing(path):
            # Torques hardly repeat: a dictionary of them takes most of the time for nothing.
            writer = pq.ParquetWriter(temporary, schema, use_dictionary=["log"])

        def write(log: LogPrediction, *, rows: int = 65536) -> None:
            with writing(path):
                writer.write_table(pa.table(_columns(log), schema=schema), row_group_size=rows)

        yield write
        with writing(path):
            writer.close()


def _columns(log: LogPrediction) -> list[pa.Array]:
    torques = {kind: getattr(log, field) for kind, field in _TORQUES.items()}
    columns = [pa.array(log.t), pa.array([str(log.path)] * len(log.t), pa.string())]
    for j, slides in enumerate(log.sliding.T):
        for kind, values in torques.items():
            columns.append(pa.array(values[:, j], mask=slides if kind in ("low", "high") else None))
    columns.append(pa.array(log.used))
    for j in range(len(log.sliding.T)):
        for field in _MOTION.values():
            columns.append(pa.array(getattr(log, field)[:, j], from_pandas=True))  # NaN is null
    return columns
