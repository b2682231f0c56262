"""The torques that `seqid predict --torques` wrote, a joint at a time.

Imports numpy and pyarrow: only for use inside a command's body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

        Raises
        ------
        InputError
            It is unreadable, lacks the columns of a torque file, or is of another robot or of other
            logs than the prediction.
        """
        where = str(path)
        file = _guarded(path)
        columns = _float_columns(file, where)
        joints = tuple(
            name
            for name in collection.robot.joints
            if all(f"{name}.{kind}" in columns for kind in _KINDS)
        )
        _check_joints(joints, columns, collection, where)
        rows = _log_rows(path)
        prediction = _whose(file, rows, collection.predictions, where)
        return cls(where, prediction, joints, rows, frozenset(columns))

    def series(self, joint: str) -> list[Series]:
        """Read one joint, log by log.

        Raises
        ------
        InputError
            Time is not finite or goes back, or a value is infinite.
        """
        own = {kind: f"{joint}.{kind}" for kind in (*_KINDS, *_MOTION, *_REST, "sliding")}
        own = {"t": "t", "used": "used", **own}
        there = {kind: name for kind, name in own.items() if name in self.columns}
        table = _read(Path(self.path), list(there.values()))
        values = {kind: _numbers(table, name, self.path) for kind, name in there.items()}
        return [
            self._one(log, {kind: value[rows] for kind, value in values.items()})
            for log, rows in self.rows.items()
        ]

    def _one(self, log: str, own: Mapping[str, Array]) -> Series:
        t, torque = own["t"], own["torque"]
        if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0.0):
            message = f"t is missing or goes back in {log}"
            raise InputError(message, where=self.path, hint="Run seqid predict again.")
        low, high = (own.get(kind, np.full(len(t), np.nan)) for kind in _REST)
        used, sliding = (own.get(name, np.ones(len(t))) > 0.0 for name in ("used", "sliding"))
        # NaN bounds, where the joint slides, leave the residual as it is.
        nearest = np.fmin(np.fmax(torque, low), high)
        known = np.isnan(low) | np.isnan(torque)
        residual = np.where(known, own["residual"], torque - nearest)
        motion = [own.get(kind) for kind in _MOTION]
        return Series(log, t, torque, own["predicted"], residual, used, sliding, low, high, *motion)


def find_torques(prediction: Prediction, collection: Collection) -> TorqueTable | None:
    """Open the `torques.parquet` beside a prediction, if there is one and it is of this one."""
    path = Path(prediction.path).with_name("torques.parquet")
    if not path.is_file():
        return None
    try:
        table = TorqueTable.open(path, replace(collection, predictions=(prediction,)))
    except InputError:
        return None
    return table


def _guarded(path: Path) -> pq.ParquetFile:
    where = str(path)
    if not path.is_file():
        what = "is not a file" if path.exists() else "does not exist"
        raise InputError(what, where=where, hint=_HINT)
    try:
        file = opened_table(path)
    except ARROW_ERRORS as error:
        message = f"cannot be read as Parquet: {_first_line(error)}"
        raise InputError(message, where=where, hint=_HINT) from error
    if not 0 < file.metadata.num_rows <= _MOST_ROWS:
        message = f"has {file.metadata.num_rows} rows; 1 to {_MOST_ROWS} can be shown"
        raise InputError(message, where=where, hint="Predict fewer logs at a time.")
    return file


def _float_columns(file: pq.ParquetFile, where: str) -> set[str]:
    schema = file.schema_arrow
    found = {
        field.name
        for field in schema
        if pa.types.is_floating(field.type) or pa.types.is_boolean(field.type)
        if schema.names.count(field.name) == 1
    }
    text = schema.names.count("log") == 1 and _is_text(schema.field("log").type)
    if "t" not in found or not text:
        has = ", ".join(schema.names[:8]) or "nothing"
        message = f"is no torque file: columns t (a number) and log (text) are needed, it has {has}"
        raise InputError(message, where=where, hint=_HINT)
    return found


def _is_text(kind: pa.DataType) -> bool:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _check_joints(
    joints: Sequence[str], columns: set[str], collection: Collection, where: str
) -> None:
    others = {
        name.removesuffix(".predicted") for name in columns if name.endswith(".predicted")
    } - set(joints)
    if others or not joints:
        robot, source = collection.robot, collection.sources[0].path
        message = (
            f"is about joints {', '.join(sorted(others | set(joints))) or '(none)'}, "
            f"but {source} about robot {robot.name!r} ({', '.join(robot.joints)})"
        )
        raise InputError(message, where=where, hint="Give the torques of the same robot.")


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
        raise InputError(message, where=where, hint="Run seqid predict again.")
    return {str(names[codes[a]]): slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)}


def _whose(
    file: pq.ParquetFile, rows: Mapping[str, slice], predictions: Sequence[Prediction], where: str
) -> Prediction | None:
    """Return the prediction with these logs, sample by sample, and with this model."""
    if not predictions:
        return None
    mine = {log: part.stop - part.start for log, part in rows.items()}
    same = [p for p in predictions if mine == {log.path: log.samples for log in p.content.logs}]
    if not same:
        raise _other_logs(mine, predictions, where)
    made = (file.schema_arrow.metadata or {}).get(PARAMETERS.encode(), b"").decode().split()
    for prediction in same:  # without the entry any model may
        if not made or set(made) == {item.sha256 for item in prediction.content.parameters}:
            return prediction
    message = f"is of another model than {', '.join(p.path for p in same)}"
    hint = "Run seqid predict again with both -o and --torques."
    raise InputError(message, where=where, hint=hint)


def _other_logs(
    mine: Mapping[str, int], predictions: Sequence[Prediction], where: str
) -> InputError:
    logs = {log.path: log.samples for item in predictions for log in item.content.logs}
    names = ", ".join(item.path for item in predictions)
    odd = next((log for log in mine if mine[log] != logs.get(log)), None)
    if odd is None:
        absent = next(log for log in logs if log not in mine)
        message = f"lacks the log {absent}, which {names} holds"
    elif odd in logs:
        message = f"holds {mine[odd]} samples of {odd}, but {names} counts {logs[odd]}"
    else:
        message = f"holds the log {odd}, which {names} does not"
    hint = "Run seqid predict again with both -o and --torques."
    return InputError(message, where=where, hint=hint)


def _read(path: Path, columns: Sequence[str]) -> pa.Table:
    try:
        return pq.read_table(path, columns=list(columns), partitioning=None)
    except ARROW_ERRORS as error:
        message = f"is damaged: {_first_line(error)}"
        raise InputError(message, where=str(path), hint="Run seqid predict again.") from error


def _numbers(table: pa.Table, name: str, where: str) -> Array:
    column = table.column(name).combine_chunks().cast(pa.float64())
    values: Array = column.to_numpy(zero_copy_only=False).astype(np.float64)
    far = np.abs(values) > ABSURD
    if np.any(far):
        row = int(np.argmax(far))
        size = "infinite" if np.isinf(values[row]) else f"{values[row]:.3g}"
        message = f"{name} is {size} at row {row}"
        raise InputError(message, where=where, hint="Run seqid predict again.")
    return values


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
