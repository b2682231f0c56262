"""From sections to one HTML text: templates, style sheet and script, all from the package.

Everything that comes from a file is escaped by the templates. The page may not load anything: its
policy names the style sheet and the script by their hashes and forbids everything else.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files

import jinja2

from seqid_cli import __version__
from seqid_cli.params.document import now
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Section


def render(
    title: str,
    about: Sequence[str],
    judgement: Judgement,
    sections: Sequence[Section],
    *,
    subject: str = "Dynamic model",
) -> str:
    """Return the page; `about` are facts under its title, `subject` says what it is about."""
    folder = files("seqid_cli.report") / "templates"
    style, script = (
        (folder / name).read_text(encoding="utf-8") for name in ("style.css", "script.js")
    )
    page: str = (
        _environment()
        .get_template("report.html.j2")
        .render(
            title=title,
            about=about,
            subject=subject,
            judgement=judgement,
            sections=sections,
            style=style,
            script=script,
            policy=_policy(style, script),
            version=__version__,
            created=now(),
        )
    )
    return page


def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("seqid_cli.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _policy(style: str, script: str) -> str:
    return (
        f"default-src 'none'; style-src '{_source(style)}'; script-src '{_source(script)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _source(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return "sha256-" + base64.b64encode(digest).decode()
