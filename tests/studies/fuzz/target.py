"""A kind of file that is damaged. This module imports nothing of the program: the
server that forks a child for each input stays small.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tests.studies.fuzz.mutations import Damage

Line = tuple[str, ...]  # of a command; {} is the damaged file, {@} the folder


@dataclass(frozen=True)
class Target:
    """A kind of file: the name it gets, sound ones, ways to damage them, and who reads
    it; what else is in the folder.

    `alone` is the reader without a command around it; empty where another target has
    the same reader.
    """

    name: str
    file: str
    seeds: Sequence[bytes]
    damages: Sequence[Damage]
    lines: Sequence[Line]
    alone: Line
    beside: Mapping[str, bytes] = field(default_factory=dict)
