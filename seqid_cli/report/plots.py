"""Drawings of the report by themselves, for notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import Paths, listed
from seqid_cli.params.document import friction_of
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.report.collection import Collection
    from seqid_cli.report.views import Figure

_WIDTH, _HEIGHT = 620, 460  # of a figure in its frame, pixels


@dataclass(frozen=True, repr=False)
class Drawing:
    """Figures with their legends, which a notebook shows."""

    figures: tuple[Figure, ...]

    @property
    def svg(self) -> tuple[str, ...]:
        """The drawings alone as SVG, one per figure."""
        return tuple(str(figure.drawing) for figure in self.figures)

    def __repr__(self) -> str:
        """Return how many figures there are: a notebook keeps this beside them."""
        return f"<{len(self.figures)} figures>"

    def _repr_html_(self) -> str:
        """Return the figures in a frame of their own, with the report's style."""
        from seqid_cli.report.views import style_sheet

        page = f"<style>{style_sheet()} figure{{max-width:{_WIDTH}px}}</style>"
        for figure in self.figures:
            page += (
                f"<figure><figcaption>{escape(figure.title)}</figcaption>"
                f"{figure.drawing}{_legend_html(figure)}</figure>"
            )
        height = _HEIGHT * len(self.figures)
        return (
            f'<iframe srcdoc="{escape(page)}" width="100%" height="{height}"'
            ' style="border:0"></iframe>'
        )


def _legend_html(figure: Figure) -> str:
    """Return the legend of a figure."""
    keys = [
        f'<span><span class="key {style}"></span>{escape(text)} </span>'
        for style, text in figure.legend.items()
    ]
    return "".join(keys)


def plot_friction(file: ParameterFile, joint: str) -> Drawing:
    """Draw the friction of a joint: a map, and cuts over velocity and over position.

    Parameters
    ----------
    file : ParameterFile
    joint : str

    Returns
    -------
    Drawing

    Raises
    ------
    UsageError
        No friction of this joint is in the file.
    """
    from seqid_cli.report.sections.friction import friction_figures

    surface = friction_of(file, joint)
    place = _collection(file).place(joint)
    return Drawing(tuple(friction_figures(surface, place)))


def plot_evidence(file: DiagnosisFile) -> Drawing:
    """Draw the residuals behind the findings and the unexplained parts of a diagnosis.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    Drawing
    """
    from seqid_cli.report.sections.diagnosis import evidence_figure

    collection = _collection(file)
    entries = [finding.evidence for finding in file.findings]
    entries += [part.evidence for part in file.unexplained]
    figures = (evidence_figure(evidence, collection) for evidence in entries)
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

    Returns
    -------
    Drawing

    Raises
    ------
    UsageError
        The torques of this joint are in none of the files.
    """
    from seqid_cli.params.io import OF_PAGE, read_any
    from seqid_cli.report.collection import collect
    from seqid_cli.report.make import open_torques
    from seqid_cli.report.sections.torque import over_logs

    collection = collect(read_any([Path(path) for path in listed(files)], OF_PAGE))
    tables, _ = open_torques([Path(path) for path in listed(torques)], collection)
    _, figures = over_logs(collection, tables, joint, columns)
    if not figures:
        names = ", ".join(tables[0].joints) if tables else "none"
        raise UsageError(
            f"no torques of {joint!r} are in these files", hint=f"They have: {names}."
        )
    return Drawing(tuple(figures))


def _collection(file: ParameterFile | DiagnosisFile) -> Collection:
    """Return the collection of a single file."""
    from seqid_cli.params.io import Source
    from seqid_cli.report.collection import collect

    return collect([Source("", "", file)])
