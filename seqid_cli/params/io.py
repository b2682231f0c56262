"""Read and write documents. A fault is reported with its place in the file."""

import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA, DiagnosisFile
from seqid_cli.params.results.payload import PAYLOAD_SCHEMA, PayloadFile
from seqid_cli.params.results.plan import PLAN_SCHEMA, PlanFile
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA, PredictionFile
from seqid_cli.params.results.trend import TREND_SCHEMA, SeriesEntry, TrendFile
from seqid_cli.params.schema import SCHEMA, ParameterFile

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

T = TypeVar("T")
Json = dict[str, object]
Migration = Callable[[Json], Json]
Result = PredictionFile | DiagnosisFile | PayloadFile | PlanFile
Document = ParameterFile | Result

PARAMS_VERSION = 1
# From each older version: the function that turns it into the next. Version 1 is the oldest.
PARAMS_MIGRATIONS: Mapping[int, Migration] = {}
_RESULTS: Mapping[str, type[Result]] = {
    PREDICTION_SCHEMA: PredictionFile,
    DIAGNOSIS_SCHEMA: DiagnosisFile,
    PAYLOAD_SCHEMA: PayloadFile,
    PLAN_SCHEMA: PlanFile,
}
_RESULT_HINT = "Name JSON files that seqid wrote with -o."
_MAX_BYTES = 256 * 1024 * 1024
_NAME = re.compile(r"seqid/(?P<kind>[a-z_]+)@(?P<version>[1-9][0-9]{0,5})")
_BYTE = re.compile(r"\(byte (\d+)\)")
# 1e30 and more: no result has such numbers, and their squares and products overflow.
_HUGE = re.compile(rb"(?<=[\s:,\[])-?(?:[0-9.]+[eE]\+?(?:[3-9][0-9]|[0-9]{3,})|[0-9]{31,})")
_PLACE = re.compile(r"^(?P<what>.*) - at `(?P<key>.*)`$")


def read_parameters(
    path: Path,
    *,
    version: int = PARAMS_VERSION,
    migrations: Mapping[int, Migration] = PARAMS_MIGRATIONS,
) -> ParameterFile:
    """Read one parameter file strictly.

    Raises ConfigError: the file is missing, is no JSON, is another kind of document, is newer than
    `version`, or does not follow the schema. The message names the line or the key.
    """
    where = str(path)
    data = read_bytes(path)
    document = parse_document(data, where)
    return _parameters(data, document, where, version, migrations)


def _parameters(
    data: bytes, document: Json, where: str, version: int, migrations: Mapping[int, Migration]
) -> ParameterFile:
    found = _version(document, where, version)
    try:
        if found < version:
            data = _migrated(document, found, where, version, migrations)
        file = msgspec.json.decode(data, type=ParameterFile)
    except (msgspec.ValidationError, RecursionError) as error:
        raise _schema_error(error, where) from error
    check_consistency(file, where)
    return file


def check_robot(file: ParameterFile, robot: "Robot", *, where: str = "") -> tuple[str, ...]:
    """Compare the robot of a parameter file with the robot file in use; returns warnings.

    Raises ConfigError: the joints differ: these are parameters of another robot.
    """
    mine, theirs = list(robot.joint_names), file.robot.joints
    if mine != theirs:
        message = (
            f"is about robot {file.robot.name!r} with joints {', '.join(theirs)}, "
            f"but {robot.source} is {robot.name!r} with joints {', '.join(mine)}"
        )
        raise ConfigError(message, where=where, hint="Give the robot file it was made with (-r).")
    if file.robot.sha256 != robot.sha256:
        return (f"{where}: the robot file {robot.source} has changed since this was identified",)
    return ()


def write_json_atomic(path: Path, document: object, *, inputs: Iterable[Path] = ()) -> None:
    """Write a document as JSON in one step, with 12 significant digits.

    Raises UsageError: `path` cannot be written or is one of `inputs`. Raises ValueError: a number
    is not finite (a bug); nothing is written.
    """
    write_text_atomic(path, encode(document), inputs=inputs)


def file_sha256(path: Path) -> str:
    """SHA-256 of a small file's content."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def read_bytes(path: Path) -> bytes:
    """Read a JSON file whole.

    Raises ConfigError: it is missing, no regular file, unreadable, or far too large to be one of
    ours.
    """
    where = str(path)
    try:
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise ConfigError(what, where=where, hint="Check the path given with -p.")
        size = path.stat().st_size
        if size > _MAX_BYTES:
            message = f"has {size} bytes, the limit is {_MAX_BYTES}"
            raise ConfigError(message, where=where, hint="-p takes a parameter file, not a log.")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        message = f"cannot be read: {reason}"
        raise ConfigError(message, where=where, hint="Check the path and the rights.") from error


def parse_document(data: bytes, where: str) -> Json:
    """Read the content of the file `where` as one JSON object.

    Raises ConfigError: it is not a JSON object; the message gives line and column.
    """
    hint = "-p takes a JSON file that seqid wrote."
    try:
        document = msgspec.json.decode(data, type=dict[str, object])
    except msgspec.ValidationError as error:
        raise ConfigError(_without_key(error), where=where, hint=hint) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        message = f"is not valid JSON: {_syntax(error, data)}"
        raise ConfigError(message, where=where, hint=hint) from error
    huge = _HUGE.search(data)
    if huge:
        line = data.count(b"\n", 0, huge.start()) + 1
        message = f"holds the number {huge[0][:20].decode()} at line {line}, beyond 1e30"
        raise ConfigError(message, where=where, hint="Run the command again that wrote it.")
    return document


def _syntax(error: Exception, data: bytes) -> str:
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    text = str(error).removeprefix("JSON is malformed: ")
    match = _BYTE.search(text)
    end = int(match.group(1)) if match else len(data)
    line = data.count(b"\n", 0, end) + 1
    column = end - (data.rfind(b"\n", 0, end) + 1) + 1
    return f"{_BYTE.sub('', text).strip()} at line {line}, column {column}"


def _without_key(error: Exception) -> str:
    match = _PLACE.match(str(error))
    return match.group("what") if match else str(error)


def _schema_error(error: Exception, where: str) -> ConfigError:
    hint = "A parameter file is not made to be edited: run the stage again that wrote it."
    if isinstance(error, RecursionError):
        return ConfigError("is nested too deeply", where=where, hint=hint)
    match = _PLACE.match(str(error))
    if match is None:
        return ConfigError(str(error), where=where, hint=hint)
    return ConfigError(f"{match.group('key')}: {match.group('what')}", where=where, hint=hint)


def _version(document: Json, where: str, newest: int) -> int:
    name = document.get("schema")
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        message = "is not a parameter file: `schema` is " + (
            "missing" if name is None else repr(name)[:60]
        )
        raise ConfigError(message, where=where, hint="-p takes a file that a stage wrote with -o.")
    kind, version = match.group("kind"), int(match.group("version"))
    if kind != "params":
        message = f"is a {kind} file ({name}), not a parameter file"
        raise ConfigError(message, where=where, hint=f"Give the parameters that the {kind} used.")
    if version > newest:
        message = f"is of the newer version {name}; this seqid reads up to seqid/params@{newest}"
        raise ConfigError(message, where=where, hint="Upgrade seqid: pip install --upgrade seqid.")
    return version


def _migrated(
    document: Json, found: int, where: str, version: int, steps: Mapping[int, Migration]
) -> bytes:
    """Bring a document of an older version up to date, one step at a time."""
    try:
        for current in range(found, version):
            document = steps[current](document)
        return msgspec.json.encode(document)
    except (LookupError, TypeError, ValueError) as error:
        message = f"is of the old version seqid/params@{found} and cannot be brought up to date"
        raise ConfigError(message, where=where, hint="Identify again from the logs.") from error


@dataclass(frozen=True)
class Source:
    """A document and the file that it came from: its path as given and its SHA-256."""

    path: str
    sha256: str
    content: Document


def read_any(paths: Sequence[Path]) -> list[Source]:
    """Read parameter files and results about one robot, in the order given.

    Raises ConfigError: one is missing, is no JSON, is no document of these kinds, is newer than
    this version knows, or does not follow its schema. The message names the file and the key.
    """
    return [_read(path) for path in paths]


def read_trend(path: Path) -> TrendFile | None:
    """Read a trend; None where the document is another one.

    Raises ConfigError: it is missing, is no JSON, does not follow its schema, or a series is torn.
    """
    data, document = _opened(path)
    if document.get("schema") != TREND_SCHEMA:
        return None
    found = _decoded(data, TrendFile, "trend", str(path))
    for k, series in enumerate(found.series):
        if not _dated(series):
            message = f"$.series[{k}]: dates, values and std_errors must be of one length, as dates"
            hint = "Run seqid trend again."
            raise ConfigError(message, where=str(path), hint=hint)
    return found


def _dated(series: SeriesEntry) -> bool:
    try:
        times = [datetime.fromisoformat(date).timestamp() for date in series.dates]
    except (ValueError, OverflowError):
        return False
    return 0 < len(times) == len(series.values) == len(series.std_errors)


def _opened(path: Path) -> tuple[bytes, Json]:
    where = str(path)
    try:
        data = read_bytes(path)
        return data, parse_document(data, where)
    except ConfigError as error:
        raise ConfigError(error.message, where=where, hint=_RESULT_HINT) from error


def _decoded(data: bytes, form: type[T], kind: str, where: str) -> T:
    """Decode a result that is of a known kind."""
    try:
        return msgspec.json.decode(data, type=form)
    except (msgspec.ValidationError, RecursionError) as error:
        hint = f"The file was edited or damaged: run the command that wrote the {kind} again."
        raise ConfigError(str(error), where=where, hint=hint) from error


def _read(path: Path) -> Source:
    where = str(path)
    data, document = _opened(path)
    sha256 = hashlib.sha256(data).hexdigest()
    name = document.get("schema")
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        what = "missing" if name is None else repr(name)[:60]
        raise ConfigError(f"is no result: `schema` is {what}", where=where, hint=_RESULT_HINT)
    if match["kind"] == "params":
        file = _parameters(data, document, where, PARAMS_VERSION, PARAMS_MIGRATIONS)
        return Source(where, sha256, file)
    return Source(where, sha256, _result(data, match, where))


def _result(data: bytes, match: re.Match[str], where: str) -> Result:
    name, kind = match.group(), match["kind"]
    if name in _RESULTS:
        return _decoded(data, _RESULTS[name], kind, where)
    known = [known for known in _RESULTS if known.startswith(f"seqid/{kind}@")]
    if not known:
        kinds = ", ".join(schema.split("@")[0] for schema in (SCHEMA, *_RESULTS))
        message = f"is a {kind} file ({name}); what can be read here: {kinds}"
        raise ConfigError(message, where=where, hint="Leave it out.")
    message = f"is of the version {name}; this seqid reads {known[0]}"
    hint = "Upgrade seqid: pip install --upgrade seqid."
    raise ConfigError(message, where=where, hint=hint)
