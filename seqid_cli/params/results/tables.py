"""Results as tables of values: the screen and the report write them with the same heads."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from seqid_cli.params.evidence_schema import RivalEntry
from seqid_cli.params.results.diagnosis import (
    ChangedValues,
    EventEntry,
    HiddenEntry,
    ResidualEntry,
    causes_in_words,
)
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.trend import ChangeEntry
from seqid_cli.params.schema import ClosedLoop, RobotId, Verdict

_WORDS = ("text", "effect", "path", "unit")


@dataclass(frozen=True)
class Head:
    """A column's title and unit, and what it holds.

    `kind` is text, effect, path, unit, count, number, share (of one), or limits, shares
    (both ends of an interval of them); `digits` are those of its numbers.
    """

    title: str
    kind: str
    unit: str = ""
    digits: int = 3

    @property
    def numeric(self) -> bool:
        """Whether it is set to the right."""
        return self.kind not in _WORDS


@dataclass(frozen=True)
class Values:
    """Rows of values, None where there is none, under their heads; text stays as it is."""

    heads: Sequence[Head]
    rows: Sequence[Sequence[Any]]

    def cells(
        self,
        number: Callable[[float | None, int], str],
        percent: Callable[[float | None], str],
        **words: Callable[[str], str],
    ) -> list[tuple[str, ...]]:
        """Write the values as text; `words` say how effects, paths and units are written."""

        def cell(head: Head, value: Any) -> str:
            if value is None:
                return number(None, head.digits)
            if head.kind in words:
                return words[head.kind](value)
            if isinstance(value, str):
                return value  # as it is: it may be marked up
            if head.kind in ("text", "count"):
                return str(value)
            write = (
                percent
                if head.kind.startswith("share")
                else lambda x: number(x, head.digits)
            )
            ends = value if head.kind.endswith("s") else [value]
            return " to ".join(map(write, ends)) or number(None, head.digits)

        pairs = (zip(self.heads, row, strict=True) for row in self.rows)
        return [tuple(cell(head, value) for head, value in row) for row in pairs]


def heads(titles: str, kinds: str, **names: str) -> list[Head]:
    """Return heads by their titles and units, "speed [rad/s] | RMS error [{unit}]".

    `kinds` are those of `Head`, each with its digits where they are not three: "text
    number4". `names` stand for the words in braces: whatever comes from a file.
    """
    found = []
    for title, kind in zip(titles.split(" | "), kinds.split(), strict=True):
        name, _, unit = title.removesuffix("]").partition(" [")
        form = kind.rstrip("0123456789")
        digits = int(kind.removeprefix(form) or 3)
        found.append(Head(name.format(**names), form, unit.format(**names), digits))
    return found


def values(
    titles: str, kinds: str, rows: Iterable[Sequence[Any]], **names: str
) -> Values:
    """Return rows under `heads`."""
    return Values(heads(titles, kinds, **names), list(rows))


def of_joints(
    titles: str, kinds: str, rows: Iterable[Sequence[Any]], robot: RobotId
) -> Values:
    """Return rows that begin with a joint's name; `{unit}` in `titles` is that of its torque.

    Where some joints slide and others do not, every row says its own.
    """
    found = list(rows)
    units = [robot.unit("N m", row[0]) for row in found]
    if len(set(units)) < 2:
        return values(titles, kinds, found, unit="".join(units[:1]))
    (joint, others), (first, more) = titles.split(" | ", 1), kinds.split(" ", 1)
    titles = f"{joint} | unit | {others}".replace(" [{unit}]", "")
    told = [(row[0], unit, *row[1:]) for row, unit in zip(found, units, strict=True)]
    return values(titles, f"{first} unit {more}", told)


def prediction_errors(
    file: PredictionFile, verdict_text: Callable[[Sequence[Verdict], str], str]
) -> Values:
    """Return the error of each joint, its parts, how often the bands held, and the verdict."""
    rows = []
    for name, error in file.joints.items():
        coverage = error.coverage
        rows.append(
            (
                name,
                error.rmse,
                error.relative_rmse,
                error.rmse_inside,
                error.rmse_outside,
                error.rmse_rest,
                None if coverage is None else coverage.overall.band_90,
                verdict_text(file.verdicts, name) if error.samples else "not judged",
            )
        )
    titles = "joint | RMSE [{unit}] | relative | inside [{unit}] | outside [{unit}]"
    titles += " | rests [{unit}] | in 90 % | verdict"
    kinds = "text number share number number number share text"
    return of_joints(titles, kinds, rows, file.robot)


def loop_errors(loop: ClosedLoop, robot: RobotId) -> Values:
    """Errors of each joint on held-out logs, inside what friction was identified at and outside."""
    rows = []
    for name, old in loop.before.items():
        new, floor = loop.after.get(name), loop.noise_floor_interval.get(name, ())
        less = None if new is None or not old.rmse else 1.0 - (new.rmse / old.rmse) ** 2
        after, there = (None, None) if new is None else (new.rmse, new.rmse_outside)
        errors = (name, old.rmse, after, loop.noise_floor.get(name), floor)
        gain = loop.gain_interval.get(name, ())
        rows.append((*errors, less, gain, old.share_outside, old.rmse_outside, there))
    titles = (
        "joint | before [{unit}] | after [{unit}] | noise floor [{unit}] | its 95 %"
        " interval | "
    )
    titles += "variance less by | 95 % interval | outside"
    titles += " | before there [{unit}] | after there [{unit}]"
    kinds = "text number number number limits share shares share number number"
    return of_joints(titles, kinds, rows, robot)


def rounds(loop: ClosedLoop) -> Values:
    """Effects that were tried in a refinement, and what became of them."""
    rows = []
    outcomes = {
        "added": loop.rounds,
        "not kept": loop.unconfirmed,
        "refused": loop.refused,
    }
    for outcome, tried in outcomes.items():
        for x in tried:
            said, why = outcome, x.reason
            if outcome == "added":
                said = f"added, {'confirmed' if x.confirmed else 'not confirmed'}"
            elif outcome == "refused":
                why = x.reason or "no gain"
            said += f": {why}" if why else ""
            gains = (x.training_gain, x.training_interval, x.held_out_gain, x.interval)
            rows.append((x.effect, x.joint or "whole arm", *gains, said))
    titles = (
        "effect | joint | gain left out | 95 % interval | gain held out | 95 % interval"
    )
    return values(
        f"{titles} | outcome", "effect text share shares share shares text", rows
    )


def rivals(tried: Sequence[RivalEntry], title: str = "tried") -> Values:
    """Terms that were tried, each with the reason why it was not taken."""
    rows = [
        (x.effect, x.joint or "whole arm", f"{x.log_gain:.0f}", x.why_not)
        for x in tried
    ]
    titles = "{title} | joint | gain, nats | why it was not taken"
    return values(titles, "effect text count text", rows, title=title)


def joint_residuals(joints: Mapping[str, ResidualEntry], robot: RobotId) -> Values:
    """What a model leaves of some joints' torque, against the noise floor."""
    rows = []
    for name, x in joints.items():
        times = x.rmse / x.noise_floor if x.rmse is not None and x.noise_floor else None
        floor = (x.noise_floor, x.noise_floor_interval)
        rows.append(
            (name, x.rmse, *floor, times, x.rmse_explained, "yes" if x.white else "no")
        )
    titles = "joint | RMSE [{unit}] | noise floor [{unit}] | 95 % interval | ratio"
    titles += " | with findings [{unit}] | white"
    return of_joints(
        titles, "text number number limits number number text", rows, robot
    )


def changed_values(changed: Sequence[ChangedValues], robot: RobotId) -> Values:
    """Joints at which the file's values do not hold, and what may be the cause."""
    rows = [
        (
            one.joint,
            one.rmse,
            one.floors,
            one.rmse_refitted,
            one.since or "the first log on",
            causes_in_words(one),
        )
        for one in changed
    ]
    titles = (
        "values do not hold at | RMSE [{unit}] | noise floors | refitted [{unit}] |"
        " since"
    )
    titles += " | may be"
    return of_joints(titles, "text number number number path text", rows, robot)


def events(pushed: Sequence[EventEntry]) -> Values:
    """Times in which something pushed the arm."""
    rows = [
        (x.log, f"{x.start:.2f}", f"{x.end:.2f}", ", ".join(x.joints)) for x in pushed
    ]
    return values(
        "pushed in log | from [s] | to [s] | joints", "path count count text", rows
    )


def hidden(effects: Sequence[HiddenEntry]) -> Values:
    """Effects that the motions of the logs cannot show."""
    rows = [(x.effect, x.joint or "whole arm", x.visible) for x in effects]
    return values(
        "hidden from these motions | joint | visible", "effect text share", rows
    )


def payload_joints(file: PayloadFile) -> Values:
    """Torque error of each joint without and with the load, where it slides."""
    rows = [
        (n, x.before, x.after, x.relative, x.friction_change)
        for n, x in file.joints.items()
    ]
    titles = (
        "joint | RMSE without [{unit}] | with [{unit}] | of the torque | friction"
        " differs by"
    )
    return of_joints(titles, "text number number share share", rows, file.robot)


def moves(planned: Sequence[PlannedMove]) -> Values:
    """Moves of a plan."""
    rows = [(x.name, " ".join(x.joints), x.duration_s, x.torque_share) for x in planned]
    return values(
        "move | joints | seconds | of torque limit", "text text number share", rows
    )


def planned_errors(stage: PlannedStage) -> Values:
    """Standard errors that the moves of a stage will give."""
    rows = [(x.name, x.value, x.std_error, x.unit) for x in stage.parameters]
    return values(
        "parameter | value now | std error then | unit", "text number number text", rows
    )


def changes(entries: Sequence[ChangeEntry]) -> Values:
    """What changed over time, in the order given."""
    rows = []
    for x in entries:
        what = (x.robot, x.joint or None, f"{x.stage} {x.name}", x.kind, x.since[:10])
        rows.append((*what, x.before, x.after, x.relative, x.sigmas))
    titles = "robot | joint | quantity | how | since | before | after | change | sigmas"
    return values(titles, "text text text text text number4 number4 share number", rows)
