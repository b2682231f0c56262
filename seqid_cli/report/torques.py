"""The torques that `seqid predict --torques` wrote, a joint at a time."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.identify.prediction.torque_files import PARAMETERS
from seqid_cli.logs.read import ABSURD
from seqid_cli.logs.tables.columns import ARROW_ERRORS, opened_table
from seqid_cli.report.collection import Collection, Prediction
from seqid_cli.typing import Array, Mask

_KINDS = ("torque", "predicted", "residual")
_MORE = ("position", "velocity", "low", "high", "sliding", "std")
_HINT = "Name the Parquet file that seqid predict wrote with --torques."
_AGAIN = "Run seqid predict again."


@dataclass(frozen=True)
class Series:
    """One joint in one log: samples (N,); NaN where a value is missing.

    `residual` is measured torque minus the nearest torque that the model allows: where
    the joint slides the predicted torque, at rest between `low` and `high` (NaN where
    it slides). Position and velocity are None where the file was written without them,
    and so is `std`, the standard deviation of the prediction; `used` marks the samples
    that count, `sliding` those that the errors are computed from.
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
    std: Array | None = None


@dataclass(frozen=True)
class TorqueTable:
    """A torque file, opened; `rows` are the samples of each log, `prediction` whose they are."""

    path: str
    prediction: Prediction | None
    joints: tuple[str, ...]
    rows: Mapping[str, slice]
    columns: frozenset[str]

    @classmethod
    def open(cls, path: Path, collection: Collection) -> Self:
        """Open a torque file and check it against the documents.

        Raises InputError: it is unreadable, no torque file, or of another robot, log or
        model.
        """
        where, robot = str(path), collection.robot
        if not path.is_file():
            raise InputError("is not a file", where=where, hint=_HINT)
        with _readable(where, "is no torque file"):
            file = opened_table(path)
            rows = _log_rows(path)
        numeric = (pa.types.is_floating, pa.types.is_boolean)
        columns = {
            x.name
            for x in file.schema_arrow
            if any(is_one(x.type) for is_one in numeric)
        }
        there = {
            name.removesuffix(".predicted")
            for name in columns
            if name.endswith(".predicted")
        }
        joints = tuple(
            x for x in robot.joints if columns >= {f"{x}.{kind}" for kind in _KINDS}
        )
        if "t" not in columns:
            message = "is no torque file: its column t must hold numbers"
            raise InputError(message, where=where, hint=_HINT)
        if not joints or there - set(joints):
            message = (
                f"is about joints {', '.join(sorted(there)) or '(none)'}, but "
                f"{collection.sources[0].path} about robot {robot.name!r} "
                f"({', '.join(robot.joints)})"
            )
            raise InputError(
                message, where=where, hint="Give the torques of the same robot."
            )
        made = (
            (file.schema_arrow.metadata or {})
            .get(PARAMETERS.encode(), b"")
            .decode()
            .split()
        )
        prediction = _whose(rows, set(made), collection.predictions, where)
        return cls(where, prediction, joints, rows, frozenset(columns))

    def series(self, joint: str) -> list[Series]:
        """Read a joint, log by log; raises InputError for infinite values, or time going back."""
        names = {
            "t": "t",
            "used": "used",
            **{k: f"{joint}.{k}" for k in (*_KINDS, *_MORE)},
        }
        there = {kind: name for kind, name in names.items() if name in self.columns}
        with _readable(self.path, "is damaged"):
            table = pq.read_table(
                self.path, columns=list(there.values()), partitioning=None
            )
            values = {
                kind: (
                    table.column(name)
                    .combine_chunks()
                    .cast(pa.float64())
                    .to_numpy(False)
                )
                for kind, name in there.items()
            }
        for kind, value in values.items():
            far = np.abs(value) > ABSURD
            if np.any(far):
                row = int(np.argmax(far))
                message = f"{there[kind]} is {value[row]:.3g} at row {row}"
                raise InputError(message, where=self.path, hint=_AGAIN)
        return [
            self._one(log, {kind: value[rows] for kind, value in values.items()})
            for log, rows in self.rows.items()
        ]

    def _one(self, log: str, own: Mapping[str, Array]) -> Series:
        t, torque, left = own["t"], own["torque"], own["residual"]
        if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0.0):
            raise InputError(
                f"t is missing or goes back in {log}", where=self.path, hint=_AGAIN
            )
        low, high = (own.get(kind, np.full(len(t), np.nan)) for kind in ("low", "high"))
        used, sliding = (
            own.get(name, np.ones(len(t))) > 0.0 for name in ("used", "sliding")
        )
        # NaN bounds, where the joint slides, leave the residual as it is.
        nearest = np.fmin(np.fmax(torque, low), high)
        left = np.where(np.isnan(low) | np.isnan(torque), left, torque - nearest)
        return Series(
            log=log,
            t=t,
            torque=torque,
            predicted=own["predicted"],
            residual=left,
            used=used,
            sliding=sliding,
            low=low,
            high=high,
            position=own.get("position"),
            velocity=own.get("velocity"),
            std=own.get("std"),
        )


@contextlib.contextmanager
def _readable(where: str, wrong: str) -> Iterator[None]:
    """Turn what Arrow says in the block into a message."""
    try:
        yield
    except ARROW_ERRORS as error:
        first_line = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{wrong}: {first_line}", where=where, hint=_HINT) from error


def _log_rows(path: Path) -> dict[str, slice]:
    table = pq.read_table(path, columns=["log"], partitioning=None)
    column = table.column("log").combine_chunks().dictionary_encode()
    codes, names = (
        column.indices.to_numpy(zero_copy_only=False),
        column.dictionary.to_pylist(),
    )
    texts = bool(names) and all(isinstance(name, str) for name in names)
    starts = (
        [] if column.null_count else np.flatnonzero(np.diff(codes, prepend=-1)).tolist()
    )
    if not texts or len(starts) != len(names):
        message = (
            "column log must name the log of every row, and rows of a log follow each"
            " other"
        )
        raise ValueError(message)
    ends = zip(starts, [*starts[1:], len(codes)], strict=True)
    return {names[codes[start]]: slice(start, end) for start, end in ends}


def _whose(
    rows: Mapping[str, slice],
    made: set[str],
    predictions: Sequence[Prediction],
    where: str,
) -> Prediction | None:
    """Return the prediction with these logs, sample by sample, and with this model."""
    mine = {log: part.stop - part.start for log, part in rows.items()}
    logs = [
        {log.path: log.samples for log in item.content.logs} for item in predictions
    ]
    same = [
        item for item, theirs in zip(predictions, logs, strict=True) if theirs == mine
    ]
    for prediction in same:  # without the entry any model may
        if not made or made == {item.sha256 for item in prediction.content.parameters}:
            return prediction
    if not predictions:
        return None
    if same:
        message = f"is of another model than {', '.join(item.path for item in same)}"
    else:
        odd, count = min(mine.items() ^ logs[0].items())
        here = "this file" if mine.get(odd) == count else "that"
        message = f"has other logs than {predictions[0].path}: "
        message += f"{odd} with {count} samples is in {here} only"
    hint = "Run seqid predict again with both -o and --torques."
    raise InputError(message, where=where, hint=hint)
