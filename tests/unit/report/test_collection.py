from pathlib import Path

import pytest

from seqid_cli.errors import ConfigError, SeqidError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_any
from seqid_cli.params.results.prediction import FileId
from seqid_cli.report.collection import collect
from tests.unit.params.documents import (
    diagnosis_file,
    friction_file,
    full_file,
    gravity_file,
    inertia_file,
)
from tests.unit.report.pages import (
    all_documents,
    before_and_after,
    good_documents,
    prediction_file,
    source,
    write_documents,
)


def test_stages_of_one_branch_join_and_the_refined_model_leads() -> None:
    documents = [source("friction.json", friction_file()), *all_documents()]
    found = collect([*documents, *documents])
    assert len(found.sources) == len(documents)  # each counts once
    assert [model.kind for model in found.models] == ["refined", "identified"]
    assert found.models[1].path == "inertia.json"
    assert found.models[1].sources[0].path == "friction.json"
    assert [item.path for item in found.predictions] == ["prediction.json"]
    assert [item.path for item in found.diagnoses] == ["diagnosis.json"]


def test_other_joints_are_another_robot() -> None:
    other = diagnosis_file()
    other.robot.joints = ["elbow", "shoulder"]
    with pytest.raises(ConfigError, match=r"other\.json.*elbow, shoulder"):
        collect([*good_documents(), source("other.json", other)])


def test_files_that_disagree_are_models_of_their_own() -> None:
    other, rest, refined, again = gravity_file(), friction_file(), full_file(), full_file()
    for file in (other, rest, refined):
        file.stages.friction.joints["elbow"].rmse = 0.7
    again.closed_loop.after["elbow"].rmse = 0.15
    files = {"inertia": inertia_file(), "other": other, "friction": rest}
    files |= {"refined": refined, "again": again}
    models = collect([source(path, file) for path, file in files.items()]).models
    assert [[item.path for item in model.sources] for model in models] == [
        ["refined"],
        ["again"],
        ["inertia"],
        ["friction", "other"],
    ]


def test_the_best_model_is_judged_and_its_prediction_leads() -> None:
    found = collect(before_and_after())
    assert [item.path for item in found.predictions] == ["after.json", "before.json"]
    assert [item.path for item in found.judged] == ["after.json"]
    labels = [found.label(item) for item in found.predictions]
    assert labels == ["after: refined.json", "before: inertia.json"]


@pytest.mark.parametrize("place", ["joints", "findings", "unexplained", "logs"])
def test_joints_that_the_robot_has_not_are_an_error(place: str) -> None:
    diagnosis, prediction = diagnosis_file(), prediction_file()
    prediction.logs[1].joints = {"wrist": prediction.joints["elbow"]}
    if place == "joints":
        diagnosis.joints["wrist"] = diagnosis.joints["elbow"]
    elif place != "logs":
        getattr(diagnosis, place)[0].joint = "wrist"
    with pytest.raises(ConfigError, match=rf"x\.json: \$\.{place}.*'wrist'"):
        check_consistency(prediction if place == "logs" else diagnosis, "x.json")


def test_evidence_needs_as_many_torques_as_places() -> None:
    diagnosis = diagnosis_file()
    diagnosis.unexplained[0].evidence.after.pop()
    with pytest.raises(ConfigError, match=r"x\.json: \$\.unexplained\[0\]\.evidence"):
        check_consistency(diagnosis, "x.json")


def test_files_are_read_by_what_they_say_they_are(tmp_path: Path) -> None:
    documents = all_documents()
    write_documents(tmp_path, documents)
    read = read_any([tmp_path / item.path for item in documents])
    texts = [encode(item.content) for item in documents]
    assert [encode(item.content) for item in read] == texts
    assert [item.sha256 for item in read] == [item.sha256 for item in documents]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ('{"schema": "other/params@1"}', "is no result"),
        ('{"schema": "seqid/trend@1"}', "is a trend file"),
        ('{"schema": "seqid/diagnosis@9"}', "seqid/diagnosis@9"),
        ('{"schema": "seqid/prediction@1", "created": 5}', "created"),
        ('{"schema": "seqid/params@1"}', "created"),
        ('{"schema": "seqid/prediction@1", "created": "' + "[" * 9000, "is not valid JSON"),
    ],
)
def test_what_is_no_result_is_an_error_with_its_file(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(SeqidError) as caught:
        read_any([path])
    assert message in caught.value.message
    assert caught.value.where == str(path)
    assert caught.value.hint


def test_a_reference_to_another_file_does_not_count_as_stale() -> None:
    parameters, prediction = good_documents()
    assert not isinstance(prediction.content, type(parameters.content))
    moved = prediction_file()
    moved.parameters = [FileId(path="moved/inertia.json", sha256=parameters.sha256)]
    assert collect([parameters, source("prediction.json", moved)]).warnings == ()
