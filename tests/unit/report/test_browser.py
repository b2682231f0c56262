"""The page in a real browser: offline, without complaints, on a desk and on a phone."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from seqid_cli.report.make import make_report
from tests.unit.report.browser import Tab, browser_path, browsing
from tests.unit.report.pages import all_documents, good_documents, write_torques
from tests.unit.report.test_page import HOSTILE

WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    browser_path()
    with browsing(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    torques = write_torques(folder / "t.parquet")
    path = folder / "report.html"
    path.write_text(make_report(all_documents(), torques=[torques]).html, encoding="utf-8")
    return path


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_it_opens_alone_and_fits(tab: Tab, page: Path, width: int, dark: bool) -> None:
    tab.open(page, width=width, dark=dark)
    assert [url for url in tab.requests if not url.startswith("data:")] == [page.as_uri()]
    assert tab.complaints == []
    tab.run("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    assert tab.run("[document.documentElement.scrollWidth, innerWidth]") == [width, width]
    ground = tab.run("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(20, 24, 28)" if dark else "rgb(252, 252, 251)")


def test_no_table_is_wider_than_its_place_on_a_screen(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    tab.run("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    wide = tab.run(
        "Array.from(document.querySelectorAll('.scroll')).filter((item) =>"
        " item.scrollWidth > item.clientWidth + 1).map((item) => item.ariaLabel)"
    )
    assert wide == []


def test_it_prints_on_few_sheets(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    pdf = base64.b64decode(tab.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 9


def test_text_in_drawings_stays_readable_on_a_phone(tab: Tab, page: Path) -> None:
    tab.open(page, width=390)
    smallest = tab.run(
        "Math.min(...Array.from(document.querySelectorAll('svg.plot text'), (text) =>"
        " parseFloat(getComputedStyle(text).fontSize) * text.getScreenCTM().a))"
    )
    assert smallest >= 9.0


def test_drawings_give_their_values_by_keyboard(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    first = "document.querySelector('svg.readable')"
    read = f"{first}.closest('figure').querySelector('output').textContent"
    assert tab.run(read) == ""
    tab.run(f"{first}.focus()")
    shown = tab.run(read)
    assert shown.startswith("t = ")
    for name in ("measured", "predicted", "residual"):
        assert name in shown
    for key in ("End", "ArrowLeft"):
        tab.call("Input.dispatchKeyEvent", type="keyDown", key=key)
    assert tab.run(read) != shown
    at = float(tab.run(read).split("=")[1].split()[0])
    assert 15.8 < at < 15.996


def test_values_follow_the_pointer(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    x, y = tab.run(
        "(() => { const svg = document.querySelector('svg.readable'); svg.scrollIntoView();"
        " const box = svg.getBoundingClientRect();"
        " return [box.x + box.width / 2, box.y + box.height / 2]; })()"
    )
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    read = "document.querySelector('svg.readable').closest('figure').querySelector('output')"
    assert "measured" in tab.run(f"{read}.textContent")


def test_hostile_names_run_nothing(tab: Tab, tmp_path: Path) -> None:
    documents = good_documents()
    for item in documents:
        item.content.robot.name = HOSTILE
    path = tmp_path / "report.html"
    path.write_text(make_report(documents, title=HOSTILE).html, encoding="utf-8")
    tab.open(path, width=1280)
    assert tab.complaints == []
    assert tab.run("document.querySelector('h1').textContent") == HOSTILE


def test_the_policy_stops_what_got_in(tab: Tab, tmp_path: Path) -> None:
    html = make_report(good_documents()).html
    inside = "<script>window.got = 1</script><img src='http://127.0.0.1:9/x' onerror='got = 2'>"
    path = tmp_path / "report.html"
    path.write_text(html.replace("</main>", inside + "</main>"), encoding="utf-8")
    tab.open(path, width=1280)
    assert tab.run("typeof window.got") == "undefined"
    assert len(tab.complaints) >= 2


@pytest.mark.parametrize("width", WIDTHS)
def test_long_names_do_not_widen_the_page(tab: Tab, tmp_path: Path, width: int) -> None:
    name = "joint_" + 150 * "x"
    documents = all_documents()
    for item in documents:
        item.content.robot.name = name
        for entry in item.content.inputs:
            entry.path = name
    path = tmp_path / "report.html"
    path.write_text(make_report(documents).html, encoding="utf-8")
    tab.open(path, width=width)
    tab.run("document.querySelectorAll('details').forEach((item) => { item.open = true; })")
    assert tab.run("[document.documentElement.scrollWidth, innerWidth]") == [width, width]
