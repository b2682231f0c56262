"""The record of a run, `seqid/run@1`: inputs, options and version of each result."""

from seqid_cli.params.base import Struct

RUN_SCHEMA = "seqid/run@1"


class FileContent(Struct, kw_only=True):
    """A file by its path, its size in bytes and the SHA-256 of its content."""

    path: str
    size: int
    sha256: str


class StepRecord(Struct, kw_only=True):
    """Origin of the results of one step; `partial`: some logs were read in part."""

    command_line: list[str]
    version: str
    inputs: list[FileContent]
    outputs: list[FileContent]
    partial: bool = False


class RunFile(Struct, kw_only=True):
    """The whole record, by the path of each step's result."""

    schema: str = RUN_SCHEMA
    steps: dict[str, StepRecord] = {}
