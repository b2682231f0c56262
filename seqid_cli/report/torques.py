"""The torques that `seqid predict --torques` wrote, a joint at a time.

Imports numpy and pyarrow: only for use inside a command's body.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from seqid_cli.errors import InputError
from seqid_cli.identify.prediction.torques_parquet import PARAMETERS
from seqid_cli.logs.read import ABSURD
from seqid_cli.logs.tables.columns import ARROW_ERRORS, opened_table
from seqid_cli.report.collection import Collection, Prediction
from seqid_cli.robot.types import Array

Mask = NDArray[np.bool_]

_KINDS = ("torque", "predicted", "residual")
_REST = ("low", "high")
_MOTION = ("position", "velocity")
_MOST_ROWS = 200_000_000
_MOST_LOGS = 10_000
_HINT = "Name the Parquet file that seqid predict wrote with --torques."
_AGAIN = "Run seqid predict again."


@dataclass(frozen=True)
class Series:
    """One joint in one log: samples (N,); NaN where a value is missing.

    `residual` is measured torque minus the nearest torque that the model allows: where the joint
    slides the predicted torque, at rest between `low` and `high` (NaN where it slides). Position
    and velocity are None where the file was written without them; `used` marks the samples that
    count, `sliding` those that the errors are computed from.
    """

    log: str
    t: Array
    torque: Array
    predicted: Array
    residual: Array
    used: Mask
    sliding: Mask
    low: Array
    high: Array
    position: Array | None = None
    velocity: Array | None = None


@dataclass(frozen=True)
class TorqueTable:
    """A torque file, opened; `rows` are the samples of each log, `prediction` whose they are."""

    path: str
    prediction: Prediction | None
    joints: tuple[str, ...]
    rows: Mapping[str, slice]
    columns: frozenset[str]

    @classmethod
    def open(cls, path: Path, collection: Collection) -> TorqueTable:
        """Open a torque file and check it against the documents.

        Raises InputError: it is unreadable, lacks the columns of a torque file, or is of another
        robot or of other logs than the prediction.
        """
        file, columns = _opened(path)
        robot = collection.robot
        there = {name.removesuffix(".predicted") for name in columns if name.endswith(".predicted")}
        joints = tuple(x for x in robot.joints if columns >= {f"{x}.{kind}" for kind in _KINDS})
        if not joints or there - set(joints):
            message = (
                f"is about joints {', '.join(sorted(there | set(joints))) or '(none)'}, but "
                f"{collection.sources[0].path} about robot {robot.name!r} "
                f"({', '.join(robot.joints)})"
            )
            hint = "Give the torques of the same robot."
            raise InputError(message, where=str(path), hint=hint)
        rows = _log_rows(path)
        prediction = _whose(file, rows, collection.predictions, str(path))
        return cls(str(path), prediction, joints, rows, frozenset(columns))

    def series(self, joint: str) -> list[Series]:
        """Read one joint, log by log.

        Raises InputError: time is not finite or goes back, or a value is infinite.
        """
        kinds = (*_KINDS, *_MOTION, *_REST, "sliding")
        names = {"t": "t", "used": "used", **{kind: f"{joint}.{kind}" for kind in kinds}}
        there = {kind: name for kind, name in names.items() if name in self.columns}
        table = _read(Path(self.path), list(there.values()))
        values = {kind: _numbers(table, name, self.path) for kind, name in there.items()}
        found = []
        for log, rows in self.rows.items():
            own = {kind: value[rows] for kind, value in values.items()}
            t, torque = own["t"], own["torque"]
            if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0.0):
                message = f"t is missing or goes back in {log}"
                raise InputError(message, where=self.path, hint=_AGAIN)
            low, high = (own.get(kind, np.full(len(t), np.nan)) for kind in _REST)
            used, sliding = (own.get(name, np.ones(len(t))) > 0.0 for name in ("used", "sliding"))
            # NaN bounds, where the joint slides, leave the residual as it is.
            nearest = np.fmin(np.fmax(torque, low), high)
            known = np.isnan(low) | np.isnan(torque)
            left = np.where(known, own["residual"], torque - nearest)
            motion = [own.get(kind) for kind in _MOTION]
            one = Series(log, t, torque, own["predicted"], left, used, sliding, low, high, *motion)
            found.append(one)
        return found


def find_torques(prediction: Prediction, collection: Collection) -> TorqueTable | None:
    """Open the `torques.parquet` beside a prediction, if there is one and it is of this one."""
    path = Path(prediction.path).with_name("torques.parquet")
    with contextlib.suppress(InputError):
        return TorqueTable.open(path, replace(collection, predictions=(prediction,)))
    return None


def _opened(path: Path) -> tuple[pq.ParquetFile, set[str]]:
    """A torque file and its columns of numbers."""
    where = str(path)
    if not path.is_file():
        what = "is not a file" if path.exists() else "does not exist"
        raise InputError(what, where=where, hint=_HINT)
    with _readable(where, "cannot be read as Parquet", _HINT):
        file = opened_table(path)
    if not 0 < file.metadata.num_rows <= _MOST_ROWS:
        message = f"has {file.metadata.num_rows} rows; 1 to {_MOST_ROWS} can be shown"
        raise InputError(message, where=where, hint="Predict fewer logs at a time.")
    once = {x.name: x.type for x in file.schema_arrow if file.schema_arrow.names.count(x.name) == 1}
    numbers = {
        name
        for name, kind in once.items()
        if pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    }
    log = once.get("log", pa.null())
    log = log.value_type if pa.types.is_dictionary(log) else log
    if "t" not in numbers or not (pa.types.is_string(log) or pa.types.is_large_string(log)):
        has = ", ".join(file.schema_arrow.names[:8]) or "nothing"
        message = f"is no torque file: columns t (a number) and log (text) are needed, it has {has}"
        raise InputError(message, where=where, hint=_HINT)
    return file, numbers


@contextlib.contextmanager
def _readable(where: str, wrong: str, hint: str) -> Iterator[None]:
    """Turn what Arrow says in the block into a message."""
    try:
        yield
    except ARROW_ERRORS as error:
        first_line = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{wrong}: {first_line}", where=where, hint=hint) from error


def _log_rows(path: Path) -> dict[str, slice]:
    where = str(path)
    column = _read(path, ["log"]).column("log").combine_chunks().dictionary_encode()
    codes = column.indices.to_numpy(zero_copy_only=False)
    try:
        names = column.dictionary.to_pylist()
    except UnicodeDecodeError as error:
        raise InputError("column log: is no text", where=where, hint=_HINT) from error
    if column.null_count or len(names) > _MOST_LOGS:
        message = f"column log: must name 1 to {_MOST_LOGS} logs without gaps"
        raise InputError(message, where=where, hint=_HINT)
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    ends = np.append(starts[1:], len(codes))
    if len(starts) != len(names):
        message = "column log: the rows of a log must follow each other"
        raise InputError(message, where=where, hint=_AGAIN)
    return {str(names[codes[a]]): slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)}


def _whose(
    file: pq.ParquetFile, rows: Mapping[str, slice], predictions: Sequence[Prediction], where: str
) -> Prediction | None:
    """Return the prediction with these logs, sample by sample, and with this model."""
    if not predictions:
        return None
    mine = {log: part.stop - part.start for log, part in rows.items()}
    same = [p for p in predictions if mine == {log.path: log.samples for log in p.content.logs}]
    made = (file.schema_arrow.metadata or {}).get(PARAMETERS.encode(), b"").decode().split()
    for prediction in same:  # without the entry any model may
        if not made or set(made) == {item.sha256 for item in prediction.content.parameters}:
            return prediction
    logs = {log.path: log.samples for item in predictions for log in item.content.logs}
    names = ", ".join(item.path for item in predictions)
    odd = next((log for log in mine if mine[log] != logs.get(log)), None)
    if same:
        message = f"is of another model than {', '.join(p.path for p in same)}"
    elif odd is None:
        absent = next(log for log in logs if log not in mine)
        message = f"lacks the log {absent}, which {names} holds"
    elif odd in logs:
        message = f"holds {mine[odd]} samples of {odd}, but {names} counts {logs[odd]}"
    else:
        message = f"holds the log {odd}, which {names} does not"
    hint = "Run seqid predict again with both -o and --torques."
    raise InputError(message, where=where, hint=hint)


def _read(path: Path, columns: Sequence[str]) -> pa.Table:
    with _readable(str(path), "is damaged", _AGAIN):
        return pq.read_table(path, columns=list(columns), partitioning=None)


def _numbers(table: pa.Table, name: str, where: str) -> Array:
    column = table.column(name).combine_chunks().cast(pa.float64())
    values: Array = column.to_numpy(zero_copy_only=False).astype(np.float64)
    far = np.abs(values) > ABSURD
    if np.any(far):
        row = int(np.argmax(far))
        size = "infinite" if np.isinf(values[row]) else f"{values[row]:.3g}"
        message = f"{name} is {size} at row {row}"
        raise InputError(message, where=where, hint=_AGAIN)
    return values
