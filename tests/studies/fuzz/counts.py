"""Count what came of inputs: a slice of them at a time, and a table of many slices."""

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from tests.studies.fuzz.run import Outcome

# Kinds of finds, by how what is said of one begins.
FINDS: Mapping[str, tuple[str, ...]] = {
    "tracebacks": ("escaped", "traceback"),
    "signals": ("the process died",),
    "exit 70": ("exit 70",),
    "over 10 s": ("more than", "took", "stands still"),
    "over 1 GiB": ("memory",),
}
OTHER = "other finds"
HEADER = (
    "file",
    "inputs",
    "read",
    "refused",
    "answers",
    *FINDS,
    OTHER,
    "slowest, s",
    "peak, MiB",
)


class Counts(msgspec.Struct, frozen=True, kw_only=True):
    """What came of the inputs of one slice.

    `answers` are the exit codes and messages that differ. `slowest_s` is CPU time of
    the reader or command, `peak_mib` the memory of its child.
    """

    inputs: int
    read: int
    refused: int
    answers: list[str]
    finds: dict[str, int]
    slowest_s: float
    peak_mib: int


def counted(outcomes: Sequence[Outcome]) -> Counts:
    """Count what came of inputs."""
    finds = dict.fromkeys((*FINDS, OTHER), 0)
    for outcome in outcomes:
        if outcome.why:
            finds[kind_of_find(outcome.why)] += 1
    codes = [outcome.answer[0] for outcome in outcomes]
    return Counts(
        inputs=len(outcomes),
        read=sum(code in (0, 1, 3) for code in codes),
        refused=codes.count(2),
        answers=sorted({f"{code} {said}" for code, said in _answers(outcomes)}),
        finds=finds,
        slowest_s=max((outcome.seconds for outcome in outcomes), default=0.0),
        peak_mib=max((outcome.peak for outcome in outcomes), default=0) >> 10,
    )


def _answers(outcomes: Iterable[Outcome]) -> set[tuple[int, str]]:
    return {outcome.answer for outcome in outcomes}


def kind_of_find(why: str) -> str:
    """Return the kind of a find, by what is said of it."""
    for kind, beginnings in FINDS.items():
        if why.startswith(beginnings):
            return kind
    return OTHER


def row(name: str, slices: Sequence[Counts]) -> list[str]:
    """Return the cells of a kind of file, in the order of the header."""
    answers = {answer for counts in slices for answer in counts.answers}
    finds = [sum(counts.finds[kind] for counts in slices) for kind in (*FINDS, OTHER)]
    numbers = (
        sum(counts.inputs for counts in slices),
        sum(counts.read for counts in slices),
        sum(counts.refused for counts in slices),
        len(answers),
        *finds,
    )
    slowest_s = max((counts.slowest_s for counts in slices), default=0.0)
    peak_mib = max((counts.peak_mib for counts in slices), default=0)
    return [name, *map(str, numbers), f"{slowest_s:.1f}", str(peak_mib)]
