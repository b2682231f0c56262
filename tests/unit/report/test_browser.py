"""The page in a real browser: offline, without complaints, on a desk and on a phone."""

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from seqid_cli.report.make import make_report
from tests.unit.report.browser import Tab, browsing
from tests.unit.report.pages import all_documents, good_documents, page_of_all

WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browsing(tmp_path_factory.mktemp("profile")) as browser_tab:
        yield browser_tab


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(page_of_all(path.parent), encoding="utf-8")
    return path


def assert_fits(tab: Tab, width: int) -> None:
    """With all its tables open the page is as wide as the screen."""
    tab.run(
        "document.querySelectorAll('details').forEach((item) => { item.open = true; })"
    )
    assert tab.run("[document.documentElement.scrollWidth, innerWidth]") == [
        width,
        width,
    ]


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", WIDTHS)
def test_it_opens_alone_and_fits(tab: Tab, page: Path, width: int, dark: bool) -> None:
    tab.open(page, width=width, dark=dark)
    assert [url for url in tab.requests if not url.startswith("data:")] == [
        page.as_uri()
    ]
    assert tab.complaints == []
    assert_fits(tab, width)
    ground = tab.run("getComputedStyle(document.body).backgroundColor")
    assert ground == ("rgb(20, 24, 28)" if dark else "rgb(252, 252, 251)")


def test_it_is_read_on_a_screen_on_paper_and_on_a_phone(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    pdf = base64.b64decode(tab.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 9
    assert_fits(tab, 1280)
    wide_tables = tab.run(
        "Array.from(document.querySelectorAll('.scroll')).filter((item) =>"
        " item.scrollWidth > item.clientWidth + 1).map((item) => item.ariaLabel)"
    )
    assert wide_tables == []
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
    text = tab.run(read)
    assert text.startswith("t = ")
    for name in ("measured", "predicted", "residual"):
        assert name in text
    for key in ("End", "ArrowLeft"):
        tab.call("Input.dispatchKeyEvent", type="keyDown", key=key)
    assert tab.run(read) != text
    at = float(tab.run(read).split("=")[1].split()[0])
    assert 15.8 < at < 15.996


def drag(tab: Tab, start: float, end: float, *, shift: bool = False) -> None:
    """Drag over the first plot, from one share of its width to another."""
    left_px, top_px, width_px = tab.run(
        "(() => { const svg = document.querySelector('svg.readable');"
        " svg.scrollIntoView(); const box = svg.getBoundingClientRect(), scale ="
        " box.width / svg.viewBox.baseVal.width; const [start, end] ="
        " svg.querySelector('.panel').dataset.x.split('|').slice(4); return [box.x +"
        " scale * start, box.y + box.height / 3, scale * (end - start)]; })()"
    )

    events = (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end))
    for kind, share in events:
        tab.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=left_px + share * width_px,
            y=top_px,
            button="left",
            buttons=1,
            clickCount=1,
            modifiers=8 if shift else 0,
        )


def seen(tab: Tab) -> list[float]:
    """First and last place that the first plot shows, as shares of the whole."""
    return list(
        tab.run(
            "(() => { const all = document.querySelector('.panel[data-x]');"
            " const [start, end] = all.dataset.x.split('|').slice(4, 6).map(Number);"
            " const { x, width } = all.querySelector('.marks').viewBox.baseVal;"
            " return [x, x + width].map((at) => (at - start) / (end - start)); })()"
        )
    )


def test_a_plot_zooms_pans_and_goes_back(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    ticks = (
        "Array.from(document.querySelectorAll('svg.readable .ticks-x text'), (t) =>"
        " t.textContent)"
    )
    all_ticks = tab.run(ticks)

    drag(tab, 0.25, 0.5)
    assert seen(tab) == pytest.approx([0.25, 0.5], abs=0.01)
    first_ticks = [float(text) for text in tab.run(ticks)[:3]]
    assert all(0.24 * 16 <= time <= 0.51 * 16 for time in first_ticks)
    read = (
        "document.querySelector('svg.readable').closest('figure')"
        ".querySelector('output')"
    )
    time = float(tab.run(f"{read}.textContent").split("=")[1].split()[0])
    assert time == pytest.approx(0.5 * 16, abs=0.1)  # where the pointer was let go

    drag(tab, 0.8, 0.4, shift=True)
    assert seen(tab) == pytest.approx([0.35, 0.6], abs=0.01)
    tab.run(
        "document.querySelector('svg.readable').dispatchEvent(new"
        " MouseEvent('dblclick'))"
    )
    assert seen(tab) == pytest.approx([0.0, 1.0])
    assert tab.run(ticks) == all_ticks
    assert tab.complaints == []


def test_a_plot_zooms_by_keys_and_buttons(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    tab.run("document.querySelector('svg.readable').focus()")
    for key in "++":
        tab.call("Input.dispatchKeyEvent", type="keyDown", key=key)
    low, high = seen(tab)
    assert high - low == pytest.approx(0.25)
    # the view follows the cursor
    tab.call("Input.dispatchKeyEvent", type="keyDown", key="Home")
    assert seen(tab) == pytest.approx([0.0, 0.25], abs=1e-3)
    buttons = "document.querySelector('figure .zoom').children"
    tab.run(f"{buttons}[1].click()")
    assert seen(tab) == pytest.approx([0.0, 0.5], abs=1e-3)
    tab.run(f"{buttons}[2].click()")
    assert seen(tab) == pytest.approx([0.0, 1.0])
    tab.run(
        "document.querySelectorAll('.zoom button').forEach((button) => button.click())"
    )
    assert tab.complaints == []


def choose_joint(tab: Tab, name: str) -> None:
    """Choose a joint in the list of the navigation, as a user does."""
    tab.run(
        "(() => { const choice = document.querySelector('.choice select');"
        f" choice.value = '{name}'; choice.dispatchEvent(new Event('change')); }})()"
    )


def shown_parts(tab: Tab) -> list[str]:
    """Return the visible parts about one joint: groups by id, figures by title."""
    return list(
        tab.run(
            "Array.from(document.querySelectorAll('[data-joint]')).filter((item) =>"
            " item.checkVisibility()).map((item) => item.id ||"
            " item.querySelector('svg title').textContent)"
        )
    )


def test_one_joint_can_be_chosen(tab: Tab, page: Path) -> None:
    shoulder = [
        "torque-1",
        "friction-1",
        "Unexplained torque of shoulder over position",
    ]
    elbow = ["torque-2", "friction-2", "finding-1-1"]
    elbow += ["stribeck at elbow: residual of elbow over speed"]
    tab.open(page, width=1280)
    all_parts = shown_parts(tab)
    assert sorted(all_parts) == sorted(shoulder + elbow)

    choose_joint(tab, "elbow")
    assert sorted(shown_parts(tab)) == sorted(elbow)
    choose_joint(tab, "shoulder")
    assert sorted(shown_parts(tab)) == sorted(shoulder)

    # A link to something that is hidden shows all joints again.
    tab.run("document.querySelector('.glance a[href=\"#torque-2\"]').click()")
    tab.run("new Promise((done) => setTimeout(done, 100))")
    assert shown_parts(tab) == all_parts


def test_what_is_about_several_joints_stays(tab: Tab, page: Path) -> None:
    tab.open(page, width=1280)
    about_all = (
        "Array.from(document.querySelectorAll('figure')).filter((item) =>"
        " item.checkVisibility() && !item.closest('[data-joint]')).length"
    )
    count = tab.run(about_all)
    # errors over the noise floor, of the diagnosis and of the refinement
    assert count >= 2
    choose_joint(tab, "elbow")
    assert tab.run(about_all) == count


def test_all_is_there_without_a_script(tab: Tab, page: Path) -> None:
    tab.call("Emulation.setScriptExecutionDisabled", value=True)
    tab.open(page, width=1280)
    tab.call("Emulation.setScriptExecutionDisabled", value=False)
    assert tab.run("document.querySelectorAll('.zoom, .choice, [hidden]').length") == 0
    assert tab.run("document.querySelectorAll('figure svg .ticks-x text').length") > 20


@pytest.mark.slow
def test_the_policy_stops_what_got_in(tab: Tab, tmp_path: Path) -> None:
    html = make_report(good_documents()).html
    inside = (
        "<script>window.got = 1</script><img src='http://127.0.0.1:9/x' onerror='got"
        " = 2'>"
    )
    path = tmp_path / "report.html"
    path.write_text(html.replace("</main>", inside + "</main>"), encoding="utf-8")
    tab.open(path, width=1280)
    assert tab.run("typeof window.got") == "undefined"
    assert len(tab.complaints) >= 2


@pytest.mark.slow
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
    assert_fits(tab, width)
