"""Reading and writing of documents; a fault is reported with its place in the file."""

import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, cast

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.comparison import ComparisonFile
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.export import ExportFile
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.replay import ReplayFile
from seqid_cli.params.results.trend import TrendFile
from seqid_cli.params.schema import OfRobot, ParameterFile, Written

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

Json = dict[str, object]
Result = (
    PredictionFile | DiagnosisFile | PayloadFile | PlanFile | DriveFile | ReplayFile
)
Document = ParameterFile | Result
D = TypeVar("D", bound=Document, covariant=True)

PARAMS_VERSION = 1  # newest; of the other kinds there is one version
# Functions that turn a document of an older version into one of the next. Version 1 is
# the oldest.
PARAMS_MIGRATIONS: Mapping[int, Callable[[Json], Json]] = {}
_KINDS: Mapping[str, type[Written]] = {
    "params": ParameterFile,
    "prediction": PredictionFile,
    "diagnosis": DiagnosisFile,
    "payload": PayloadFile,
    "drive": DriveFile,
    "replay": ReplayFile,
    "plan": PlanFile,
    "trend": TrendFile,
    "inspection": InspectionFile,
    "comparison": ComparisonFile,
    "export": ExportFile,
}
_OF_ROBOT = ("params", "prediction", "diagnosis", "payload", "plan")
# What a page is made of.
OF_PAGE = (*_OF_ROBOT, "drive", "replay")
_PARAMETER_HINT = "-p takes a JSON file that seqid wrote with -o."
_RESULT_HINT = "Name JSON files that seqid wrote with -o."
_MAX_BYTES = 256 * 1024 * 1024
_NAME = re.compile(r"seqid/(?P<kind>[a-z_]+)@(?P<version>[1-9][0-9]{0,5})")
_BYTE = re.compile(r"\(byte (\d+)\)")
# 1e30 and more: no result has such numbers, and their squares and products overflow.
_HUGE = re.compile(
    rb"(?<=[\s:,\[])-?(?:[0-9.]+[eE]\+?(?:[3-9][0-9]|[0-9]{3,})|[0-9]{31,})"
)
_PLACE = re.compile(r"^(?P<what>.*) - at `(?P<key>.*)`$")


@dataclass(frozen=True)
class Source(Generic[D]):
    """A document and the file that it came from: its path as given and its SHA-256."""

    path: str
    sha256: str
    content: D


def read_parameters(path: Path) -> ParameterFile:
    """Read one parameter file strictly.

    Raises
    ------
    ConfigError
        The file is missing, is no JSON, is another kind of document, is newer than this
        version knows, or does not follow the schema. The message names the line or the
        key.
    """
    _, content = _read(path, ["params"], _PARAMETER_HINT)
    return cast(ParameterFile, content)


def read_drive(path: Path) -> DriveFile:
    """Read one drive file strictly; raises as `read_parameters` does."""
    _, content = _read(path, ["drive"], "-p takes the result of seqid drive.")
    return cast(DriveFile, content)


def read_document(path: Path) -> Written:
    """Read a document of any kind, strictly.

    Raises
    ------
    ConfigError
        As `read_parameters` does; the message names the file and the key.
    """
    _, content = _read(path, list(_KINDS), _RESULT_HINT)
    return cast(Written, content)


def read_any(
    paths: Sequence[Path], kinds: Collection[str] = _OF_ROBOT
) -> list[Source[Document]]:
    """Read parameter files and results about one robot, in the order given.

    `kinds`: those that are taken.

    Raises
    ------
    ConfigError
        As `read_parameters` does; the message names the file and the key.
    """
    sources = []
    for path in paths:
        sha256, content = _read(path, kinds, _RESULT_HINT)
        sources.append(Source(path=str(path), sha256=sha256, content=content))
    return sources


def read_trend(path: Path) -> TrendFile | None:
    """Read a trend; None where it is another document.

    Raises as `read_parameters` does.
    """
    opened = _opened(path, _RESULT_HINT)
    if not str(opened.document.get("schema")).startswith("seqid/trend@"):
        return None
    _, content = _read(path, ["trend"], _RESULT_HINT, opened)
    return cast(TrendFile, content)


class _Opened(NamedTuple):
    """A file's bytes, and the JSON object in them."""

    data: bytes
    document: Json


class _Schema(NamedTuple):
    """The schema of a document, "seqid/params@1", in its parts."""

    name: str
    kind: str
    version: int


def _read(
    path: Path,
    kinds: Collection[str],
    hint: str,
    opened: _Opened | None = None,
) -> tuple[str, Any]:
    """Return SHA-256 and content of a document of these kinds, brought up to date."""
    where = str(path)
    if opened is None:
        opened = _opened(path, hint)
    schema = _schema_of(opened.document, kinds, where, hint)
    data = _up_to_date(opened, schema, where)
    try:
        content = msgspec.json.decode(data, type=_KINDS[schema.kind])
    except (msgspec.ValidationError, RecursionError) as error:
        remedy = (
            f"The file was edited or damaged: run the command that wrote the"
            f" {schema.kind} again."
        )
        raise ConfigError(_fault(error), where=where, hint=remedy) from error
    if isinstance(content, OfRobot):
        check_consistency(content, where)
    return hashlib.sha256(opened.data).hexdigest(), content


def _up_to_date(opened: _Opened, schema: _Schema, where: str) -> bytes:
    """Return the JSON text of a document in the newest version of its schema."""
    newest = PARAMS_VERSION if schema.kind == "params" else 1
    if schema.version > newest:
        message = (
            f"is of the newer version {schema.name}; this seqid reads up to"
            f" seqid/{schema.kind}@{newest}"
        )
        raise ConfigError(
            message, where=where, hint="Upgrade seqid: pip install --upgrade seqid."
        )
    data = opened.data
    document = opened.document
    try:
        for version in range(schema.version, newest):
            document = PARAMS_MIGRATIONS[version](document)
            data = msgspec.json.encode(document)
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        message = (
            f"is of the old version {schema.name} and cannot be brought up to date"
        )
        raise ConfigError(
            message, where=where, hint="Identify again from the logs."
        ) from error
    return data


def _fault(error: Exception) -> str:
    """Return what a decoder says of a document, its key first."""
    if isinstance(error, RecursionError):
        return "is nested too deeply"
    match = _PLACE.match(str(error))
    return f"{match['key']}: {match['what']}" if match else str(error)


def _schema_of(
    document: Json, kinds: Collection[str], where: str, hint: str
) -> _Schema:
    """Return the schema of a document, which must be of one of these kinds."""
    schema = document.get("schema")
    match = _NAME.fullmatch(schema) if isinstance(schema, str) else None
    if match is None:
        text = "missing" if schema is None else repr(schema)[:60]
        raise ConfigError(f"is no result: `schema` is {text}", where=where, hint=hint)
    name = match[0]
    kind = match["kind"]
    if kind not in kinds:
        readable = ", ".join(f"seqid/{kind}" for kind in kinds)
        message = f"is a {kind} file ({name}); what can be read here: {readable}"
        remedy = "Leave it out."
        if len(kinds) == 1:
            is_wanted = "params" in kinds
            remedy = f"Give the parameters that the {kind} used." if is_wanted else hint
        raise ConfigError(message, where=where, hint=remedy)
    return _Schema(name=name, kind=kind, version=int(match["version"]))


def check_robot(file: OfRobot, robot: "Robot", *, where: str = "") -> tuple[str, ...]:
    """Return warnings where the robot file has changed since a document was made.

    Parameters
    ----------
    file : OfRobot
        The document.
    robot : Robot
        The robot by its file of today.
    where : str
        Path of the document, for messages.

    Raises
    ------
    ConfigError
        The document is about another robot.
    """
    joints = list(robot.joint_names)
    joints_of_file = file.robot.joints
    if joints != joints_of_file:
        message = (
            f"is about robot {file.robot.name!r} with joints"
            f" {', '.join(joints_of_file)}, but {robot.source} is {robot.name!r} with"
            f" joints {', '.join(joints)}"
        )
        raise ConfigError(
            message, where=where, hint="Give the robot file it was made with (-r)."
        )
    if file.robot.sha256 == robot.sha256:
        return ()
    warning = (
        f"{where}: the robot file {robot.source} has changed since this was identified"
    )
    return (warning,)


def write_json_atomic(
    path: Path, document: object, *, inputs: Iterable[Path] = ()
) -> None:
    """Write a document as JSON in one step.

    Errors are those of `encode` and `check_output`; none of `inputs` is overwritten.
    """
    write_text_atomic(path, encode(document), inputs=inputs)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a small file's content."""
    return hashlib.sha256(_bytes(path)).hexdigest()


def _bytes(path: Path, hint: str = "Check the path given with -p.") -> bytes:
    """Read a JSON file whole, unless it is far too large for a result."""
    where = str(path)
    try:
        if not path.is_file():
            fault = "is not a file" if path.exists() else "does not exist"
            raise ConfigError(fault, where=where, hint=hint)
        size = path.stat().st_size
        if size > _MAX_BYTES:
            message = f"has {size} bytes, the limit is {_MAX_BYTES}"
            raise ConfigError(message, where=where, hint=hint)
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(
            f"cannot be read: {reason}",
            where=where,
            hint="Check the path and the rights.",
        ) from error


def _opened(path: Path, hint: str) -> _Opened:
    """Read a file as one JSON object; an error of its syntax has line and column."""
    where = str(path)
    data = _bytes(path, hint)
    try:
        document = msgspec.json.decode(data, type=dict[str, object])
    except msgspec.ValidationError as error:
        raise ConfigError(
            str(error).partition(" - at `")[0], where=where, hint=hint
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        message = f"is not valid JSON: {_syntax(error, data)}"
        raise ConfigError(message, where=where, hint=hint) from error
    huge = _HUGE.search(data)
    if huge:
        line = data.count(b"\n", 0, huge.start()) + 1
        message = (
            f"holds the number {huge[0][:20].decode()} at line {line}, beyond 1e30"
        )
        raise ConfigError(
            message, where=where, hint="Run the command again that wrote it."
        )
    return _Opened(data=data, document=document)


def _syntax(error: Exception, data: bytes) -> str:
    """Return what is wrong with a JSON text, with its line and column if known."""
    # Which error the decoder raises for bytes that are no text depends on its version.
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "it is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    text = str(error).removeprefix("JSON is malformed: ")
    match = _BYTE.search(text)
    position = int(match[1]) if match else len(data)
    read = data[:position]
    line = read.count(b"\n") + 1
    column = len(read) - read.rfind(b"\n")
    return f"{_BYTE.sub('', text).strip()} at line {line}, column {column}"
