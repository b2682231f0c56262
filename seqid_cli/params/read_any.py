"""Reading whatever seqid wrote: the schema that a document names decides what it is."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params.diagnosis_schema import DIAGNOSIS_SCHEMA, DiagnosisFile
from seqid_cli.params.io import parse_document, read_bytes, read_parameters
from seqid_cli.params.prediction_schema import PREDICTION_SCHEMA, PredictionFile
from seqid_cli.params.schema import SCHEMA, ParameterFile

Document = ParameterFile | PredictionFile | DiagnosisFile

_NAME = re.compile(r"seqid/(?P<kind>[a-z_]+)@(?P<version>[1-9][0-9]{0,5})")
_RESULTS: Mapping[str, type[PredictionFile] | type[DiagnosisFile]] = {
    PREDICTION_SCHEMA: PredictionFile,
    DIAGNOSIS_SCHEMA: DiagnosisFile,
}
_HINT = "Name JSON files that seqid wrote with -o."


@dataclass(frozen=True)
class Source:
    """A document and the file that it came from: its path as given and its SHA-256."""

    path: str
    sha256: str
    content: Document


def read_any(paths: Sequence[Path]) -> list[Source]:
    """Read parameter, prediction and diagnosis files, in the order given.

    Raises
    ------
    ConfigError
        One is missing, is no JSON, is no document of these kinds, is newer than this version
        knows, or does not follow its schema. The message names the file and the key.
    """
    return [_read(path) for path in paths]


def _read(path: Path) -> Source:
    where = str(path)
    try:
        data = read_bytes(path)
        name = parse_document(data, where).get("schema")
    except ConfigError as error:
        raise ConfigError(error.message, where=where, hint=_HINT) from error
    sha256 = hashlib.sha256(data).hexdigest()
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        what = "missing" if name is None else repr(name)[:60]
        raise ConfigError(f"is no result: `schema` is {what}", where=where, hint=_HINT)
    if match["kind"] == "params":
        return Source(where, sha256, read_parameters(path))
    return Source(where, sha256, _result(data, match, where))


def _result(data: bytes, match: re.Match[str], where: str) -> PredictionFile | DiagnosisFile:
    name, kind = match.group(), match["kind"]
    if name in _RESULTS:
        try:
            return msgspec.json.decode(data, type=_RESULTS[name])
        except (msgspec.ValidationError, RecursionError) as error:
            hint = f"The file was edited or damaged: run the command that wrote the {kind} again."
            raise ConfigError(str(error), where=where, hint=hint) from error
    known = [known for known in _RESULTS if known.startswith(f"seqid/{kind}@")]
    if not known:
        kinds = ", ".join(schema.split("@")[0] for schema in (SCHEMA, *_RESULTS))
        message = f"is a {kind} file ({name}); what can be read here: {kinds}"
        raise ConfigError(message, where=where, hint="Leave it out.")
    message = f"is of the version {name}; this seqid reads {known[0]}"
    hint = "Upgrade seqid: pip install --upgrade seqid."
    raise ConfigError(message, where=where, hint=hint)
