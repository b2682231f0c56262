"""Evidence of a finding: its residual before and after, and the terms tried in its place."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis_words import over_words
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import padded
from seqid_cli.report.figures.torque import SMALL
from seqid_cli.report.views import Figure, Key, Table, numbers, table_of
from seqid_cli.report.words import number, unit_text


def evidence_figure(
    shown: EvidenceEntry, collection: Collection, what: str = "Residual"
) -> Figure | None:
    """Draw a joint's residual over the effect's quantity, before and after it is taken off."""
    if len(shown.x) < 2 or not min(shown.x) < max(shown.x):
        return None
    unit = unit_text(collection.units(shown.joint)[0])
    quantity, x_unit = over_words(shown), unit_text(shown.unit)
    sided = " times direction" if shown.sided else ""
    curves = [("residual", "faint", "before", shown.before, shown.before_spread)]
    if shown.after:
        curves.append(("predicted", "cut0", "after", shown.after, shown.after_spread))
    edges = [
        y + s * d for *_, ys, ds in curves for y, d in zip(ys, ds, strict=True) for s in (-1, 1)
    ]
    panel = Panel(
        Box(62, 26, SMALL - 74, 150),
        (min(shown.x), max(shown.x)),
        padded(min(0.0, *edges), max(0.0, *edges)),
        x_title=f"{quantity}, {x_unit}" if x_unit else quantity,
        y_title=f"residual{sided}, {unit}",
        x_ticks=4,
        hover=f"{quantity}|{x_unit}",
    )
    for _, band, _, ys, ds in curves:
        low, high = (
            [(x, y + s * d) for x, y, d in zip(shown.x, ys, ds, strict=True)] for s in (-1, 1)
        )
        panel.band(low, high, band)
    for line, _, name, ys, _ in curves:
        panel.line(zip(shown.x, ys, strict=True), line, name=name, unit=unit)
    title = f"{what} of {shown.joint} over {quantity}"
    text = "Means of bins, in bands of one standard deviation, on blocks left out of the fit."
    legend = [Key(line, f"{name} it is taken off") for line, _, name, *_ in curves]
    svg = drawing(SMALL, 220, title, text, [panel])
    return Figure(title, svg, legend, _bins(shown, title, quantity, unit), text)


def _bins(shown: EvidenceEntry, title: str, quantity: str, unit: str) -> Table:
    heads = (
        *numbers(quantity, unit=unit_text(shown.unit)),
        *numbers("samples"),
        *numbers("before", "spread", "after", "spread", unit=unit),
    )
    none = [float("nan")] * len(shown.x)
    after, spread = shown.after or none, shown.after_spread or none
    values = zip(shown.before, shown.before_spread, after, spread, strict=True)
    rows = [
        (number(x), str(count), *map(number, some))
        for x, count, some in zip(shown.x, shown.count, values, strict=True)
    ]
    return Table(title, heads, rows)


def rivals_table(title: str, tried: Sequence[RivalEntry]) -> Table:
    """Return the terms that were tried, each with the reason why it was not taken."""
    return table_of(title, tables.rivals(tried), folded=True)
