"""Results of cases, kept line by line: a study that was cut short goes on where it
stopped.
"""

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

import seqid_cli

C = TypeVar("C")
R = TypeVar("R")


def results(
    cases: Mapping[str, C],
    work: Callable[[C], R],
    kind: type[R],
    path: Path,
    *,
    sources: str = "",
    run: bool = True,
    limit: int | None = None,
    processes: int = 1,
    told: Callable[[R], object] = lambda _: "",
    failed: Callable[[R], bool] = lambda _: False,
) -> dict[str, R]:
    """Run the cases that the file does not hold, shuffled: tables of a part of them are
    fair.

    Results, of `kind` to msgspec, are JSON lines of the file; those of other `sources`
    do not count. `told` is what the screen says of a result, `failed` whether its case
    is to be run again.
    """
    kept = {key: r for key, made_by, r in _lines(path, kind) if made_by == sources}
    left = [key for key in cases if key not in kept or failed(kept[key])] if run else []
    left = [left[k] for k in np.random.default_rng(0).permutation(len(left))][:limit]
    made = mapped(work, {key: cases[key] for key in left}, processes)
    for count, (key, result) in enumerate(made, start=1):
        kept[key] = result
        path.parent.mkdir(parents=True, exist_ok=True)
        # by an interruption
        cut = path.is_file() and not path.read_bytes().endswith(b"\n")
        with path.open("ab") as stream:
            stream.write(
                (b"\n" if cut else b"") + encoded((key, sources, result)) + b"\n"
            )
        sys.stderr.write(f"{count}/{len(left)} {key}: {told(result)}\n")
    return {key: kept[key] for key in cases if key in kept}


def seeds_of(text: str) -> range:
    """Seeds `A:B`, B left out; A alone is one seed."""
    first, _, last = text.replace("-", ":").partition(":")
    return range(int(first), int(last) if last else int(first) + 1)


def mapped(
    work: Callable[[C], R], cases: Mapping[str, C], processes: int
) -> Iterator[tuple[str, R]]:
    if processes <= 1 or len(cases) < 2:
        yield from ((key, work(case)) for key, case in cases.items())
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        keys = {pool.submit(work, case): key for key, case in cases.items()}
        for done in as_completed(keys):
            yield keys[done], done.result()


def _lines(path: Path, kind: type[R]) -> Iterator[tuple[str, str, R]]:
    """Key, sources and result of every line; one that an interruption cut off is left
    out.
    """
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        try:
            yield msgspec.json.decode(line, type=tuple[str, str, kind])  # type: ignore[valid-type]
        except msgspec.DecodeError:
            continue


def encoded(value: object) -> bytes:
    """JSON, with numpy's scalars and arrays as numbers;
    numbers that are none are null.
    """
    return msgspec.json.encode(value, enc_hook=lambda array: array.tolist())


@cache
def sources_of(*folders: Path, but: tuple[str, ...] = ()) -> str:
    """Hash of all Python files in folders,
    without those whose names begin with `but`.
    """
    files = [
        p
        for f in folders
        for p in sorted(f.rglob("*.py"))
        if not p.name.startswith(but)
    ]
    return hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()[:16]


def package_sources(*rooms: str) -> str:
    """Hash of the package, or of some of its rooms."""
    return sources_of(
        *(Path(seqid_cli.__file__).parent / room for room in rooms or ("",))
    )
