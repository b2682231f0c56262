"""Results as tables of values, which the screen and the report write alike."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from seqid_cli.params.evidence_schema import RefinementRound, RivalEntry
from seqid_cli.params.results.diagnosis import (
    ChangedValues,
    ContactPoint,
    EventEntry,
    HiddenEntry,
    ResidualEntry,
    causes_in_words,
)
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.results.replay import ReplayError, ReplayFile
from seqid_cli.params.results.trend import ChangeEntry
from seqid_cli.params.schema import ClosedLoop, RobotId, Verdict
from seqid_cli.shares import with_sign

_TEXT_KINDS = ("text", "effect", "path", "unit")
# Stands for the unit of a joint's torque, N m or N.
_TORQUE = "{unit}"


@dataclass(frozen=True)
class Head:
    """The head of a column: its title and unit, and the kind of its values.

    `kind` is text, effect, path, unit, count, number, share (of one), or limits, shares
    (both ends of an interval of them); `digits` are those of its numbers.
    """

    title: str
    kind: str
    unit: str = ""
    digits: int = 3

    @property
    def numeric(self) -> bool:
        """True for a column that is set to the right."""
        return self.kind not in _TEXT_KINDS


@dataclass(frozen=True)
class Values:
    """Rows of values under their heads; None where there is no value."""

    heads: Sequence[Head]
    rows: Sequence[Sequence[Any]]

    def cells(
        self,
        number: Callable[[float | None, int], str],
        percent: Callable[[float | None], str],
        **words: Callable[[str], str],
    ) -> list[tuple[str, ...]]:
        """Write the values as text.

        Parameters
        ----------
        number : callable
            Writes a number, or None, with some digits.
        percent : callable
            Writes a share, or None.
        **words : callable
            Write words by the kind of their column: effects, paths, units.
        """

        def cell(head: Head, value: Any) -> str:
            if value is None:
                return number(None, head.digits)
            if head.kind in words:
                return words[head.kind](value)
            if isinstance(value, str):
                return value  # as it is: it may be marked up
            if head.kind in ("text", "count"):
                return str(value)

            # Plural kinds are both ends of an interval, or none.
            ends = value if head.kind.endswith("s") else [value]
            if head.kind == "share_change":
                texts = [with_sign(percent(value), value)]
            elif head.kind.startswith("share"):
                texts = [percent(end) for end in ends]
            else:
                texts = [number(end, head.digits) for end in ends]
            return " to ".join(texts) or number(None, head.digits)

        written = []
        for row in self.rows:
            pairs = zip(self.heads, row, strict=True)
            written.append(tuple(cell(head, value) for head, value in pairs))
        return written


def heads(titles: str, kinds: str, **names: str) -> list[Head]:
    """Return heads by their titles and kinds.

    Parameters
    ----------
    titles : str
        Titles and units, "speed [rad/s] | RMS error [{unit}]".
    kinds : str
        Those of `Head`, each with its digits where they are not three, "text number4".
    **names : str
        Texts for the words in braces: whatever comes from a file.
    """
    columns = []
    for title, kind in zip(titles.split(" | "), kinds.split(), strict=True):
        name, _, unit = title.removesuffix("]").partition(" [")
        word = kind.rstrip("0123456789")
        digits = int(kind.removeprefix(word) or 3)
        columns.append(
            Head(
                title=name.format(**names),
                kind=word,
                unit=unit.format(**names),
                digits=digits,
            )
        )
    return columns


def values(
    titles: str, kinds: str, rows: Iterable[Sequence[Any]], **names: str
) -> Values:
    """Return rows under heads; the other arguments are those of `heads`."""
    return Values(heads(titles, kinds, **names), list(rows))


def of_joints(
    titles: str, kinds: str, rows: Iterable[Sequence[Any]], robot: RobotId
) -> Values:
    """Return rows that begin with a joint's name under heads.

    Parameters
    ----------
    titles, kinds : str
        Those of `heads`, "{unit}" for the unit of a joint's torque. Where some joints
        slide and others do not, a column of its own has the unit.
    rows : iterable of sequence
        Values, the joint's name first.
    robot : RobotId
        The robot that they are of.
    """
    return _joint_table(heads(titles, kinds, unit=_TORQUE), rows, robot)


def _joint_table(
    columns: Sequence[Head], rows: Iterable[Sequence[Any]], robot: RobotId
) -> Values:
    """Return rows that begin with a joint's name under heads with units of torque."""
    joint_rows = list(rows)
    units = [robot.unit("N m", row[0]) for row in joint_rows]
    if len(set(units)) < 2:
        unit = units[0] if units else ""
        columns = [
            replace(head, unit=head.unit.replace(_TORQUE, unit)) for head in columns
        ]
        return Values(columns, joint_rows)

    without_unit = [
        replace(head, unit="") if head.unit == _TORQUE else head for head in columns
    ]
    with_column = [without_unit[0], Head("unit", "unit"), *without_unit[1:]]
    rows_with_unit = [
        (row[0], unit, *row[1:]) for row, unit in zip(joint_rows, units, strict=True)
    ]
    return Values(with_column, rows_with_unit)


def prediction_errors(
    file: PredictionFile, verdict_text: Callable[[Sequence[Verdict], str], str]
) -> Values:
    """Return the error of each joint, its parts, the coverage of bands, the verdict.

    `verdict_text` writes the verdicts on a joint.
    """
    rows = []
    for name, error in file.joints.items():
        coverage = error.coverage
        row = (
            name,
            error.rmse,
            error.relative_rmse,
            error.rmse_inside,
            error.rmse_outside,
            error.rmse_rest,
            None if coverage is None else coverage.overall.band_90,
            verdict_text(file.verdicts, name) if error.samples else "not judged",
        )
        rows.append(row)

    columns = [
        Head("joint", "text"),
        Head("RMSE", "number", _TORQUE),
        Head("relative", "share"),
        Head("inside", "number", _TORQUE),
        Head("outside", "number", _TORQUE),
        Head("rests", "number", _TORQUE),
        Head("in 90 %", "share"),
        Head("verdict", "text"),
    ]
    return _joint_table(columns, rows, file.robot)


def loop_errors(loop: ClosedLoop, robot: RobotId) -> Values:
    """Return errors of each joint on held-out logs, before and after a refinement.

    `outside` and what follows are of samples beyond the identified friction.
    """
    rows = []
    for name, before in loop.before.items():
        after = loop.after.get(name)
        gain = None
        if after is not None and before.rmse:
            gain = 1.0 - (after.rmse / before.rmse) ** 2
        row = (
            name,
            before.rmse,
            None if after is None else after.rmse,
            loop.noise_floor.get(name),
            loop.noise_floor_interval.get(name, ()),
            gain,
            loop.gain_interval.get(name, ()),
            before.share_outside,
            before.rmse_outside,
            None if after is None else after.rmse_outside,
        )
        rows.append(row)

    columns = [
        Head("joint", "text"),
        Head("before", "number", _TORQUE),
        Head("after", "number", _TORQUE),
        Head("noise floor", "number", _TORQUE),
        Head("its 95 % interval", "limits"),
        Head("variance less by", "share"),
        Head("95 % interval", "shares"),
        Head("outside", "share"),
        Head("before there", "number", _TORQUE),
        Head("after there", "number", _TORQUE),
    ]
    return _joint_table(columns, rows, robot)


def rounds(loop: ClosedLoop) -> Values:
    """Return the effects that a refinement tried, and the outcome of each."""
    tried = [(item, "added") for item in loop.rounds]
    tried += [(item, "not kept") for item in loop.unconfirmed]
    tried += [(item, "refused") for item in loop.refused]
    is_outside = any(item.gain_outside is not None for item, _ in tried)
    rows = []
    for item, outcome in tried:
        row = [
            item.effect,
            item.joint or "whole arm",
            item.training_gain,
            item.whole_logs_interval,
            item.held_out_gain,
            item.interval,
        ]
        if is_outside:
            row += [item.gain_outside, item.interval_outside]
        rows.append((*row, _outcome(item, outcome)))

    columns = [
        Head("effect", "effect"),
        Head("joint", "text"),
        Head("gain left out", "share"),
        Head("of another log, 95 %", "shares"),
        Head("gain held out", "share"),
        Head("95 % interval", "shares"),
    ]
    if is_outside:
        columns += [
            Head("beyond the identified friction", "share"),
            Head("95 % interval", "shares"),
        ]
    columns.append(Head("outcome", "text"))
    return Values(columns, rows)


def gains_of_logs(item: RefinementRound) -> Values:
    """Return what each log says of an effect that was fitted to the others."""
    columns = [Head("log left out", "text"), Head("gain", "share")]
    rows: list[tuple[object, ...]] = [*item.gain_by_log.items()]
    if item.whole_logs_gain is not None:
        rows.append(("all together", item.whole_logs_gain))
    return Values(columns, rows)


def _outcome(item: RefinementRound, outcome: str) -> str:
    """Return the outcome of a round in words, with its reason."""
    if outcome == "added":
        return f"added, {'confirmed' if item.confirmed else 'not confirmed'}"
    reason = item.reason
    if outcome == "refused":
        reason = item.reason or "no gain"
    return f"{outcome}: {reason}" if reason else outcome


def rivals(tried: Sequence[RivalEntry], title: str = "tried") -> Values:
    """Return terms that were tried, each with the reason why it was not taken."""
    rows = [
        (
            rival.effect,
            rival.joint or "whole arm",
            f"{rival.log_gain:.0f}",
            rival.why_not,
        )
        for rival in tried
    ]
    columns = [
        Head(title, "effect"),
        Head("joint", "text"),
        Head("gain, nats", "count"),
        Head("why it was not taken", "text"),
    ]
    return Values(columns, rows)


def joint_residuals(joints: Mapping[str, ResidualEntry], robot: RobotId) -> Values:
    """Return what a model leaves of some joints' torque, against the noise floor."""
    rows = []
    for name, residual in joints.items():
        ratio = None
        if residual.rmse is not None and residual.noise_floor:
            ratio = residual.rmse / residual.noise_floor
        row = (
            name,
            residual.rmse,
            residual.noise_floor,
            residual.noise_floor_interval,
            ratio,
            residual.rmse_explained,
            "yes" if residual.white else "no",
        )
        rows.append(row)

    columns = [
        Head("joint", "text"),
        Head("RMSE", "number", _TORQUE),
        Head("noise floor", "number", _TORQUE),
        Head("95 % interval", "limits"),
        Head("ratio", "number"),
        Head("with findings", "number", _TORQUE),
        Head("white", "text"),
    ]
    return _joint_table(columns, rows, robot)


def changed_values(changed: Sequence[ChangedValues], robot: RobotId) -> Values:
    """Return joints at which the file's values do not hold, and possible causes."""
    rows = []
    for item in changed:
        row = (
            item.joint,
            item.rmse,
            item.floors,
            item.rmse_refitted,
            item.since or "the first log on",
            causes_in_words(item),
        )
        rows.append(row)

    columns = [
        Head("values do not hold at", "text"),
        Head("RMSE", "number", _TORQUE),
        Head("noise floors", "number"),
        Head("refitted", "number", _TORQUE),
        Head("since", "path"),
        Head("may be", "text"),
    ]
    return _joint_table(columns, rows, robot)


def events(pushes: Sequence[EventEntry]) -> Values:
    """Return times in which something pushed the arm."""
    rows = [
        (
            push.log,
            f"{push.start:.2f}",
            f"{push.end:.2f}",
            ", ".join(push.joints),
            _contact_in_words(push.contact),
        )
        for push in pushes
    ]
    columns = [
        Head("pushed in log", "path"),
        Head("from", "count", "s"),
        Head("to", "count", "s"),
        Head("joints", "text"),
        Head("where", "text"),
    ]
    return Values(columns, rows)


def _contact_in_words(contact: ContactPoint | None) -> str:
    """Return where a push acted, in words; empty where it is not known."""
    if contact is None:
        return ""
    place = ", ".join(
        "?" if value is None else f"{value:.2f}" for value in contact.point
    )
    size = f"{contact.force:.3g} N"
    return f"{size} at ({place}) m on the link after {contact.after_joint}"


def hidden(effects: Sequence[HiddenEntry]) -> Values:
    """Return effects that the motions of the logs cannot show."""
    rows = [
        (effect.effect, effect.joint or "whole arm", effect.visible)
        for effect in effects
    ]
    columns = [
        Head("hidden from these motions", "effect"),
        Head("joint", "text"),
        Head("visible", "share"),
    ]
    return Values(columns, rows)


def drive_parameters(file: DriveFile) -> Values:
    """Return every number of the controllers, and what is to be known of it."""
    rows = [
        (
            name,
            parameter.name,
            parameter.value,
            parameter.std_error,
            parameter.unit,
            parameter.state.replace("_", " "),
            parameter.reason or None,
        )
        for name, joint in file.joints.items()
        for parameter in joint.parameters
    ]
    columns = [
        Head("joint", "text"),
        Head("parameter", "text"),
        Head("value", "number4"),
        Head("std error", "number2"),
        Head("unit", "text"),
        Head("state", "text"),
        Head("why", "text"),
    ]
    return Values(columns, rows)


def replay_errors(file: ReplayFile) -> Values:
    """Return the errors of each joint beside those of simpler guesses."""

    def rms(error: ReplayError | None) -> float | None:
        return None if error is None else error.rms

    rows = [
        (
            name,
            joint.position.rms,
            joint.position.worst.rms,
            joint.delayed_command.rms,
            joint.start_plus_change.rms,
            rms(joint.without_drive),
            joint.velocity.rms,
            rms(joint.torque),
        )
        for name, joint in file.joints.items()
    ]
    columns = [
        Head("joint", "text"),
        Head("position", "number"),
        Head("worst window", "number"),
        Head("delayed command", "number"),
        Head("start + change", "number"),
        Head("without drive", "number"),
        Head("velocity", "number"),
        Head("torque", "number"),
    ]
    return Values(columns, rows)


def payload_joints(file: PayloadFile) -> Values:
    """Return the torque error of each joint without and with the load, in motion."""
    rows = [
        (name, joint.before, joint.after, joint.relative, joint.friction_change)
        for name, joint in file.joints.items()
    ]
    columns = [
        Head("joint", "text"),
        Head("RMSE without", "number", _TORQUE),
        Head("with", "number", _TORQUE),
        Head("of the torque", "share"),
        Head("friction differs by", "share"),
    ]
    return _joint_table(columns, rows, file.robot)


def moves(planned: Sequence[PlannedMove]) -> Values:
    """Return the moves of a plan."""
    rows = [
        (move.name, " ".join(move.joints), move.duration_s, move.torque_share)
        for move in planned
    ]
    columns = [
        Head("move", "text"),
        Head("joints", "text"),
        Head("seconds", "number"),
        Head("of torque limit", "share"),
    ]
    return Values(columns, rows)


def planned_errors(stage: PlannedStage) -> Values:
    """Return the standard errors that the moves of a stage will give."""
    rows = [
        (parameter.name, parameter.value, parameter.std_error, parameter.unit)
        for parameter in stage.parameters
    ]
    columns = [
        Head("parameter", "text"),
        Head("value now", "number"),
        Head("std error then", "number"),
        Head("unit", "text"),
    ]
    return Values(columns, rows)


def changes(entries: Sequence[ChangeEntry]) -> Values:
    """Return what changed over time, in the order given."""
    rows = []
    for entry in entries:
        row = (
            entry.robot,
            entry.joint or None,
            f"{entry.stage} {entry.name}",
            entry.kind,
            entry.since[:10],
            entry.before,
            entry.after,
            entry.relative,
            entry.sigmas,
        )
        rows.append(row)

    columns = [
        Head("robot", "text"),
        Head("joint", "text"),
        Head("quantity", "text"),
        Head("how", "text"),
        Head("since", "text"),
        Head("before", "number", digits=4),
        Head("after", "number", digits=4),
        Head("change", "share_change"),
        Head("sigmas", "number"),
    ]
    return Values(columns, rows)
