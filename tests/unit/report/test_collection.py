from pathlib import Path

import pytest

from seqid_cli.errors import ConfigError, SeqidError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.encode import encode
from seqid_cli.params.io import Document, Source, read_any
from seqid_cli.params.results.prediction import FileId, PredictionFile
from seqid_cli.params.schema import Verdict
from seqid_cli.report.collection import collect
from seqid_cli.report.judgement import judge
from seqid_cli.report.sections.loop import closed_loop
from seqid_cli.report.sections.pipeline import pipeline
from tests.unit.params.documents import (
    diagnosis_file,
    friction_file,
    full_file,
    gravity_file,
    inertia_file,
    log,
)
from tests.unit.report.pages import (
    all_documents,
    clean_diagnosis,
    good_documents,
    made_with,
    prediction_file,
    source,
    write_documents,
)


def test_stages_of_one_branch_join_and_the_refined_model_leads() -> None:
    documents = [source("friction.json", friction_file()), *all_documents()]
    found = collect(documents)
    assert [model.kind for model in found.models] == ["refined", "identified"]
    assert found.models[1].path == "inertia.json"
    assert found.models[1].sources[0].path == "friction.json"
    assert [item.path for item in found.predictions] == ["prediction.json"]
    assert [item.path for item in found.diagnoses] == ["diagnosis.json"]


def test_the_same_file_twice_counts_once() -> None:
    documents = good_documents()
    assert len(collect([*documents, *documents]).sources) == 2


def test_other_joints_are_another_robot() -> None:
    other = diagnosis_file()
    other.robot.joints = ["elbow", "shoulder"]
    with pytest.raises(ConfigError, match=r"other\.json.*elbow, shoulder"):
        collect([*good_documents(), source("other.json", other)])


def test_files_that_disagree_on_a_stage_are_models_of_their_own() -> None:
    other, rest = gravity_file(), friction_file()
    for file in (other, rest):
        file.stages.friction.joints["elbow"].rmse = 0.7
    files = {"inertia.json": inertia_file(), "other.json": other, "friction.json": rest}
    models = collect([source(path, file) for path, file in files.items()]).models
    assert [[item.path for item in model.sources] for model in models] == [
        ["inertia.json"],
        ["friction.json", "other.json"],
    ]


def test_refined_files_of_different_outcome_are_models_of_their_own() -> None:
    other = full_file()
    other.closed_loop.after["elbow"].rmse = 0.15
    models = collect([source("refined.json", full_file()), source("other.json", other)]).models
    assert [model.path for model in models] == ["refined.json", "other.json"]


def before_and_after() -> list[Source[Document]]:
    """Return both models with a prediction each; the one of before is given first, and poor."""
    documents = all_documents()
    before = made_with(prediction_file(shares=(0.02, 0.5)), documents[0])
    after = made_with(prediction_file(shares=(0.01, 0.02)), documents[3])
    return [*documents, source("before.json", before), source("after.json", after)]


def test_the_best_model_is_judged_and_its_prediction_leads() -> None:
    documents = before_and_after()
    found = collect([item for item in documents if item.path != "prediction.json"])
    assert [item.path for item in found.predictions] == ["after.json", "before.json"]
    assert [item.path for item in found.judged] == ["after.json"]
    labels = [found.label(item) for item in found.predictions]
    assert labels == ["after: refined.json", "before: inertia.json"]
    assert judge(found).level == "reservations"  # poor was the one of before


def test_a_refined_file_may_differ_from_what_it_started_from() -> None:
    refined = full_file()
    refined.stages.friction.joints["elbow"].rmse = 0.7
    found = collect([source("inertia.json", inertia_file()), source("refined.json", refined)])
    assert len(found.models) == 2


def test_a_result_of_parameters_elsewhere_is_a_warning() -> None:
    documents = [good_documents()[0], source("prediction.json", prediction_file())]
    (warning,) = collect(documents).warnings
    assert "elsewhere/inertia.json" in warning
    assert judge(collect(documents)).level == "reservations"


def test_a_changed_robot_file_is_a_warning() -> None:
    documents = good_documents()
    documents[1].content.robot.sha256 = "1" * 64
    (warning,) = collect(documents).warnings
    assert "robot file" in warning


@pytest.mark.parametrize("place", ["joints", "findings", "unexplained", "logs"])
def test_joints_that_the_robot_has_not_are_an_error(place: str) -> None:
    if place == "logs":
        prediction = prediction_file()
        prediction.logs[1].joints = {"wrist": prediction.joints["elbow"]}
        document = source("x.json", prediction)
    else:
        diagnosis = diagnosis_file()
        if place == "joints":
            diagnosis.joints["wrist"] = diagnosis.joints["elbow"]
        elif place == "findings":
            diagnosis.findings[0].joint = "wrist"
        else:
            diagnosis.unexplained[0].joint = "wrist"
        document = source("x.json", diagnosis)
    with pytest.raises(ConfigError, match=rf"x\.json: \$\.{place}.*'wrist'"):
        check_consistency(document.content, document.path)


def test_evidence_needs_as_many_torques_as_places() -> None:
    diagnosis = diagnosis_file()
    diagnosis.unexplained[0].evidence.after.pop()
    with pytest.raises(ConfigError, match=r"x\.json: \$\.unexplained\[0\]\.evidence"):
        check_consistency(diagnosis, "x.json")


def test_good_needs_a_prediction_of_new_logs() -> None:
    verdict = judge(collect(good_documents()))
    assert verdict.level == "good"
    assert verdict.points == ()
    assert "2 logs" in verdict.sentence
    assert "5.0 %" in verdict.sentence
    assert "elbow" in verdict.sentence
    alone = judge(collect(good_documents()[:1]))
    assert alone.level == "not_judged"
    assert any("predict" in point.command for point in alone.points)


def test_a_prediction_of_the_training_logs_judges_nothing() -> None:
    file = inertia_file()
    prediction = prediction_file()
    file.inputs += [log(item.path, "inertia") for item in prediction.logs]
    for item in prediction.logs:
        item.sha256 = file.inputs[-1].sha256
    parameters = source("inertia.json", file)
    documents = [parameters, source("prediction.json", made_with(prediction, parameters))]
    verdict = judge(collect(documents))
    assert verdict.level == "not_judged"
    assert "was identified from" in verdict.points[0].text


def test_what_refinement_read_is_new_to_the_model_before_it() -> None:
    documents = good_documents()
    refined = full_file()
    (*_, prediction) = documents
    assert isinstance(prediction.content, PredictionFile)
    refined.inputs[-1].sha256 = prediction.content.logs[0].sha256
    after = source("refined.json", refined)
    before = judge(collect([*documents, after]))
    assert "On 2 logs" in before.sentence
    again = made_with(prediction_file(), after)
    again.logs[0].sha256 = refined.inputs[-1].sha256
    verdict = judge(collect([after, source("prediction.json", again)]))
    assert "On 1 log " in verdict.sentence
    refined.closed_loop.held_out = [refined.inputs[-1]]  # read, but only to report
    after = source("refined.json", refined)
    again = made_with(again, after)
    verdict = judge(collect([after, source("prediction.json", again)]))
    assert "On 2 logs" in verdict.sentence


def test_training_logs_among_new_ones_do_not_flatter() -> None:
    file = inertia_file()
    prediction = prediction_file()
    flattered = prediction_file(shares=(0.001, 0.001))
    prediction.joints = flattered.joints
    prediction.logs[0].joints = flattered.joints
    file.inputs += [log("training", "inertia")]
    prediction.logs[0].sha256 = file.inputs[-1].sha256
    parameters = source("inertia.json", file)
    documents = [parameters, source("prediction.json", made_with(prediction, parameters))]
    verdict = judge(collect(documents))
    assert verdict.level == "reservations"
    assert "5.0 %" in verdict.sentence
    assert verdict.sentence.startswith("On 1 log ")
    assert "1 of the 2 logs" in verdict.points[0].text


def test_a_poor_prediction_is_poor_and_comes_first() -> None:
    parameters = source("inertia.json", inertia_file())
    prediction = made_with(prediction_file(shares=(0.02, 0.5)), parameters)
    documents = [parameters, source("prediction.json", prediction)]
    documents.append(source("diagnosis.json", diagnosis_file()))
    verdict = judge(collect(documents))
    assert verdict.level == "poor"
    assert verdict.points[0].weight == "poor"
    assert verdict.points[0].text == "elbow: misses 50%"
    assert "elbow: misses 50%" in verdict.sentence


def test_a_poor_stage_is_poor_alone_and_a_reservation_beside_a_good_prediction() -> None:
    file = inertia_file()
    file.stages.friction.verdicts[0] = Verdict(joint="shoulder", good=False, reason="2 speeds")
    parameters = source("inertia.json", file)
    assert judge(collect([parameters])).level == "poor"
    prediction = source("prediction.json", made_with(prediction_file(), parameters))
    verdict = judge(collect([parameters, prediction]))
    assert verdict.level == "reservations"
    assert verdict.points[0].text == "friction of shoulder: 2 speeds"


def test_what_a_diagnosis_found_is_open_until_it_is_in_the_refined_model() -> None:
    diagnosis = diagnosis_file()
    diagnosis.unexplained = []
    documents = [*good_documents(), source("diagnosis.json", diagnosis)]
    verdict = judge(collect(documents))
    assert verdict.level == "reservations"
    found = [point for point in verdict.points if "stribeck at elbow" in point.text]
    assert len(found) == 1
    assert "97 %" in found[0].text
    assert "seqid refine" in found[0].command
    verdict = judge(collect([*documents, source("refined.json", full_file())]))
    assert not [point for point in verdict.points if "stribeck" in point.text]
    assert any("70 %" in line for line in verdict.support)


def test_a_clean_diagnosis_speaks_for_the_model() -> None:
    documents = [*good_documents(), source("diagnosis.json", clean_diagnosis())]
    verdict = judge(collect(documents))
    assert any("nothing is missing" in line for line in verdict.support)


@pytest.mark.parametrize(
    ("rmse", "white", "words"),
    [(0.2, True, "not all that is left is noise"), (0.12, False, "no larger than slow noise")],
)
def test_words_do_not_call_noise_what_is_more(rmse: float, white: bool, words: str) -> None:
    diagnosis = clean_diagnosis()
    diagnosis.joints["elbow"].rmse, diagnosis.joints["elbow"].white = rmse, white
    verdict = judge(collect([*good_documents(), source("diagnosis.json", diagnosis)]))
    assert not any("nothing is missing" in line for line in verdict.support)
    assert any(words in point.text for point in verdict.points)


@pytest.mark.parametrize(("most", "fires"), [(0.03, True), (0.11, False)])
def test_an_error_beyond_the_noise_of_its_own_logs_is_open(most: float, fires: bool) -> None:
    diagnosis = clean_diagnosis()
    elbow = diagnosis.joints["elbow"]  # the prediction's error is 0.1 N m
    elbow.rmse, elbow.noise_floor, elbow.noise_floor_interval = most, 0.02, [0.01, most]
    documents = good_documents()
    prediction = prediction_file()
    diagnosis.inputs = [log(item.path, "") for item in prediction.logs]
    for given, item in zip(diagnosis.inputs, prediction.logs, strict=True):
        given.sha256 = item.sha256
    documents.append(source("diagnosis.json", diagnosis))
    texts = [point.text for point in judge(collect(documents)).points]
    assert any("RMS error on the same logs" in text for text in texts) == fires
    diagnosis.inputs.pop()  # no longer the same logs: nothing can be said
    assert judge(collect(documents)).level == "good"


def test_a_parameter_that_no_log_excites_is_named() -> None:
    file = inertia_file()
    file.stages.inertia.not_excited = ["Iyy_2"]
    parameters = source("inertia.json", file)
    documents = [parameters, source("p.json", made_with(prediction_file(), parameters))]
    (point,) = judge(collect(documents)).points
    assert "Iyy_2" in point.text


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


def test_effects_that_held_out_logs_do_not_confirm_are_a_point_of_the_verdict() -> None:
    file = full_file()
    refined = source("refined.json", file)
    tested = source("prediction.json", made_with(prediction_file(), refined))
    said = "the held-out logs do not confirm stribeck at elbow"
    assert said not in [point.text for point in judge(collect([refined, tested])).points]
    file.closed_loop.rounds[0].confirmed, file.closed_loop.verdict = False, "poor"
    for documents, weight in (([refined], "poor"), ([refined, tested], "open")):
        found = collect(documents)
        assert [p.weight for p in judge(found).points if p.text == said] == [weight]
    (group,) = closed_loop(found).groups
    assert (group.title, group.lead) == ("Added: stribeck at elbow", said)


def test_faults_of_the_logs_are_not_taken_for_effects_that_are_not_confirmed() -> None:
    file = full_file()
    file.closed_loop.verdict = "poor"
    file.closed_loop.verdicts = [Verdict(joint="elbow", good=False, reason="is stuck")]
    (group,) = closed_loop(collect([source("refined.json", file)])).groups
    assert (group.title, group.lead) == ("Added: stribeck at elbow", "elbow: is stuck")


def test_only_friction_that_was_tested_at_speeds_left_out_speaks_for_the_model() -> None:
    file = inertia_file()
    said = "Friction of 1 joint holds at speeds that were left out of the fit."
    assert said not in judge(collect([source("inertia.json", file)])).support
    file.stages.friction.joints["elbow"].held_out_rmse = 0.1
    assert said in judge(collect([source("inertia.json", file)])).support


def test_what_has_no_verdict_is_not_called_good() -> None:
    file, prediction = friction_file(), prediction_file()
    file.stages.friction.verdicts, prediction.verdicts = [], []
    found = collect([source("friction.json", file), source("prediction.json", prediction)])
    steps = pipeline(found, []).groups[0].tables[0].rows
    told = {row[0]: row[-1] for row in steps}
    for command in ("seqid friction", "seqid predict"):
        assert "not judged" in told[command]
