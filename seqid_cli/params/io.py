"""Read and write documents. A fault is reported with its place in the file."""

import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA, DiagnosisFile
from seqid_cli.params.results.payload import PAYLOAD_SCHEMA, PayloadFile
from seqid_cli.params.results.plan import PLAN_SCHEMA, PlanFile
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA, PredictionFile
from seqid_cli.params.results.trend import TREND_SCHEMA, TrendFile
from seqid_cli.params.schema import SCHEMA, ParameterFile

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

T = TypeVar("T")
Json = dict[str, object]
Migration = Callable[[Json], Json]
Result = PredictionFile | DiagnosisFile | PayloadFile | PlanFile
Document = ParameterFile | Result
D = TypeVar("D", bound=Document, covariant=True)

PARAMS_VERSION = 1
# From each older version: the function that turns it into the next. Version 1 is the oldest.
PARAMS_MIGRATIONS: Mapping[int, Migration] = {}
_RESULTS: Mapping[str, type[Result]] = {
    PREDICTION_SCHEMA: PredictionFile,
    DIAGNOSIS_SCHEMA: DiagnosisFile,
    PAYLOAD_SCHEMA: PayloadFile,
    PLAN_SCHEMA: PlanFile,
}
_PARAMETER_HINT = "-p takes a JSON file that seqid wrote with -o."
_RESULT_HINT = "Name JSON files that seqid wrote with -o."
_UPGRADE = "Upgrade seqid: pip install --upgrade seqid."
_MAX_BYTES = 256 * 1024 * 1024
_NAME = re.compile(r"seqid/(?P<kind>[a-z_]+)@(?P<version>[1-9][0-9]{0,5})")
_BYTE = re.compile(r"\(byte (\d+)\)")
# 1e30 and more: no result has such numbers, and their squares and products overflow.
_HUGE = re.compile(rb"(?<=[\s:,\[])-?(?:[0-9.]+[eE]\+?(?:[3-9][0-9]|[0-9]{3,})|[0-9]{31,})")
_PLACE = re.compile(r"^(?P<what>.*) - at `(?P<key>.*)`$")


@dataclass(frozen=True)
class Source(Generic[D]):
    """A document and the file that it came from: its path as given and its SHA-256."""

    path: str
    sha256: str
    content: D


def read_parameters(path: Path) -> ParameterFile:
    """Read one parameter file strictly.

    Raises ConfigError: the file is missing, is no JSON, is another kind of document, is newer than
    this version knows, or does not follow the schema. The message names the line or the key.
    """
    data, document = _opened(path, _PARAMETER_HINT)
    name = _schema_of(document, "not a parameter file", str(path), _PARAMETER_HINT)
    if name["kind"] != "params":
        message = f"is a {name['kind']} file ({name[0]}), not a parameter file"
        hint = f"Give the parameters that the {name['kind']} used."
        raise ConfigError(message, where=str(path), hint=hint)
    return _parameters(data, document, int(name["version"]), str(path))


def _parameters(data: bytes, document: Json, found: int, where: str) -> ParameterFile:
    """Decode a parameter file; one of an older version is brought up to date step by step."""
    if found > PARAMS_VERSION:
        newest = f"seqid/params@{PARAMS_VERSION}"
        message = f"is of the newer version seqid/params@{found}; this seqid reads up to {newest}"
        raise ConfigError(message, where=where, hint=_UPGRADE)
    try:
        for current in range(found, PARAMS_VERSION):
            document = PARAMS_MIGRATIONS[current](document)
            data = msgspec.json.encode(document)
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        message = f"is of the old version seqid/params@{found} and cannot be brought up to date"
        raise ConfigError(message, where=where, hint="Identify again from the logs.") from error
    file = _decoded(data, ParameterFile, "parameters", where)
    check_consistency(file, where)
    return file


def read_any(paths: Sequence[Path]) -> list[Source[Document]]:
    """Read parameter files and results about one robot, in the order given.

    Raises ConfigError: one is missing, is no JSON, is no document of these kinds, is newer than
    this version knows, or does not follow its schema. The message names the file and the key.
    """
    found: list[Source[Document]] = []
    for path in paths:
        data, document = _opened(path, _RESULT_HINT)
        name = _schema_of(document, "no result", str(path), _RESULT_HINT)
        content = _content(data, document, name, str(path))
        found.append(Source(str(path), hashlib.sha256(data).hexdigest(), content))
    return found


def _content(data: bytes, document: Json, name: re.Match[str], where: str) -> Document:
    """Decode a document by the name of its schema."""
    kind = name["kind"]
    if kind == "params":
        return _parameters(data, document, int(name["version"]), where)
    if name[0] in _RESULTS:
        result = _decoded(data, _RESULTS[name[0]], kind, where)
        check_consistency(result, where)
        return result
    known = [known for known in _RESULTS if known.startswith(f"seqid/{kind}@")]
    message = f"is of the version {name[0]}; this seqid reads {', '.join(known)}"
    if not known:
        kinds = ", ".join(schema.split("@")[0] for schema in (SCHEMA, *_RESULTS))
        message = f"is a {kind} file ({name[0]}); what can be read here: {kinds}"
    raise ConfigError(message, where=where, hint=_UPGRADE if known else "Leave it out.")


def read_trend(path: Path) -> TrendFile | None:
    """Read a trend; None where the document is another one.

    Raises ConfigError: it is missing, is no JSON, does not follow its schema, or a series is torn.
    """
    data, document = _opened(path, _RESULT_HINT)
    if document.get("schema") != TREND_SCHEMA:
        return None
    return _decoded(data, TrendFile, "trend", str(path))


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
    return hashlib.sha256(_bytes(path)).hexdigest()


def _bytes(path: Path, hint: str = "Check the path given with -p.") -> bytes:
    """Read a JSON file whole: a regular one that is not far too large to be one of ours."""
    where = str(path)
    try:
        if not path.is_file():
            what = "is not a file" if path.exists() else "does not exist"
            raise ConfigError(what, where=where, hint=hint)
        size = path.stat().st_size
        if size > _MAX_BYTES:
            message = f"has {size} bytes, the limit is {_MAX_BYTES}"
            raise ConfigError(message, where=where, hint=hint)
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        message = f"cannot be read: {reason}"
        raise ConfigError(message, where=where, hint="Check the path and the rights.") from error


def _opened(path: Path, hint: str) -> tuple[bytes, Json]:
    """Read a file as one JSON object; an error of its syntax has line and column."""
    where, data = str(path), _bytes(path, hint)
    try:
        document = msgspec.json.decode(data, type=dict[str, object])
    except msgspec.ValidationError as error:
        raise ConfigError(str(error).partition(" - at `")[0], where=where, hint=hint) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        message = f"is not valid JSON: {_syntax(error, data)}"
        raise ConfigError(message, where=where, hint=hint) from error
    huge = _HUGE.search(data)
    if huge:
        line = data.count(b"\n", 0, huge.start()) + 1
        message = f"holds the number {huge[0][:20].decode()} at line {line}, beyond 1e30"
        raise ConfigError(message, where=where, hint="Run the command again that wrote it.")
    return data, document


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


def _schema_of(document: Json, what: str, where: str, hint: str) -> re.Match[str]:
    name = document.get("schema")
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        found = "missing" if name is None else repr(name)[:60]
        raise ConfigError(f"is {what}: `schema` is {found}", where=where, hint=hint)
    return match


def _decoded(data: bytes, form: type[T], kind: str, where: str) -> T:
    """Decode a document that is of a known kind."""
    try:
        return msgspec.json.decode(data, type=form)
    except (msgspec.ValidationError, RecursionError) as error:
        match = _PLACE.match(str(error))
        text = f"{match['key']}: {match['what']}" if match else str(error)
        message = "is nested too deeply" if isinstance(error, RecursionError) else text
        hint = f"The file was edited or damaged: run the command that wrote the {kind} again."
        raise ConfigError(message, where=where, hint=hint) from error
