"""The torques that `seqid predict --torques` wrote, a joint at a time."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.being_read import being_read
from seqid_cli.errors import InputError
from seqid_cli.identify.prediction.torque_files import PARAMETERS
from seqid_cli.logs.read import ABSURD
from seqid_cli.logs.tables.columns import ARROW_ERRORS, opened_table
from seqid_cli.report.collection import Collection, Prediction
from seqid_cli.typing import Array, Mask

_KINDS = ("torque", "predicted", "residual")
_OPTIONAL_KINDS = ("position", "velocity", "low", "high", "sliding", "std")
_HINT = "Name the Parquet file that seqid predict wrote with --torques."
_AGAIN = "Run seqid predict again."


@dataclass(frozen=True, kw_only=True)
class Series:
    """One joint in one log: samples (N,); NaN where a value is missing.

    Parameters
    ----------
    log : str
        Path of the log.
    t : (N,) float
        Times [s].
    torque, predicted : (N,) float
        Measured and predicted torque [N m].
    residual : (N,) float
        Measured torque minus the nearest torque that the model allows [N m]: where the
        joint slides the predicted torque, at rest between `low` and `high`.
    used : (N,) bool
        The samples that count.
    sliding : (N,) bool
        The samples that the errors are computed from.
    low, high : (N,) float
        Bounds of the torque at rest [N m]; NaN where the joint slides.
    position, velocity : (N,) float, optional
        [rad, rad/s; m where prismatic]; None where the file was written without them.
    std : (N,) float, optional
        Standard deviation of the prediction [N m]; None where the file has none.
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


@dataclass(frozen=True, kw_only=True)
class TorqueTable:
    """A torque file, opened.

    Parameters
    ----------
    path : str
    prediction : Source, optional
        The prediction that its torques belong to.
    joints : tuple of str
        Joints that it has.
    rows : mapping of str to slice
        The samples of each log.
    columns : frozenset of str
        Its columns of numbers.
    """

    path: str
    prediction: Prediction | None
    joints: tuple[str, ...]
    rows: Mapping[str, slice]
    columns: frozenset[str]

    @classmethod
    def open(cls, path: Path, collection: Collection) -> Self:
        """Open a torque file and check it against the documents.

        Parameters
        ----------
        path : Path
        collection : Collection

        Returns
        -------
        TorqueTable

        Raises
        ------
        InputError
            It is unreadable, no torque file, or of another robot, log or model.
        """
        where = str(path)
        if not path.is_file():
            raise InputError("is not a file", where=where, hint=_HINT)
        with _readable(where, "is no torque file"):
            file = opened_table(path)
            rows = _log_rows(path)

        columns = {
            field.name
            for field in file.schema_arrow
            if pa.types.is_floating(field.type) or pa.types.is_boolean(field.type)
        }
        if "t" not in columns:
            message = "is no torque file: its column t must hold numbers"
            raise InputError(message, where=where, hint=_HINT)
        joints = _joints_of(columns, collection, where)

        # The hashes of the parameter files that the torques were predicted with.
        metadata = file.schema_arrow.metadata or {}
        models = set(metadata.get(PARAMETERS.encode(), b"").decode().split())
        prediction = _prediction_of(rows, models, collection.predictions, where)
        return cls(
            path=where,
            prediction=prediction,
            joints=joints,
            rows=rows,
            columns=frozenset(columns),
        )

    def series(self, joint: str) -> list[Series]:
        """Read a joint, log by log.

        Parameters
        ----------
        joint : str

        Returns
        -------
        list of Series

        Raises
        ------
        InputError
            A value is infinite, or time goes back.
        """
        wanted = {"t": "t", "used": "used"}
        for kind in (*_KINDS, *_OPTIONAL_KINDS):
            wanted[kind] = f"{joint}.{kind}"
        names = {kind: name for kind, name in wanted.items() if name in self.columns}
        with _readable(self.path, "is damaged"):
            table = pq.read_table(
                self.path, columns=list(names.values()), partitioning=None
            )
            values = {kind: _column(table, name) for kind, name in names.items()}

        for kind, value in values.items():
            is_absurd = np.abs(value) > ABSURD
            if np.any(is_absurd):
                row = int(np.argmax(is_absurd))
                message = f"{names[kind]} is {value[row]:.3g} at row {row}"
                raise InputError(message, where=self.path, hint=_AGAIN)

        series = []
        for log, rows in self.rows.items():
            of_log = {kind: value[rows] for kind, value in values.items()}
            series.append(self._series_of_log(log, of_log))
        return series

    def _series_of_log(self, log: str, values: Mapping[str, Array]) -> Series:
        """Return one log's samples from its values by kind."""
        t = values["t"]
        if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0.0):
            raise InputError(
                f"t is missing or goes back in {log}", where=self.path, hint=_AGAIN
            )
        unknown = np.full(len(t), np.nan)
        low = values.get("low", unknown)
        high = values.get("high", unknown)
        always = np.ones(len(t))

        # NaN bounds, where the joint slides, leave the residual as it is.
        torque = values["torque"]
        nearest_allowed = np.fmin(np.fmax(torque, low), high)
        residual = np.where(
            np.isnan(low) | np.isnan(torque),
            values["residual"],
            torque - nearest_allowed,
        )
        return Series(
            log=log,
            t=t,
            torque=torque,
            predicted=values["predicted"],
            residual=residual,
            used=values.get("used", always) > 0.0,
            sliding=values.get("sliding", always) > 0.0,
            low=low,
            high=high,
            position=values.get("position"),
            velocity=values.get("velocity"),
            std=values.get("std"),
        )


@contextlib.contextmanager
def _readable(where: str, wrong: str) -> Iterator[None]:
    """Turn what Arrow says in the block into a message."""
    try:
        with being_read(Path(where)):
            yield
    except ARROW_ERRORS as error:
        first_line = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{wrong}: {first_line}", where=where, hint=_HINT) from error


def _column(table: pa.Table, name: str) -> Array:
    """Return a column of a table as numbers (N,), NaN where a value is missing."""
    column = table.column(name).combine_chunks().cast(pa.float64())
    return np.asarray(column.to_numpy(False))


def _joints_of(
    columns: set[str], collection: Collection, where: str
) -> tuple[str, ...]:
    """Return the joints of the robot that have all columns; refuse another robot."""
    robot = collection.robot
    joints = tuple(name for name in robot.joints if _has_joint(columns, name))
    predicted = {
        name.removesuffix(".predicted")
        for name in columns
        if name.endswith(".predicted")
    }

    # A joint that the robot has not is of another one.
    if not joints or predicted - set(joints):
        message = (
            f"is about joints {', '.join(sorted(predicted)) or '(none)'}, but "
            f"{collection.sources[0].path} about robot {robot.name!r} "
            f"({', '.join(robot.joints)})"
        )
        raise InputError(
            message, where=where, hint="Give the torques of the same robot."
        )
    return joints


def _has_joint(columns: set[str], joint: str) -> bool:
    """Return whether a file has all columns that a joint needs."""
    return all(f"{joint}.{kind}" in columns for kind in _KINDS)


def _log_rows(path: Path) -> dict[str, slice]:
    """Return the rows of each log, which follow each other."""
    table = pq.read_table(path, columns=["log"], partitioning=None)
    column = table.column("log").combine_chunks().dictionary_encode()
    codes = column.indices.to_numpy(zero_copy_only=False)
    names = column.dictionary.to_pylist()
    are_texts = bool(names) and all(isinstance(name, str) for name in names)
    starts = []
    if not column.null_count:
        starts = np.flatnonzero(np.diff(codes, prepend=-1)).tolist()
    if not are_texts or len(starts) != len(names):
        message = (
            "column log must name the log of every row, and rows of a log follow each"
            " other"
        )
        raise ValueError(message)
    stops = [*starts[1:], len(codes)]
    return {
        names[codes[start]]: slice(start, stop)
        for start, stop in zip(starts, stops, strict=True)
    }


def _prediction_of(
    rows: Mapping[str, slice],
    models: set[str],
    predictions: Sequence[Prediction],
    where: str,
) -> Prediction | None:
    """Return the prediction with these logs, sample by sample, and with this model.

    Parameters
    ----------
    rows : mapping of str to slice
        The samples of each log of a torque file.
    models : set of str
        Hashes of the parameter files that it was made with; empty in older files.
    predictions : sequence of Source
    where : str
        Path of the torque file.

    Returns
    -------
    Source or None
        None where no prediction was given.

    Raises
    ------
    InputError
        The torques belong to none of the predictions.
    """
    samples = {log: part.stop - part.start for log, part in rows.items()}
    of_same_logs = [
        prediction
        for prediction in predictions
        if _samples_by_log(prediction) == samples
    ]
    for prediction in of_same_logs:
        used = {item.sha256 for item in prediction.content.parameters}
        if not models or models == used:
            return prediction

    if not predictions:
        return None
    if of_same_logs:
        paths = ", ".join(item.path for item in of_same_logs)
        message = f"is of another model than {paths}"
    else:
        first = predictions[0]
        odd_log, count = min(samples.items() ^ _samples_by_log(first).items())
        holder = "this file" if samples.get(odd_log) == count else "that"
        message = (
            f"has other logs than {first.path}: {odd_log} with {count} samples is in"
            f" {holder} only"
        )
    hint = "Run seqid predict again with both -o and --torques."
    raise InputError(message, where=where, hint=hint)


def _samples_by_log(prediction: Prediction) -> dict[str, int]:
    """Return the number of samples of each log of a prediction."""
    return {log.path: log.samples for log in prediction.content.logs}
