"""The verdict of a report, beside the page itself."""

from seqid_cli.params.base import Document, Struct

TITLES = {  # of verdicts
    "good": "Good",
    "reservations": "Good, with reservations",
    "poor": "Poor",
    "not_judged": "Not judged yet",
}


class ReportPoint(Struct, kw_only=True):
    """A point that is wrong or missing, and the file in which it shows."""

    weight: str
    text: str
    where: str


class ReportSection(Struct, kw_only=True):
    """A section of the page, and whether all its data were given."""

    id: str
    complete: bool


class ReportFile(Document, kw_only=True):
    """The verdict in a word, in a sentence, and point by point; the page's sources.

    `figures` are the files that stand alone: drawings, and the table of parameters.
    """

    output: str
    robot: str
    verdict: str
    sentence: str
    points: list[ReportPoint]
    sections: list[ReportSection]
    files: list[str]
    torques: str | None
    bytes: int
    figures: list[str] = []
