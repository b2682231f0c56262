"""Results as tables of values: the screen and the report write them with the same heads."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from seqid_cli.params.evidence_schema import RivalEntry
from seqid_cli.params.results.diagnosis import EventEntry, HiddenEntry, ResidualEntry
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlannedMove, PlannedStage
from seqid_cli.params.results.trend import ChangeEntry
from seqid_cli.params.schema import ClosedLoop, RefinementRound

Kind = Literal["text", "effect", "path", "count", "number", "share", "limits", "shares"]
WORDS = ("text", "effect", "path")


@dataclass(frozen=True)
class Head:
    """What a column holds: words, numbers, shares of one, or both limits of an interval of them."""

    title: str
    kind: Kind = "number"
    unit: str = ""
    digits: int = 3


@dataclass(frozen=True)
class Values:
    """Rows of values, None where there is none, under their heads."""

    heads: Sequence[Head]
    rows: Sequence[Sequence[Any]]

    def cells(
        self,
        number: Callable[[float | None, int], str],
        percent: Callable[[float | None], str],
        **words: Callable[[str], str],
    ) -> list[tuple[str, ...]]:
        """Write the values as text; `words` say how effects and paths are written."""

        def cell(head: Head, value: Any) -> str:
            if value is None:
                return number(None, head.digits)
            if head.kind in ("number", "share"):
                return number(value, head.digits) if head.kind == "number" else percent(value)
            if head.kind in ("limits", "shares"):
                ends = [
                    number(x, head.digits) if head.kind == "limits" else percent(x) for x in value
                ]
                return " to ".join(ends) or number(None, head.digits)
            return words.get(head.kind, str)(value)

        pairs = (zip(self.heads, row, strict=True) for row in self.rows)
        return [tuple(cell(head, value) for head, value in row) for row in pairs]


def texts(*titles: str) -> list[Head]:
    """Return heads of columns of text."""
    return [Head(title, "text") for title in titles]


def _torque_unit(units: Iterable[str]) -> str:
    return " or ".join(dict.fromkeys(units)) or "N m"


def loop_errors(loop: ClosedLoop, units: Mapping[str, str] = {}) -> Values:
    """Errors of each joint on held-out logs, before and after refinement.

    Outside is beyond the positions and speeds at which friction was identified. `units`: of the
    joints' torques, where they are not N m.
    """
    unit = _torque_unit(units.get(name, "N m") for name in loop.before)
    heads = [
        *texts("joint"),
        *(Head(title, unit=unit) for title in ("before", "after", "noise floor")),
        Head("its 95 % interval", "limits"),
        Head("variance less by", "share"),
        Head("95 % interval", "shares"),
        Head("outside", "share"),
        Head("before there", unit=unit),
        Head("after there", unit=unit),
    ]
    rows = []
    for name, error in loop.before.items():
        new = loop.after.get(name)
        rows.append(
            (
                name,
                error.rmse,
                None if new is None else new.rmse,
                loop.noise_floor.get(name),
                loop.noise_floor_interval.get(name, ()),
                None if new is None or not error.rmse else 1.0 - (new.rmse / error.rmse) ** 2,
                loop.gain_interval.get(name, ()),
                error.share_outside,
                error.rmse_outside,
                None if new is None else new.rmse_outside,
            )
        )
    return Values(heads, rows)


def rounds(loop: ClosedLoop) -> Values:
    """Effects that were tried in a refinement, and what became of them."""
    heads = [
        Head("effect", "effect"),
        *texts("joint"),
        Head("gain left out", "share"),
        Head("95 % interval", "shares"),
        Head("gain held out", "share"),
        Head("95 % interval", "shares"),
        *texts("outcome"),
    ]
    rows = [
        (
            item.effect,
            item.joint or "whole arm",
            item.training_gain,
            item.training_interval,
            item.held_out_gain,
            item.interval,
            _outcome(item),
        )
        for item in (*loop.rounds, *loop.refused)
    ]
    return Values(heads, rows)


def _outcome(item: RefinementRound) -> str:
    if not item.accepted:
        return f"refused: {item.reason or 'no gain'}"
    confirmed = "confirmed" if item.confirmed else "not confirmed"
    return f"added, {confirmed}: {item.reason}" if item.reason else f"added, {confirmed}"


def rivals(tried: Sequence[RivalEntry], title: str = "tried") -> Values:
    """Terms that were tried, each with the reason why it was not taken."""
    heads = [
        Head(title, "effect"),
        *texts("joint"),
        Head("gain, nats", "count"),
        *texts("why it was not taken"),
    ]
    rows = [(x.effect, x.joint or "whole arm", f"{x.log_gain:.0f}", x.why_not) for x in tried]
    return Values(heads, rows)


def joint_residuals(joints: Mapping[str, ResidualEntry], units: Mapping[str, str] = {}) -> Values:
    """What a model leaves of some joints' torque, against the noise floor."""
    unit = _torque_unit(units.get(name, "N m") for name in joints)
    heads = [
        *texts("joint"),
        Head("RMSE", unit=unit),
        Head("noise floor", unit=unit),
        Head("95 % interval", "limits"),
        Head("ratio"),
        Head("with findings", unit=unit),
        *texts("white"),
    ]
    rows = [
        (
            name,
            joint.rmse,
            joint.noise_floor,
            joint.noise_floor_interval,
            joint.rmse / joint.noise_floor
            if joint.rmse is not None and joint.noise_floor
            else None,
            joint.rmse_explained,
            "yes" if joint.white else "no",
        )
        for name, joint in joints.items()
    ]
    return Values(heads, rows)


def events(pushed: Sequence[EventEntry]) -> Values:
    """Times in which something pushed the arm."""
    times = (Head(title, "count", "s") for title in ("from", "to"))
    heads = [Head("pushed in log", "path"), *times, *texts("joints")]
    rows = [(x.log, f"{x.start:.2f}", f"{x.end:.2f}", ", ".join(x.joints)) for x in pushed]
    return Values(heads, rows)


def hidden(effects: Sequence[HiddenEntry]) -> Values:
    """Effects that the motions of the logs cannot show."""
    heads = [Head("hidden from these motions", "effect"), *texts("joint"), Head("visible", "share")]
    return Values(heads, [(x.effect, x.joint or "whole arm", x.visible) for x in effects])


def payload_joints(file: PayloadFile) -> Values:
    """Torque error of each joint without and with the load, where it slides."""
    heads = [
        *texts("joint"),
        Head("RMSE without", unit="N m"),
        Head("with", unit="N m"),
        Head("of the torque", "share"),
        Head("friction differs by", "share"),
    ]
    rows = [(n, x.before, x.after, x.relative, x.friction_change) for n, x in file.joints.items()]
    return Values(heads, rows)


def moves(planned: Sequence[PlannedMove]) -> Values:
    """Moves of a plan."""
    heads = [*texts("move", "joints"), Head("seconds"), Head("of torque limit", "share")]
    rows = [(x.name, " ".join(x.joints), x.duration_s, x.torque_share) for x in planned]
    return Values(heads, rows)


def planned_errors(stage: PlannedStage) -> Values:
    """Standard errors that the moves of a stage will give."""
    heads = [*texts("parameter"), Head("value now"), Head("std error then"), *texts("unit")]
    return Values(heads, [(x.name, x.value, x.std_error, x.unit) for x in stage.parameters])


def changes(entries: Sequence[ChangeEntry]) -> Values:
    """What changed over time, in the order given."""
    heads = [
        *texts("robot", "joint", "quantity", "how", "since"),
        Head("before", digits=4),
        Head("after", digits=4),
        Head("change", "share"),
        Head("sigmas"),
    ]
    rows = [
        (
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
        for entry in entries
    ]
    return Values(heads, rows)
