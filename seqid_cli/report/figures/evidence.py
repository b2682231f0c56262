"""Evidence of a finding: its residual before and after, and the terms tried in its place."""

from collections.abc import Sequence

import numpy as np

from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import over_words
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import small_figure, small_panel
from seqid_cli.report.figures.svg import padded
from seqid_cli.report.views import Figure, Key, Table, table, table_of
from seqid_cli.report.words import unit_text


def evidence_figure(
    shown: EvidenceEntry | None, collection: Collection, what: str = "Residual"
) -> Figure | None:
    """Draw a joint's residual over the effect's quantity, before and after it is taken off."""
    if shown is None or len(shown.x) < 2 or not min(shown.x) < max(shown.x):
        return None
    unit = collection.place(shown.joint).unit
    quantity, sided = over_words(shown), " times direction" if shown.sided else ""
    none = [None] * len(shown.x)
    curves = {"before": ("residual", "faint", shown.before, shown.before_spread)}
    if shown.after:
        curves["after"] = ("predicted", "cut0", shown.after, shown.after_spread)
    edges = {name: (np.subtract(y, d), np.add(y, d)) for name, (*_, y, d) in curves.items()}
    ends = np.concatenate([np.zeros(1), *(edge for both in edges.values() for edge in both)])
    panel = small_panel(
        (quantity, unit_text(shown.unit)),
        (min(shown.x), max(shown.x)),
        f"residual{sided}, {unit}",
        padded(float(ends.min()), float(ends.max())),
    )
    for name, (_, band, *_) in curves.items():
        panel.band(shown.x, *edges[name], band)
    for name, (line, _, y, _) in curves.items():
        panel.line(shown.x, y, line, name=name, unit=unit)
    title = f"{what} of {shown.joint} over {quantity}"
    text = "Means of bins, in bands of one standard deviation, on blocks left out of the fit."
    legend = [Key(line, f"{name} it is taken off") for name, (line, *_) in curves.items()]
    after = (shown.after or none, shown.after_spread or none)
    bins = table(
        title,
        "{quantity} [{x}] | samples | before [{y}] | spread [{y}] | after [{y}] | spread [{y}]",
        "number count number number number number",
        zip(shown.x, shown.count, shown.before, shown.before_spread, *after, strict=True),
        quantity=quantity,
        x=shown.unit,
        y=unit,
    )
    return small_figure(panel, title, text, legend, bins, note=text)


def rivals_table(title: str, tried: Sequence[RivalEntry]) -> Table:
    """Return the terms that were tried, each with the reason why it was not taken."""
    return table_of(title, tables.rivals(tried), folded=True)
