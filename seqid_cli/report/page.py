"""From sections to one HTML text: templates, style sheet and script, all from the package.

Everything that comes from a file is escaped by the templates. The page may not load anything: its
policy names the style sheet and the script by their hashes and forbids everything else.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from seqid_cli import __version__
from seqid_cli.params.document import now
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section
from seqid_cli.report.words import unit_text
from seqid_cli.templates import filled


@dataclass(frozen=True)
class Page:
    """The content of a page.

    `about` are facts under its title, `subject` says what it is about; `robot`, `files` and
    `torques` name what it was made of, `warnings` files that fit, but not perfectly.
    """

    title: str
    about: Sequence[str]
    judgement: Judgement
    sections: Sequence[Section]
    robot: str
    files: Sequence[str]
    subject: str = "Dynamic model"
    torques: Sequence[str] = ()
    warnings: Sequence[str] = ()

    @property
    def html(self) -> str:
        """The page as one text."""
        parts = style, script = resource("style.css"), resource("script.js")
        own = [base64.b64encode(hashlib.sha256(part.encode()).digest()).decode() for part in parts]
        policy = (
            f"default-src 'none'; style-src 'sha256-{own[0]}'; script-src 'sha256-{own[1]}'; "
            "img-src data:; base-uri 'none'; form-action 'none'"
        )
        content = {
            "page": self,
            "version": __version__,
            "style": style,
            "script": script,
            "policy": policy,
            "created": now(),
        }
        filters = {"unit": unit_text}
        return filled("seqid_cli.report", "report.html.j2", content, filters=filters, markup=True)


def resource(name: str) -> str:
    """Return a file of the templates as text."""
    return (files("seqid_cli.report") / "templates" / name).read_text(encoding="utf-8")
