"""The trend file, `seqid/trend@1`: what changed over time."""

from datetime import datetime

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import Written

TREND_SCHEMA = "seqid/trend@1"


class QuantityEntry(Struct, kw_only=True):
    """One number of a robot: a parameter, or a joint's mean friction at a speed."""

    robot: str
    stage: str
    joint: str
    name: str
    unit: str


class SeriesEntry(QuantityEntry, kw_only=True):
    """A quantity over the dates of the files that hold it.

    `temperatures` [degC] are there for friction where all files have them.
    """

    dates: list[str]
    values: list[float]
    std_errors: list[float]
    temperatures: list[float] = []

    def __post_init__(self) -> None:
        try:
            times = [datetime.fromisoformat(date).timestamp() for date in self.dates]
        except (ValueError, OverflowError):
            times = []
        if not 0 < len(times) == len(self.values) == len(self.std_errors):
            raise ValueError(
                "dates, values and std_errors must be of one length, as dates"
            )


class ChangeEntry(QuantityEntry, kw_only=True):
    """A quantity that changed.

    `kind` is "step" (from one date to the next), "drift" (in proportion to time),
    "appeared" or "gone" (an effect that some refined files hold), "added" (an effect of
    the refined files, before which there are files that were not refined); `since` is
    the first date after it. `before` and `after` are the means on both sides of a step,
    or the ends of a drift, and `relative` is the change as a share of `before`.
    `change` has the `std_error`, the errors' inflation included, and `sigmas` is their
    ratio. Numbers are null for what appeared or is gone.
    """

    kind: str
    since: str
    before: float | None = None
    after: float | None = None
    change: float | None = None
    std_error: float | None = None
    sigmas: float | None = None
    relative: float | None = None


class TrendFile(Written, kw_only=True):
    """The whole document.

    `inflation` is, by stage, the factor by which values of one date after the other
    scatter beyond their standard errors; `limit` the sigmas from which a change is an
    `alarm`.
    """

    files: list[FileId]
    robots: list[str]
    alarm: bool
    limit: float
    inflation: dict[str, float]
    changes: list[ChangeEntry]
    series: list[SeriesEntry]
    notes: list[str] = []
