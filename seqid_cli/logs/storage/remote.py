"""Logs on object storage (whatever fsspec knows), and tables in memory (Arrow, pandas, polars).

A stored log is a path like any other until it is read. Then it is copied to a temporary
file, read from there by the same readers as local logs, and the copy is removed: memory
stays flat, and one log at a time (per process) lies on the disk. Access is configured
as the store's own tools are, by environment and profile; nothing of it passes through
here. A table is stored the same way: whoever reads it gets a Parquet file, which is
removed afterwards, in this process or in others.

Rows are set aside on the disk as well (`Spool`): decoding a compressed column costs ten
times what reading it back costs. Their file lies where temporary files do (`TMPDIR`),
has no name where the system allows, and goes with whoever holds it. Where there is too
little room, or the rows become too many, there is none.
"""

from __future__ import annotations

import glob
import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from seqid_cli.errors import ConfigError, InputError, SeqidError, UsageError
from seqid_cli.params.files import process_runs

if TYPE_CHECKING:
    from datetime import datetime

    from seqid_cli.logs.raw import Array, Stamps

    _LocalPath = Path
else:
    # the system's own kind of path, which can be inherited from
    _LocalPath = type(Path())


class Spool:
    """Takes rows, up to `most_bytes` and a `share` of the free space, and gives them back."""

    def __init__(self, most_bytes: int = 1 << 31, share: float = 0.25) -> None:
        self._file: IO[bytes] | None = None
        self._shapes: list[tuple[int, int]] = []
        self._size = 0
        try:
            self._most = min(
                most_bytes, share * shutil.disk_usage(tempfile.gettempdir()).free
            )
            self._file = tempfile.TemporaryFile(prefix="seqid-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        except OSError:
            self._give_up()

    @property
    def complete(self) -> bool:
        """Whether all rows that were pushed are there."""
        return self._file is not None

    def push(self, stamps: Stamps, values: Array) -> None:
        """Take the next rows: stamps (M,) ns, values (M, c)."""
        import numpy as np

        if self._file is None:
            return
        size = stamps.nbytes + values.nbytes
        try:
            if self._size + size > self._most:
                raise OSError("too many rows")
            # Room that is asked for at once costs a third of what it costs page by
            # page.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._file.fileno(), self._size, size)
            stamps.tofile(self._file)
            np.ascontiguousarray(values.T).tofile(self._file)
        except OSError:
            self._give_up()
            return
        self._size += size
        self._shapes.append(values.shape)

    def _give_up(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def parts(self) -> Iterator[tuple[Stamps, Array]]:
        """Yield the rows as they came; they may be overwritten."""
        import numpy as np

        assert self._file is not None
        place = 0
        for rows, columns in self._shapes:
            self._file.seek(place)
            stamps = np.fromfile(self._file, np.int64, rows)
            values = np.fromfile(self._file, np.float64, rows * columns)
            if len(values) < rows * columns:
                raise OSError("the temporary file of the decoded rows was cut short")
            place += stamps.nbytes + values.nbytes
            yield stamps, values.reshape(columns, rows).T


@contextmanager
def temporary_folder(where: str) -> Iterator[Path]:
    """Yield an empty folder for a copy; those that killed runs left are removed first."""
    for left in Path(tempfile.gettempdir()).glob("seqid-*-*"):
        process = left.name.split("-")[1]
        if process.isdecimal() and not process_runs(int(process)):
            shutil.rmtree(left, ignore_errors=True)
    try:
        folder = tempfile.TemporaryDirectory(prefix=f"seqid-{os.getpid()}-")
    except OSError as error:
        message = f"cannot be copied: {error.strerror or error}"
        hint = (
            f"Check the space for temporary files in {tempfile.gettempdir()} (TMPDIR)."
        )
        raise InputError(message, hint=hint, where=where) from error
    with folder as name:
        yield Path(name)


_URL = re.compile(r"[a-z][a-z0-9+.-]+://")  # two letters at least: no drive of Windows
_EXTRAS = {"s3": "s3", "s3a": "s3", "gs": "gs", "gcs": "gs", "az": "az", "abfs": "az"}
_ACCESS = {
    "s3": (
        "Set AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, as for aws"
        " itself."
    ),
    "gs": (
        "Run `gcloud auth application-default login`, or set"
        " GOOGLE_APPLICATION_CREDENTIALS."
    ),
    "az": "Set AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY or _SAS_TOKEN.",
}
_REFUSED = re.compile(
    "NoCredentials|PartialCredentials|DefaultCredentials|ProfileNotFound|TokenRetrieval|"
    "RefreshError|ClientAuthentication|Forbidden|InvalidAccessKey|SignatureDoesNotMatch|"
    "PermissionError"
)


class StoredLog(_LocalPath):
    """The URL of a log on object storage, in the place of a path; `local_copy` opens the file."""

    def __str__(self) -> str:
        scheme, *rest = self.parts
        return f"{scheme}//{'/'.join(rest)}"

    def fetch(self, copy: Path) -> None:
        """Write the log's content to a local file."""
        url = str(self)
        system, root = _opened(url)
        with _explained(url):
            system.get_file(root, str(copy))

    def modified_s(self) -> float | None:
        """Return when the log was last modified [s, Unix]; None where its store does not say."""
        system, root = _opened(str(self))
        try:
            modified: datetime = system.modified(root)
        # every kind of store has errors of its own, and a date is no need
        except Exception:
            return None
        return modified.timestamp()


class TableLog(StoredLog):
    """A table in the default column names, in the place of a path; `content` is the table."""

    content: Any

    @classmethod
    def of(cls, data: object, name: str) -> TableLog:
        """Take a table under the name that results give it."""
        import pyarrow as pa

        log = cls(f"{name}.parquet")
        try:
            stream = hasattr(data, "__arrow_c_stream__")
            log.content = pa.table(data) if stream else pa.Table.from_pandas(data)
        except (TypeError, ValueError, AttributeError, pa.ArrowException) as error:
            hint = "Give a path, a pyarrow.Table, a pandas.DataFrame or a Recording."
            raise InputError(
                f"{type(data).__name__} is no log ({error})", hint=hint
            ) from error
        return log

    def __reduce__(self) -> Any:
        return TableLog.of, (self.content, self.stem)

    def __str__(self) -> str:
        return self.stem

    def modified_s(self) -> float | None:
        """Return None: a table in memory has no date."""
        return None

    def fetch(self, copy: Path) -> None:
        """Write the table to a local file."""
        import pyarrow.parquet as pq

        pq.write_table(self.content, copy)


def is_url(text: str) -> bool:
    """Whether an argument names something on object storage."""
    return _URL.match(text) is not None and not text.startswith("file://")


def stored_logs(url: str, suffixes: Sequence[str]) -> list[Path]:
    """Return the logs that a URL means: one, those of a folder at any depth, or those of a glob."""
    system, root = _opened(url)
    with _explained(url):
        magic = glob.has_magic(root)
        if not magic and system.isfile(root):
            return [StoredLog(url)]
        found = system.glob(root) if magic else system.find(root)
        found = [name for name in found if name.lower().endswith(tuple(suffixes))]
        logs: list[Path] = [StoredLog(system.unstrip_protocol(name)) for name in found]
    if not logs:
        hint = "Check bucket, folder and suffix."
        raise InputError("there is no log at this place", hint=hint, where=url)
    return [log for log in logs if not log.name.startswith(".")]


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """Yield a local file with the content of a log, itself where it is local.

    Problems with the copy's content are told under the name of the log.
    """
    if not isinstance(path, StoredLog):
        yield path
        return
    url = str(path)
    with temporary_folder(url) as folder:
        copy = folder / path.name
        path.fetch(copy)
        try:
            yield copy
        except SeqidError as error:
            error.where = error.where.replace(str(copy), url)
            error.message = error.message.replace(str(copy), url)
            raise


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL and the path within it."""
    scheme = url.partition("://")[0]
    try:
        from fsspec.core import url_to_fs

        with _explained(url):
            system, root = url_to_fs(url)
    except ImportError as error:
        hint = "Install fsspec and what it needs for this kind of storage."
        if scheme in _EXTRAS:
            hint = f"Install it: python -m pip install 'seqid[{_EXTRAS[scheme]}]'"
        message = f"logs on {scheme}:// need a package that is not installed ({error})"
        raise UsageError(message, where=url, hint=hint) from error
    return system, str(root)


@contextmanager
def _explained(url: str) -> Iterator[None]:
    """Turn what a store says into a message; every kind of store has errors of its own."""
    try:
        yield
    except (SeqidError, ImportError):
        raise
    except FileNotFoundError as error:
        raise InputError(
            "does not exist", hint="Check bucket and name.", where=url
        ) from error
    except Exception as error:
        said = (
            f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0][:200]}"
        )
        scheme = url.partition("://")[0]
        if isinstance(error, ValueError) and "rotocol not known" in str(error):
            message = f"{scheme}:// is no kind of storage that is known"
            raise UsageError(
                message, where=url, hint="s3://, gs:// and az:// are."
            ) from error
        if _REFUSED.search(f"{type(error).__name__} {error}"):
            hint = _ACCESS.get(
                _EXTRAS.get(scheme, ""), "Check the credentials of this store."
            )
            message = f"the store refuses access ({said})"
            raise ConfigError(message, where=url, hint=hint) from error
        hint = (
            "Check the network, the space for temporary files (TMPDIR) and the store."
        )
        raise InputError(f"cannot be read ({said})", where=url, hint=hint) from error
