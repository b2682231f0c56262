"""The comparison, `seqid/comparison@1`: two results of one robot side by side."""

from seqid_cli.params.base import FrozenStruct
from seqid_cli.params.schema import Written

COMPARISON_SCHEMA = "seqid/comparison@1"


class RuleEntry(FrozenStruct, kw_only=True, frozen=True):
    """Limits of a change: `sigma` standard errors (null: none), and a share `rtol`."""

    sigma: float | None
    rtol: float


class Difference(FrozenStruct, kw_only=True, frozen=True):
    """One number in both results.

    `a`, `b` are null where a file does not have it; `std_error` combines those of both.
    `sigmas` is the size of the difference in units of it, `relative` b / a - 1 (of the
    larger of both where a is next to nothing).
    Numbers that are null do not apply. `remark` says where or what else.
    """

    stage: str
    name: str
    joint: str
    unit: str = ""
    a: float | None = None
    b: float | None = None
    std_error: float | None = None
    sigmas: float | None = None
    relative: float | None = None
    different: bool = True
    remark: str = ""


class ComparisonFile(Written, kw_only=True):
    """The whole document; of the `compared` numbers `changed` are different."""

    kind: str
    a: str
    b: str
    rule: RuleEntry
    different: bool
    compared: int
    changed: int
    differences: list[Difference]
    notes: list[str]
