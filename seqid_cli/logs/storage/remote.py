"""Logs on object storage (whatever fsspec knows), and tables in memory.

A stored log is a path like any other until it is read. Then it is copied to a temporary
file, read from there by the same readers as local logs, and the copy is removed: memory
stays flat, and one log at a time (per process) lies on the disk. Access is configured
as the store's own tools are, by environment and profile; nothing of it passes through
here.

fsspec finds and fetches; the copy is made here, as its caches would be no help. Every
byte is read at any rate, for the digest that a result names, and a long log is passed
over up to three times: a file that is opened in the store, or `blockcache`, would fetch
it as often. `simplecache` makes the same copy by the same call, but keeps all of them
until the process ends, and a run that is killed leaves them; told a folder for each
log, it keeps a file system for each.

A table (Arrow, pandas, polars) is stored the same way: whoever reads it gets a Parquet
file, which is removed afterwards, in this process or in others.
"""

from __future__ import annotations

import contextlib
import glob
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from seqid_cli.errors import ConfigError, InputError, SeqidError, UsageError
from seqid_cli.params.files import held, is_abandoned

if TYPE_CHECKING:
    from datetime import datetime

    _LocalPath = Path
else:
    # the system's own kind of path, which can be inherited from
    _LocalPath = type(Path())


_PREFIX = "seqid-log-"


@contextlib.contextmanager
def temporary_folder(where: str) -> Iterator[Path]:
    """Yield an empty folder for a copy of the log `where`.

    Folders that killed runs have left are removed first.
    """
    for leftover in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        if is_abandoned(leftover):
            shutil.rmtree(leftover, ignore_errors=True)
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(held(_new_folder(stack)))
        except OSError as error:
            raise InputError(
                f"cannot be copied: {error.strerror or error}",
                hint=f"Check the space for temporary files in {tempfile.gettempdir()}"
                " (TMPDIR).",
                where=where,
            ) from error
        yield folder


def _new_folder(stack: contextlib.ExitStack) -> Callable[[], Path]:
    """Return what makes a folder that is removed with the stack."""

    def made() -> Path:
        folder = tempfile.TemporaryDirectory(prefix=_PREFIX, ignore_cleanup_errors=True)
        return Path(stack.enter_context(folder))

    return made


_URL = re.compile(r"[a-z][a-z0-9+.-]+://")  # two letters at least: no drive of Windows
# The optional dependencies of a kind of store, by the scheme of its URLs.
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
# Errors by which the libraries of stores refuse access.
_REFUSED = re.compile(
    "NoCredentials|PartialCredentials|DefaultCredentials|ProfileNotFound"
    "|TokenRetrieval|RefreshError|ClientAuthentication|Forbidden|InvalidAccessKey"
    "|SignatureDoesNotMatch|PermissionError"
)


class StoredLog(_LocalPath):
    """The URL of a log on object storage, in the place of a path.

    `local_copy` opens the file.
    """

    def __str__(self) -> str:
        # A path holds one slash behind the scheme.
        scheme, *names = self.parts
        return f"{scheme}//{'/'.join(names)}"

    def fetch(self, copy: Path) -> None:
        """Write the log's content to a local file."""
        url = str(self)
        system, place = _opened(url)
        with _explained(url):
            system.get_file(place, str(copy))

    def modified_s(self) -> float | None:
        """Return when the log was last modified [s, Unix]; None if that is not told."""
        system, place = _opened(str(self))
        try:
            modified: datetime = system.modified(place)
        # every kind of store has errors of its own, and a date is no need
        except Exception:
            return None
        return modified.timestamp()


class TableLog(StoredLog):
    """A table in the default column names, in the place of a path."""

    content: Any  # the table

    @classmethod
    def of(cls, data: object, name: str) -> TableLog:
        """Take a table under the name that results give it.

        Raises InputError where the data are no table.
        """
        import pyarrow as pa

        log = cls(f"{name}.parquet")
        try:
            if hasattr(data, "__arrow_c_stream__"):
                log.content = pa.table(data)
            elif isinstance(data, Mapping):
                log.content = pa.table({str(name): data[name] for name in data})
            else:
                log.content = pa.Table.from_pandas(data)
        except (TypeError, ValueError, AttributeError, pa.ArrowException) as error:
            raise InputError(
                f"{type(data).__name__} is no log ({error})",
                hint="Give a path, a pyarrow.Table, a pandas.DataFrame, a dict of"
                " arrays by column, or a Recording.",
            ) from error
        return log

    def __reduce__(self) -> Any:
        # A path is pickled by its parts alone.
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
    """Tell whether an argument names something on object storage."""
    return _URL.match(text) is not None and not text.startswith("file://")


def stored_logs(url: str, suffixes: Sequence[str]) -> list[Path]:
    """Return the logs that a URL means.

    It means one log, those of a folder at any depth, or those of a glob.

    Parameters
    ----------
    suffixes : sequence of str
        Those of logs, for folders and globs; hidden files are left out.

    Raises
    ------
    InputError
        There is no log, or the store cannot be reached.
    ConfigError
        The store refuses access.
    UsageError
        The kind of store is not known, or its package is not installed.
    """
    system, place = _opened(url)
    with _explained(url):
        is_glob = glob.has_magic(place)
        if not is_glob and system.isfile(place):
            return [StoredLog(url)]
        names = system.glob(place) if is_glob else system.find(place)
        logs: list[Path] = [
            StoredLog(system.unstrip_protocol(name))
            for name in names
            if name.lower().endswith(tuple(suffixes))
        ]
    if not logs:
        raise InputError(
            "there is no log at this place",
            hint="Check bucket, folder and suffix.",
            where=url,
        )
    return [log for log in logs if not log.name.startswith(".")]


@contextlib.contextmanager
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
    """Return the file system of a URL and the path within it."""
    scheme = url.partition("://")[0]
    try:
        from fsspec.core import url_to_fs

        with _explained(url):
            system, place = url_to_fs(url)
    except ImportError as error:
        hint = "Install fsspec and what it needs for this kind of storage."
        if scheme in _EXTRAS:
            hint = f"Install it: python -m pip install 'seqid[{_EXTRAS[scheme]}]'"
        raise UsageError(
            f"logs on {scheme}:// need a package that is not installed ({error})",
            hint=hint,
            where=url,
        ) from error
    return system, str(place)


@contextlib.contextmanager
def _explained(url: str) -> Iterator[None]:
    """Turn what a store says into a message; each kind of store has its own errors."""
    try:
        yield
    except (SeqidError, ImportError):
        raise
    except FileNotFoundError as error:
        raise InputError(
            "does not exist", hint="Check bucket and name.", where=url
        ) from error
    except Exception as error:
        scheme = url.partition("://")[0]
        if isinstance(error, ValueError) and "rotocol not known" in str(error):
            raise UsageError(
                f"{scheme}:// is no kind of storage that is known",
                hint="s3://, gs:// and az:// are.",
                where=url,
            ) from error

        first_line = str(error).strip().partition("\n")[0][:200]
        reason = f"{type(error).__name__}: {first_line}"
        if _REFUSED.search(f"{type(error).__name__} {error}"):
            kind = _EXTRAS.get(scheme, "")
            raise ConfigError(
                f"the store refuses access ({reason})",
                hint=_ACCESS.get(kind, "Check the credentials of this store."),
                where=url,
            ) from error
        raise InputError(
            f"cannot be read ({reason})",
            hint="Check the network, the space for temporary files (TMPDIR) and the"
            " store.",
            where=url,
        ) from error
