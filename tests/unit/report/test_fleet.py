import re

from seqid_cli.report.fleet import fleet_page
from seqid_cli.report.words import DASH
from tests.unit.report.pages import good_documents, made_with, prediction_file, source


def test_the_worst_robot_leads_and_gives_the_verdict() -> None:
    parameters, _ = good_documents()
    poor = made_with(prediction_file(shares=(0.02, 0.5)), parameters)
    robots = {
        "cell <1>": good_documents(),
        "cell 2": [parameters, source("prediction.json", poor)],
        "cell 3": [parameters],
    }
    page = fleet_page(robots)
    judgement = page.judgement
    assert judgement.level == "poor"
    assert judgement.sentence == ("3 robots. Poor: cell 2; not judged yet: cell 3; good: cell <1>.")
    assert [point.text for point in judgement.points] == ["elbow: misses 50%"]
    assert [group.title for group in page.sections[1].groups] == ["cell 2", "cell 3", "cell <1>"]
    links = re.findall(r'<a href="#(robot-[0-9])">([^<]*)</a>', page.html)
    assert links == [("robot-1", "cell 2"), ("robot-2", "cell 3"), ("robot-3", "cell &lt;1&gt;")]
    for place, name in links:
        assert re.search(rf'id="{place}-title">{re.escape(name)}</h3>', page.html)
    table = page.html.split("Models and their errors</span>")[1].split("</table>")[0]
    cells = re.findall(r'<td class="n">([^<]*)</td>', table)
    assert cells == ["50.0 %", "1", DASH, "1", "5.0 %", "0"]
