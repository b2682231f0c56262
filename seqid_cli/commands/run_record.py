"""The record of a run: a result is kept as long as what it was made of stays.

Beside the results of a run stands `.run.json`; the dot keeps it out of `*.json`. For
each result it says from which files it was made, by path, size and SHA-256, with which
command line and by which version. Times of files count for nothing: they change when a
folder is copied or checked out.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from seqid_cli import __version__
from seqid_cli.logs.storage.files import sha256_of
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.run import FileContent, RunFile, StepRecord

RECORD = ".run.json"


class Record:
    """The record of a folder of results, written anew after every step."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / RECORD
        self._hashes: dict[tuple[Path, int, int], str] = {}
        try:
            self._steps = msgspec.json.decode(
                self._path.read_bytes(), type=RunFile
            ).steps
        except (OSError, msgspec.MsgspecError):
            # Without a record, or with one that nobody understands, everything is made
            # anew.
            self._steps = {}

    def kept(
        self,
        command_line: Sequence[str],
        inputs: Iterable[Path],
        outputs: Iterable[Path],
    ) -> StepRecord | None:
        """Return the record of a step whose results are made of the same, or None.

        Parameters
        ----------
        command_line : sequence of str
            The command with its options, as it would be run now.
        inputs : iterable of Path
            Files and folders that it reads; of a folder all files count.
        outputs : iterable of Path
            What it writes, the result first. A file that changed since is none of the
            run's.

        Returns
        -------
        StepRecord or None
            None where the step is to be run: something is missing or has changed.
        """
        outputs = list(outputs)
        record = self._steps.get(outputs[0].name)
        if record is None or not all(path.is_file() for path in outputs):
            return None
        current = self._of(command_line, inputs, outputs)
        current.partial = record.partial
        return record if current == record else None

    def add(
        self,
        command_line: Sequence[str],
        inputs: Iterable[Path],
        outputs: Iterable[Path],
        *,
        partial: bool,
    ) -> None:
        """Record how the results that a step has just written were made."""
        outputs = list(outputs)
        record = self._of(command_line, inputs, outputs)
        record.partial = partial
        self._steps[outputs[0].name] = record
        write_json_atomic(self._path, RunFile(steps=self._steps))

    def _of(
        self,
        command_line: Sequence[str],
        inputs: Iterable[Path],
        outputs: Iterable[Path],
    ) -> StepRecord:
        input_files = sorted({file for path in inputs for file in _files_of(path)})
        return StepRecord(
            command_line=list(command_line),
            version=__version__,
            inputs=[self._content(file) for file in input_files],
            outputs=[self._content(file) for file in outputs],
        )

    def _content(self, path: Path) -> FileContent:
        """Return what a file holds now; a log of several steps is hashed once."""
        state = path.stat()
        key = path, state.st_size, state.st_mtime_ns
        if key not in self._hashes:
            self._hashes[key] = sha256_of(path)
        return FileContent(path=str(path), size=state.st_size, sha256=self._hashes[key])


def _files_of(path: Path) -> list[Path]:
    """Return a file, or all files of a folder but hidden ones."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    files = []
    for file in path.rglob("*"):
        parts = file.relative_to(path).parts
        is_hidden = any(part.startswith(".") for part in parts)
        if file.is_file() and not is_hidden:
            files.append(file)
    return files
