import base64
import hashlib
import itertools
import re
from html.parser import HTMLParser
from importlib.resources import files

import pytest

from seqid_cli.params.schema import RigidStage
from seqid_cli.report.make import make_report
from tests.unit.params.documents import friction_file
from tests.unit.report.pages import all_documents, source, write_torques

HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}"
VOID = {"meta", "link", "br", "input", "img"}


class Outline(HTMLParser):
    """What a page consists of."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.unbalanced: list[str] = []
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element."""
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element without content."""
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        """Check that what closes was open."""
        if not self.open or self.open.pop() != tag:
            self.unbalanced.append(tag)

    def handle_data(self, data: str) -> None:
        """Note text."""
        self.texts.append(data)


def outline(html: str) -> Outline:
    parser = Outline()
    parser.feed(html)
    parser.close()
    assert parser.unbalanced == []
    assert parser.open == []
    return parser


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("page")
    torques = write_torques(folder / "t.parquet")
    return make_report(all_documents(), torques=[torques]).html


def test_the_page_asks_for_nothing(page: str) -> None:
    found = outline(page)
    for tag, attributes in found.tags:
        assert tag not in ("iframe", "object", "embed", "base", "form", "img")
        for name in ("src", "href", "action", "xlink:href", "srcset", "style"):
            value = attributes.get(name)
            assert value is None or value.startswith("#") or value == "data:,"
        assert not any(name.startswith("on") for name in attributes)
    style = (files("seqid_cli.report") / "templates" / "style.css").read_text()
    assert "url(" not in style
    assert "@import" not in style
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")


def test_the_policy_allows_its_own_style_and_script_only(page: str) -> None:
    (policy,) = [
        attributes["content"]
        for tag, attributes in outline(page).tags
        if attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy
    for tag in ("style", "script"):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy


def test_every_drawing_says_what_it_shows(page: str) -> None:
    drawings = re.findall(r"<svg(?! class=\"marks\")[^>]*>.{0,60}", page)
    assert len(drawings) > 20
    for drawing in drawings:
        assert 'role="img"' in drawing
        assert "><title>" in drawing
    figures = re.findall(r"<figure.*?</figure>", page, re.DOTALL)
    assert figures
    for figure in figures:
        assert re.search(r"<desc>[^<]+</desc>", figure)
    over_data = [figure for figure in figures if "data-name" in figure]
    assert over_data
    assert all("<table>" in figure and "tabindex" in figure for figure in over_data)


def test_headings_are_in_order_and_ids_are_unique(page: str) -> None:
    found = outline(page)
    levels = [int(tag[1]) for tag, _ in found.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    ids = [attributes["id"] for _, attributes in found.tags if "id" in attributes]
    assert len(set(ids)) == len(ids)
    targets = [str(a["href"])[1:] for tag, a in found.tags if tag == "a"]
    assert set(targets) <= set(ids)
    named = [a["aria-labelledby"] for _, a in found.tags if "aria-labelledby" in a]
    assert set(named) <= set(ids)
    assert ("html", {"lang": "en"}) in found.tags


def test_names_from_files_stay_text() -> None:
    """Of robots, logs and parameters, in notes, and of joints."""
    documents, joints = all_documents(), friction_file()
    for item in documents:
        item.content.robot.name = HOSTILE
        for entry in item.content.inputs:
            entry.path = HOSTILE
        stages = getattr(item.content, "stages", None)
        for stage in (getattr(stages, "gravity", None), getattr(stages, "inertia", None)):
            if isinstance(stage, RigidStage):
                first = stage.parameters[0]
                first.name = first.expression = first.unit = HOSTILE
                first.terms, stage.notes, stage.not_excited = {HOSTILE: 2.0}, [HOSTILE], [HOSTILE]
    friction = joints.stages.friction
    joints.robot.joints = [HOSTILE, "elbow"]
    friction.joints = {HOSTILE: friction.joints["shoulder"], "elbow": friction.joints["elbow"]}
    friction.verdicts = []
    for own, title in ((documents, HOSTILE), ([source("f.json", joints)], "")):
        html = make_report(own, title=title).html
        assert "alert(1)</script>" not in html
        assert "&lt;script&gt;alert(1)" in html
        assert "49" not in re.findall(r"<title>(.*?)</title>", html)[0]
        assert [tag for tag, _ in outline(html).tags].count("script") == 1


@pytest.mark.parametrize(
    "odd",
    [
        {"speed_range": [0.0, 0.0]},
        {"speed_range": [0.0, 1.0], "speed_scale": "log"},
        {"speed_range": [-3.0, -1.0]},
        {"position_range": [1.0, 1.0]},
        {"position_range": [-1e300, 1e300]},
        {"positive": [[0.0], [0.0]]},
        {"positive": [[1e-300], [0.0]]},
        {"positive": [[1e200], [1e200]], "covariance": [[1e300, 0.0], [0.0, 1e300]]},
        {"positive": [[1.7e308], [1.7e308]]},
        {"covariance": []},
    ],
)
def test_odd_surfaces_do_no_harm(odd: dict[str, object]) -> None:
    file = friction_file()
    for name, value in odd.items():
        setattr(file.stages.friction.joints["elbow"], name, value)
    html = make_report([source("f.json", file)]).html
    drawn = re.findall(r'points="([^"]*)"', html)
    assert drawn
    assert not any("n" in points for points in drawn)  # neither nan nor inf
    elbow = html.split('id="friction-2"')[1].split("</section>")[0]
    assert "<svg" in elbow or "not finite" in elbow


def luminance(color: str) -> float:
    text = color.lstrip("#")
    text = "".join(2 * sign for sign in text) if len(text) == 3 else text
    parts = [int(text[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_colours_contrast_in_both_themes() -> None:
    """By the contrast ratio of WCAG 2: text 4.5, lines 3."""
    style = (files("seqid_cli.report") / "templates" / "style.css").read_text()
    blocks = re.findall(r":root\{(.*?)\}", style, re.DOTALL)
    assert len(blocks) == 2
    badges = ("good", "poor", "open", "none")
    lines = ("predicted", "residual", "cut0", "cut1", "cut2", "before", "after")
    words = ("ink", "soft", "link", "good", "poor", "open")
    pairs = [(name, ground, 4.5) for name in words for ground in ("paper", "card")]
    pairs += [(name, f"{name}-fill", 4.5) for name in badges] + [("ink", "none-fill", 4.5)]
    pairs += [(name, "paper", 3.0) for name in lines] + [("residual", "residual-fill", 3.0)]
    for block in blocks:
        theme = dict(re.findall(r"--([\w-]+):(#\w+)", block))
        for name, ground, least in pairs:
            dark, light = sorted(luminance(theme[x]) for x in (name, ground))
            assert (light + 0.05) / (dark + 0.05) >= least, (name, ground)
