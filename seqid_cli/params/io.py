"""Read and write documents. A fault is reported with its place in the file."""

import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.files import write_text_atomic
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.trend import TrendFile
from seqid_cli.params.schema import OfRobot, ParameterFile

if TYPE_CHECKING:
    from seqid_cli.robot.types import Robot

Json = dict[str, object]
Result = PredictionFile | DiagnosisFile | PayloadFile | PlanFile
Document = ParameterFile | Result
D = TypeVar("D", bound=Document, covariant=True)

PARAMS_VERSION = 1  # of the others there is one version
# From each older version: the function that turns it into the next. Version 1 is the
# oldest.
PARAMS_MIGRATIONS: Mapping[int, Callable[[Json], Json]] = {}
_KINDS: Mapping[str, type[Document | TrendFile]] = {
    "params": ParameterFile,
    "prediction": PredictionFile,
    "diagnosis": DiagnosisFile,
    "payload": PayloadFile,
    "plan": PlanFile,
    "trend": TrendFile,
}
_OF_ROBOT = ("params", "prediction", "diagnosis", "payload", "plan")
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

    Raises ConfigError: the file is missing, is no JSON, is another kind of document, is
    newer than this version knows, or does not follow the schema. The message names the
    line or the key.
    """
    return cast(ParameterFile, _read(path, ["params"], _PARAMETER_HINT)[1])


def read_any(paths: Sequence[Path]) -> list[Source[Document]]:
    """Read parameter files and results about one robot, in the order given.

    Raises ConfigError as `read_parameters` does; the message names the file and the
    key.
    """
    return [Source(str(path), *_read(path, _OF_ROBOT, _RESULT_HINT)) for path in paths]


def read_trend(path: Path) -> TrendFile | None:
    """Read a trend; None where it is another document.

    Raises as `read_parameters` does.
    """
    opened = _opened(path, _RESULT_HINT)
    if not str(opened[1].get("schema")).startswith("seqid/trend@"):
        return None
    return cast(TrendFile, _read(path, ["trend"], _RESULT_HINT, opened)[1])


def _read(
    path: Path,
    kinds: Collection[str],
    hint: str,
    opened: tuple[bytes, Json] | None = None,
) -> tuple[str, Any]:
    """Return SHA-256 and content of a document of these kinds; an old one is brought up to date."""
    where, (data, document) = str(path), opened or _opened(path, hint)
    sha256 = hashlib.sha256(data).hexdigest()
    schema, kind, version = _schema_of(document, kinds, where, hint)
    newest = PARAMS_VERSION if kind == "params" else 1
    if version > newest:
        message = (
            f"is of the newer version {schema}; this seqid reads up to"
            f" seqid/{kind}@{newest}"
        )
        raise ConfigError(
            message, where=where, hint="Upgrade seqid: pip install --upgrade seqid."
        )
    try:
        for older in range(version, newest):
            document = PARAMS_MIGRATIONS[older](document)
            data = msgspec.json.encode(document)
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        message = f"is of the old version {schema} and cannot be brought up to date"
        raise ConfigError(
            message, where=where, hint="Identify again from the logs."
        ) from error
    try:
        content = msgspec.json.decode(data, type=_KINDS[kind])
    except (msgspec.ValidationError, RecursionError) as error:
        match = _PLACE.match(str(error))
        text = f"{match['key']}: {match['what']}" if match else str(error)
        message = "is nested too deeply" if isinstance(error, RecursionError) else text
        remedy = (
            f"The file was edited or damaged: run the command that wrote the {kind}"
            " again."
        )
        raise ConfigError(message, where=where, hint=remedy) from error
    if isinstance(content, OfRobot):
        check_consistency(content, where)
    return sha256, content


def _schema_of(
    document: Json, kinds: Collection[str], where: str, hint: str
) -> tuple[str, str, int]:
    """Return the schema, kind and version of a document; raise unless it is of these kinds."""
    schema = document.get("schema")
    name = _NAME.fullmatch(schema) if isinstance(schema, str) else None
    if name is None:
        found = "missing" if schema is None else repr(schema)[:60]
        raise ConfigError(f"is no result: `schema` is {found}", where=where, hint=hint)
    if name["kind"] not in kinds:
        known = ", ".join(f"seqid/{kind}" for kind in kinds)
        message = (
            f"is a {name['kind']} file ({name[0]}); what can be read here: {known}"
        )
        hint = f"Give the parameters that the {name['kind']} used."
        raise ConfigError(
            message, where=where, hint=hint if len(kinds) == 1 else "Leave it out."
        )
    return name[0], name["kind"], int(name["version"])


def check_robot(file: OfRobot, robot: "Robot", *, where: str = "") -> tuple[str, ...]:
    """Return warnings if the robot file has changed since; raises ConfigError for another robot."""
    mine, theirs = list(robot.joint_names), file.robot.joints
    if mine != theirs:
        message = (
            f"is about robot {file.robot.name!r} with joints {', '.join(theirs)}, "
            f"but {robot.source} is {robot.name!r} with joints {', '.join(mine)}"
        )
        raise ConfigError(
            message, where=where, hint="Give the robot file it was made with (-r)."
        )
    if file.robot.sha256 != robot.sha256:
        return (
            (
                f"{where}: the robot file {robot.source} has changed since this was"
                " identified"
            ),
        )
    return ()


def write_json_atomic(
    path: Path, document: object, *, inputs: Iterable[Path] = ()
) -> None:
    """Write a document as JSON in one step; see `encode` and `check_output` for errors."""
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
        if (size := path.stat().st_size) > _MAX_BYTES:
            message = f"has {size} bytes, the limit is {_MAX_BYTES}"
            raise ConfigError(message, where=where, hint=hint)
        return path.read_bytes()
    except (OSError, ValueError) as error:
        message = (
            f"cannot be read: {error.strerror if isinstance(error, OSError) else error}"
        )
        raise ConfigError(
            message, where=where, hint="Check the path and the rights."
        ) from error


def _opened(path: Path, hint: str) -> tuple[bytes, Json]:
    """Read a file as one JSON object; an error of its syntax has line and column."""
    where, data = str(path), _bytes(path, hint)
    try:
        document = msgspec.json.decode(data, type=dict[str, object])
    except msgspec.ValidationError as error:
        raise ConfigError(
            str(error).partition(" - at `")[0], where=where, hint=hint
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        message = f"is not valid JSON: {_syntax(error, data)}"
        raise ConfigError(message, where=where, hint=hint) from error
    if huge := _HUGE.search(data):
        line = data.count(b"\n", 0, huge.start()) + 1
        message = (
            f"holds the number {huge[0][:20].decode()} at line {line}, beyond 1e30"
        )
        raise ConfigError(
            message, where=where, hint="Run the command again that wrote it."
        )
    return data, document


def _syntax(error: Exception, data: bytes) -> str:
    """What is wrong with a JSON text, with its line and column where that is known."""
    # Which error the decoder raises for bytes that are no text depends on its version.
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "it is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    text = str(error).removeprefix("JSON is malformed: ")
    match = _BYTE.search(text)
    before = data[: int(match[1]) if match else len(data)]
    line, column = before.count(b"\n") + 1, len(before) - before.rfind(b"\n")
    return f"{_BYTE.sub('', text).strip()} at line {line}, column {column}"
