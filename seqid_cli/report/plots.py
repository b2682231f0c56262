"""Drawings of the report by themselves, for notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import Paths, listed
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.report.collection import Collection
    from seqid_cli.report.views import Figure

_WIDTH, _HEIGHT = 620, 460  # of a figure in its frame, pixels


@dataclass(frozen=True, repr=False)
class Drawing:
    """Figures with their legends, which a notebook shows; `svg` are their drawings alone."""

    figures: tuple[Figure, ...]

    @property
    def svg(self) -> tuple[str, ...]:
        """The drawings as SVG, one per figure."""
        return tuple(str(figure.drawing) for figure in self.figures)

    def __repr__(self) -> str:
        """Return how many figures there are: a notebook keeps this beside them."""
        return f"<{len(self.figures)} figures>"

    def _repr_html_(self) -> str:
        """Return the figures in a frame of their own, with the report's style."""
        from seqid_cli.report.views import resource

        page = f"<style>{resource('style.css')} figure{{max-width:{_WIDTH}px}}</style>"
        key = '<span><span class="key {}"></span>{} </span>'
        for figure in self.figures:
            keys = "".join(
                key.format(style, escape(x)) for style, x in figure.legend.items()
            )
            title = f"<figcaption>{escape(figure.title)}</figcaption>"
            page += f"<figure>{title}{figure.drawing}{keys}</figure>"
        frame = f'width="100%" height="{_HEIGHT * len(self.figures)}" style="border:0"'
        return f'<iframe srcdoc="{escape(page)}" {frame}></iframe>'


def plot_friction(file: ParameterFile, joint: str) -> Drawing:
    """Draw the friction of a joint: a map, and cuts over velocity and over position."""
    from seqid_cli.report.sections.friction import friction_figures

    known = file.stages.friction.joints if file.stages.friction else {}
    if joint not in known:
        names = ", ".join(known) or "none"
        raise UsageError(
            f"no friction of {joint!r} is in this file", hint=f"It has: {names}."
        )
    return Drawing(
        tuple(friction_figures(known[joint], _collection(file).place(joint)))
    )


def plot_evidence(file: DiagnosisFile) -> Drawing:
    """Draw the residuals behind the findings and the unexplained parts of a diagnosis."""
    from seqid_cli.report.sections.diagnosis import evidence_figure

    collection = _collection(file)
    shown = [x.evidence for x in file.findings] + [x.evidence for x in file.unexplained]
    figures = (evidence_figure(evidence, collection) for evidence in shown)
    return Drawing(tuple(figure for figure in figures if figure is not None))


def plot_torques(
    files: Paths, torques: Paths, joint: str, *, columns: int = 200
) -> Drawing:
    """Draw measured and predicted torque of a joint over time, of one model or several.

    Parameters
    ----------
    files : path or sequence of paths
        Predictions, and the parameter files that they were made with.
    torques : path or sequence of paths
        What `predict` wrote with `torques`.
    joint : str
    columns : int
        Each line has at most two points in each of so many parts of the time.

    Raises
    ------
    UsageError
        The torques of this joint are in none of the files.
    """
    from seqid_cli.params.io import read_any
    from seqid_cli.report.collection import collect
    from seqid_cli.report.make import open_torques
    from seqid_cli.report.sections.torque import over_logs

    collection = collect(read_any([Path(path) for path in listed(files)]))
    tables, _ = open_torques([Path(path) for path in listed(torques)], collection)
    _, figures = over_logs(collection, tables, joint, columns)
    if not figures:
        hint = f"They have: {', '.join(tables[0].joints) if tables else 'none'}."
        raise UsageError(f"no torques of {joint!r} are in these files", hint=hint)
    return Drawing(tuple(figures))


def _collection(file: ParameterFile | DiagnosisFile) -> Collection:
    from seqid_cli.params.io import Source
    from seqid_cli.report.collection import collect

    return collect([Source("", "", file)])
