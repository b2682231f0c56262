"""The page as a file: it asks for nothing, stays whole on odd input, and says what it
said.
"""

import base64
import hashlib
import itertools
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest

from seqid_cli import __version__
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import MotionUse, RigidStage
from seqid_cli.report import words
from seqid_cli.report.fleet import fleet_page
from seqid_cli.report.make import make_report
from seqid_cli.report.views import Page, style_sheet
from tests.transcripts import check_text
from tests.unit.params.documents import friction_file, inertia_file
from tests.unit.report.pages import (
    all_documents,
    good_documents,
    made_with,
    page_of_all,
    payload_file,
    plan_file,
    prediction_file,
    source,
    write_torques,
)

HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}"
VOID = {"meta", "link", "br", "input", "img"}


class Outline(HTMLParser):
    """The elements of a page in order; what is open is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of_all(tmp_path_factory.mktemp("page"))


def test_the_page_asks_for_nothing(page: str) -> None:
    outline = Outline(page)
    for tag, attributes in outline.tags:
        assert tag not in ("iframe", "object", "embed", "base", "form", "img")
        for name in ("src", "href", "action", "xlink:href", "srcset", "style"):
            value = attributes.get(name)
            assert value is None or value.startswith("#") or value == "data:,"
        assert not any(name.startswith("on") for name in attributes)
    style = style_sheet()
    assert "url(" not in style
    assert "@import" not in style
    assert "http" not in page.replace("http-equiv", "").replace(
        "http://www.w3.org/2000/svg", ""
    )


def test_the_policy_allows_its_own_style_and_script_only(page: str) -> None:
    metas = {a.get("http-equiv"): a.get("content") for _, a in Outline(page).tags}
    policy = str(metas["Content-Security-Policy"])
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
    outline = Outline(page)
    levels = [int(tag[1]) for tag, _ in outline.tags if re.fullmatch("h[1-6]", tag)]
    assert (levels[0], levels.count(1)) == (1, 1)
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    ids = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(set(ids)) == len(ids)
    targets = {str(a["href"])[1:] for tag, a in outline.tags if tag == "a"}
    named = {a["aria-labelledby"] for _, a in outline.tags if "aria-labelledby" in a}
    assert targets | named <= set(ids)
    assert ("html", {"lang": "en"}) in outline.tags


def test_names_from_files_stay_text() -> None:
    """Names of robots, logs and parameters, in notes, and of joints."""
    documents = all_documents()
    for item in documents:
        item.content.robot.name = HOSTILE
        for entry in item.content.inputs:
            entry.path = HOSTILE
        stages = getattr(item.content, "stages", None)
        for stage in (
            getattr(stages, "gravity", None),
            getattr(stages, "inertia", None),
        ):
            if isinstance(stage, RigidStage):
                first = stage.parameters[0]
                first.name = first.expression = first.unit = HOSTILE
                first.terms = {HOSTILE: 2.0}
                stage.notes = [HOSTILE]
                stage.not_excited = [HOSTILE]

    joints = friction_file()
    friction = joints.stages.friction
    joints.robot.joints = [HOSTILE, "elbow"]
    friction.joints = {
        HOSTILE: friction.joints["shoulder"],
        "elbow": friction.joints["elbow"],
    }
    friction.verdicts = []

    of_joints = [source("f.json", joints)]
    for sources, title in ((documents, HOSTILE), (of_joints, "")):
        html = make_report(sources, title=title).html
        assert "alert(1)</script>" not in html
        assert "&lt;script&gt;alert(1)" in html
        assert "49" not in re.findall(r"<title>(.*?)</title>", html)[0]
        assert [tag for tag, _ in Outline(html).tags].count("script") == 1


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
    linear = [
        p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_colours_contrast_in_both_themes() -> None:
    """By the contrast ratio of WCAG 2: text 4.5, lines 3."""
    style = style_sheet()
    blocks = re.findall(r":root\{(.*?)\}", style, re.DOTALL)
    assert len(blocks) == 2
    badges = ("good", "poor", "open", "none")
    lines = ("predicted", "residual", "cut0", "cut1", "cut2", "before", "after")
    words = ("ink", "soft", "link", "good", "poor", "open")
    pairs = [(name, ground, 4.5) for name in words for ground in ("paper", "card")]
    pairs += [(name, f"{name}-fill", 4.5) for name in badges] + [
        ("ink", "none-fill", 4.5)
    ]
    pairs += [(name, "paper", 3.0) for name in lines] + [
        ("residual", "residual-fill", 3.0)
    ]
    for block in blocks:
        theme = dict(re.findall(r"--([\w-]+):(#\w+)", block))
        for name, ground, least in pairs:
            dark, light = sorted(luminance(theme[x]) for x in (name, ground))
            assert (light + 0.05) / (dark + 0.05) >= least, (name, ground)


BREAKS = {"h2": "\n# ", "h3": "\n## ", "tr|li|p|caption|figcaption|details|pre": "\n"}


def text_of(page: Page) -> str:
    """Its text in lines, with the first rows of the tables below its figures."""
    text = page.html.partition("</nav>")[2].partition("</main>")[0]
    text = re.sub(r'<svg class="marks".*?</svg>', "", text, flags=re.DOTALL)
    text = re.sub(r"<svg.*?<desc>(.*?)</desc>.*?</svg>", r"[\1]", text, flags=re.DOTALL)
    for figure in re.findall(r"<figure.*?</figure>", text, flags=re.DOTALL):
        drawing, _, values = figure.partition("<details>")
        rows = re.findall(r"<tr>.*?</tr>", values, flags=re.DOTALL)
        text = text.replace(figure, drawing + "".join(rows[:3]))
    text = re.sub(r"\s*\n\s*", " ", text)
    for tags, mark in BREAKS.items():
        text = re.sub(rf"<({tags})\b", rf"{mark}<\1", text)
    text = re.sub(r'<span class="badge (\w+)">', r" (\1) ", text)
    text = re.sub(r"</(td|th|dd)>", " | ", text).replace("</dt>", ": ")
    text = unescape(re.sub(r"<[^>]*>", "", text)).replace(
        f"seqid {__version__}", "seqid"
    )
    text = re.sub(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", "DATE", text)
    text = re.sub(r"\b[0-9a-f]{12}(?:[0-9a-f]{52})?\b", "HASH", text)
    return "\n".join(line.strip(" |") for line in text.splitlines()) + "\n"


def used(log: str, *warnings: str) -> MotionUse:
    from_what = (
        {"source": "encoder"} if warnings else {"source": "fused", "imus": ["imu_a"]}
    )
    errors = {
        "acceleration_error": {"shoulder": 0.0123},
        "encoder_error": {"shoulder": 0.987},
    }
    return MotionUse(
        log=log, cutoff_hz=20.0, warnings=list(warnings), **from_what, **errors
    )


def everything(folder: Path) -> Page:
    """All kinds of documents, and torques."""
    parameters, *documents, refined = all_documents()
    lost = [used(f"{name}.parquet", "imu_a is not recorded") for name in "bc"]
    refined.content.stages.inertia.motion_use = [used("inertia/a.parquet"), *lost]  # type: ignore
    model = FileId(path=parameters.path, sha256=parameters.sha256)
    payload = source("payload.json", payload_file(model))
    plan = source("plan.json", plan_file())
    torques = [write_torques(folder / "t.parquet")]
    return make_report(
        [parameters, *documents, refined, payload, plan],
        torques=torques,
        title="An arm",
    )


def parameters_alone(folder: Path) -> Page:
    """Parameters of a planar arm; what is missing comes with its command."""
    file = inertia_file()
    note = "gravity loads no joint"
    file.stages.gravity = RigidStage(parameters=[], condition=0.0, rank=0, notes=[note])
    return make_report([source("inertia.json", file)])


def friction_of_sliding_joint(folder: Path) -> Page:
    file = friction_file()
    file.robot.prismatic = ["elbow"]
    return make_report([source("friction.json", file)])


def fleet(folder: Path) -> Page:
    parameters, _ = good_documents()
    poor = made_with(prediction_file(shares=(0.02, 0.5)), parameters)
    robots = {
        "cell <1>": good_documents(),
        "cell 2": [parameters, source("prediction.json", poor)],
        "cell 3": [parameters],
    }
    return fleet_page(robots)


PAGES = (everything, parameters_alone, friction_of_sliding_joint, fleet)


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_pages_say_what_they_said(make: object, tmp_path: Path) -> None:
    assert callable(make)
    path = Path(__file__).with_name("texts") / f"{make.__name__}.txt"
    check_text(path, text_of(make(tmp_path)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (words.with_error(-4.21669, 0.00283), ("\u22124.2167", "0.0028")),
        (words.with_error(2.0, 0.0), ("2.0000", "0")),
        (words.interval(1.0, 0.0), "\u2013"),
        (words.number(None), "\u2013"),
        (words.number(float("nan")), "\u2013"),
        (words.number(-1.5e-7), "\u22121.50e\u22127"),
        (words.unit_text("rad/s^2"), "rad/s\u00b2"),
        (words.unit_text("1"), ""),
        (words.listed(list("abcdefgh"), 2), "a, b and 6 more"),
        (
            words.command("seqid", "LOG...", "-p", "a b.json"),
            "seqid LOG... -p 'a b.json'",
        ),
        (
            words.expression({"m_3": -0.425}, ""),
            "\u22120.425\u202f<i>m</i><sub>3</sub>",
        ),
        (words.expression({}, "<b>"), "&lt;b&gt;"),
        (words.expression({"<b>_1": 1.0}, ""), "&lt;b&gt;_1"),
    ],
)
def test_odd_numbers_names_and_formulas(text: object, expected: object) -> None:
    assert text == expected


def test_marks_that_turn_text_are_shown_and_not_obeyed() -> None:
    """In the page's title, texts and drawings."""
    file = inertia_file()
    file.robot.name = "arm\u202egnp.exe\u2066"
    file.stages.friction.notes = ["a\u2028b\x85"]
    page = make_report([source("inertia.json", file)]).html
    assert "arm\\u202egnp.exe\\u2066" in page
    assert "a\\u2028b\\u0085" in page
    assert re.search("[\u202a-\u202e\u2066-\u2069\u2028\u2029\x85]", page) is None
