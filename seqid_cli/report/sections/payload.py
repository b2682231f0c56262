"""What the flange carries: the body, how controllers take it, and what it explains."""

from __future__ import annotations

from seqid_cli.params.results import tables
from seqid_cli.params.results.payload import Measured, PayloadFile
from seqid_cli.report.collection import Collection
from seqid_cli.report.views import VALUE_COLUMNS, Group, Section, Table, table_of, texts
from seqid_cli.report.words import DASH, interval, with_error


def payload(collection: Collection) -> Section | None:
    """Return the section on payloads; None where no file of one is given."""
    if not collection.payloads:
        return None
    lead = (
        "The body that the logs carry beyond the model, by the torque that the model leaves. Its "
        "frame is that of the last joint; its inertia is about the centre of mass."
    )
    groups = [_group(place, file) for place, file in enumerate(collection.payloads)]
    return Section("payload", "Payload", lead, groups)


def _group(place: int, file: PayloadFile) -> Group:
    joints = table_of("Torque error where joints slide", tables.payload_joints(file))
    good = all(verdict.good for verdict in file.verdicts)
    return Group(
        f"payload-{place + 1}",
        f"Payload, frame {file.payload.frame}",
        lead="; ".join(verdict.reason for verdict in file.verdicts if verdict.reason),
        badge="good" if good else "poor",
        badge_text="good" if good else "poor",
        tables=[
            Table("The body", VALUE_COLUMNS, [_row(*pair) for pair in file.payload.numbers()]),
            Table("As controllers take it", texts("for", "setting"), list(file.settings.items())),
            joints,
        ],
        notes=file.notes,
        unfolded=True,
    )


def _row(name: str, own: Measured) -> tuple[str, ...]:
    if own.value is None or own.std_error is None:
        return name, "not determined", DASH, DASH, own.unit
    value, error = with_error(own.value, own.std_error)
    return name, value, error, interval(own.value, own.std_error), own.unit
