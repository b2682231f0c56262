"""Drawings of the report by themselves, for notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.report.collection import Collection
    from seqid_cli.report.views import Figure

_HEIGHT = 270  # pixels of a frame


@dataclass(frozen=True)
class Drawing:
    """Figures with their legends, which a notebook shows; `svg` are their drawings alone."""

    figures: tuple[Figure, ...]

    @property
    def svg(self) -> tuple[str, ...]:
        """The drawings as SVG, one per figure."""
        return tuple(str(figure.drawing) for figure in self.figures)

    def _repr_html_(self) -> str:
        """Return the figures in a frame of their own, with the report's style."""
        style = (files("seqid_cli.report") / "templates" / "style.css").read_text(encoding="utf-8")
        page = f"<style>{style}</style>" + "".join(map(_figure, self.figures))
        height = _HEIGHT * len(self.figures)
        frame = f'width="100%" height="{height}" style="border:0"'
        return f'<iframe srcdoc="{escape(page)}" {frame}></iframe>'


def plot_friction(file: ParameterFile, joint: str) -> Drawing:
    """Draw the friction of a joint: the surface, and cuts over velocity and over position.

    Raises
    ------
    UsageError
        The file has no friction of this joint.
    """
    from seqid_cli.report.figures.friction import FIGURES
    from seqid_cli.report.figures.torque import Place

    known = file.stages.friction.joints if file.stages.friction else {}
    if joint not in known:
        names = ", ".join(known) or "none"
        raise UsageError(f"no friction of {joint!r} is in this file", hint=f"It has: {names}.")
    place = Place(joint, *_collection(file).units(joint))
    return Drawing(tuple(draw(known[joint], place) for draw in FIGURES))


def plot_evidence(file: DiagnosisFile) -> Drawing:
    """Draw the residuals behind the findings and the unexplained parts of a diagnosis."""
    from seqid_cli.report.figures.evidence import evidence_figure

    collection = _collection(file)
    shown = [item.evidence for item in file.findings] + [p.evidence for p in file.unexplained]
    figures = (evidence_figure(evidence, collection) for evidence in shown if evidence)
    return Drawing(tuple(figure for figure in figures if figure is not None))


def _collection(file: ParameterFile | DiagnosisFile) -> Collection:
    from seqid_cli.params.io import Source
    from seqid_cli.report.collection import collect

    return collect([Source("", "", file)])


def _figure(figure: Figure) -> str:
    keys = "".join(_key(key.style, key.text) for key in figure.legend)
    return f"<figure><figcaption>{escape(figure.title)}</figcaption>{figure.drawing}{keys}</figure>"


def _key(style: str, text: str) -> str:
    line = f'<svg width="24" height="8"><line class="{style}" x1="0" y1="4" x2="24" y2="4"/></svg>'
    return f"<span>{line} {escape(text)} </span>"
