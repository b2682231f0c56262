"""Files of a report that belong together, refused ones, and the verdict on a model."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from seqid_cli.errors import ConfigError, SeqidError
from seqid_cli.params.check import check_consistency
from seqid_cli.params.io import Document, Source, read_any
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.prediction import FileId, PredictionFile
from seqid_cli.params.schema import EffectOfPlace, ParameterFile, StoppedAt, Verdict
from seqid_cli.report.collection import collect
from seqid_cli.report.judgement import Judgement, judge
from seqid_cli.report.sections.diagnosis import closed_loop
from tests.transcripts import check_text
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
    before_and_after,
    clean_diagnosis,
    good_documents,
    made_with,
    payload_file,
    prediction_file,
    source,
)


def test_stages_of_one_branch_join_and_the_refined_model_leads() -> None:
    documents = [source("friction.json", friction_file()), *all_documents()]
    collection = collect([*documents, *documents])
    assert len(collection.sources) == len(documents)  # each counts once
    assert [model.kind for model in collection.models] == ["refined", "identified"]
    assert collection.models[1].path == "inertia.json"
    assert collection.models[1].sources[0].path == "friction.json"
    assert [item.path for item in collection.predictions] == ["prediction.json"]
    assert [item.path for item in collection.diagnoses] == ["diagnosis.json"]


def test_other_joints_are_another_robot() -> None:
    diagnosis = diagnosis_file()
    diagnosis.robot.joints = ["elbow", "shoulder"]
    with pytest.raises(ConfigError, match=r"other\.json.*elbow, shoulder"):
        collect([*good_documents(), source("other.json", diagnosis)])


def test_files_that_disagree_are_models_of_their_own() -> None:
    files = {
        "inertia": inertia_file(),
        "other": gravity_file(),
        "friction": friction_file(),
        "refined": full_file(),
        "again": full_file(),
    }
    for name in ("other", "friction", "refined"):
        files[name].stages.friction.joints["elbow"].rmse = 0.7
    files["again"].closed_loop.after["elbow"].rmse = 0.15

    models = collect([source(path, file) for path, file in files.items()]).models
    paths = [" ".join(item.path for item in model.sources) for model in models]
    assert paths == ["refined", "again", "inertia", "friction other"]


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ('{"schema": "other/params@1"}', "is no result"),
        ('{"schema": "seqid/diagnosis@9"}', "seqid/diagnosis@9"),
        ('{"schema": "seqid/prediction@1", "created": 5}', "created"),
        ('{"schema": "seqid/params@1"}', "created"),
        (
            '{"schema": "seqid/prediction@1", "created": "' + "[" * 9000,
            "is not valid JSON",
        ),
    ],
)
def test_what_is_no_result_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(SeqidError) as caught:
        read_any([path])
    assert message in caught.value.message
    assert caught.value.where == str(path)
    assert caught.value.hint


def test_a_reference_to_another_file_does_not_count_as_stale() -> None:
    parameters, _ = good_documents()
    moved = prediction_file()
    moved.parameters = [FileId(path="moved/inertia.json", sha256=parameters.sha256)]
    assert collect([parameters, source("prediction.json", moved)]).warnings == ()


def test_a_payload_of_an_older_model_is_refused() -> None:
    parameters, _ = good_documents()
    used = FileId(path=parameters.path, sha256="1" * 64)
    with pytest.raises(ConfigError, match="has changed since") as caught:
        collect([parameters, source("payload.json", payload_file(used))])
    assert "seqid payload" in (caught.value.hint or "")


Documents = list[Source[Document]]
FRICTION = Verdict(joint="shoulder", good=False, reason="2 speeds")


def of(
    file: ParameterFile | None = None,
    prediction: PredictionFile | None = None,
    diagnosis: DiagnosisFile | None = None,
) -> Documents:
    """Documents of one model, the good ones where nothing else is given."""
    parameters = source("inertia.json", file or inertia_file())
    prediction = made_with(prediction or prediction_file(), parameters)
    documents = [parameters, source("prediction.json", prediction)]
    if diagnosis is not None:
        documents.append(source("diagnosis.json", diagnosis))
    return documents


def of_training_logs() -> Iterator[tuple[str, Documents]]:
    """The model was identified from all of the logs, or from one of them, on which it
    is better.
    """
    file = inertia_file()
    prediction = prediction_file()
    file.inputs += [log("training", "inertia")]
    for item in prediction.logs:
        item.sha256 = file.inputs[-1].sha256
    yield "a prediction of the training logs", of(file, prediction)

    mixed = prediction_file()
    flattered = prediction_file(shares=(0.001, 0.001))
    mixed.joints = flattered.joints
    mixed.logs[0].joints = flattered.joints
    mixed.logs[0].sha256 = file.inputs[-1].sha256
    yield "a training log among new ones", of(file, mixed)


def of_refinement() -> Iterator[tuple[str, Documents]]:
    """Logs of refinement are new to the model before it, and so are held-out ones."""
    refined = full_file()
    parameters, good_prediction = good_documents()
    read = log("refined from", "effects")
    refined.inputs.append(read)
    prediction = prediction_file()
    prediction.logs[0].sha256 = read.sha256

    model = source("refined.json", refined)
    earlier = source(good_prediction.path, made_with(replace(prediction), parameters))
    yield "a log that refinement read, before it", [parameters, earlier, model]
    later = source("after.json", made_with(replace(prediction), model))
    yield "after it", [model, later]

    loop_with_held_out = replace(refined.closed_loop, held_out=[read])
    model = source("refined.json", replace(refined, closed_loop=loop_with_held_out))
    later = source("after.json", made_with(replace(prediction), model))
    yield "held out", [model, later]
    yield "models before, which is poor, and after", before_and_after()

    loop = refined.closed_loop
    doubtful = replace(
        loop, verdict="poor", rounds=[replace(loop.rounds[0], confirmed=False)]
    )
    stuck = Verdict(joint="elbow", good=False, reason="is stuck")
    faulty = replace(loop, verdict="poor", verdicts=[stuck])
    refused = replace(
        loop.rounds[0], confirmed=False, held_out_gain=0.02, interval=[-0.3, 0.34]
    )
    untried = [EffectOfPlace(effect="presliding_hysteresis", joint="shoulder")]
    stopped = StoppedAt(rounds=1, untried=untried)
    unkept = replace(loop, rounds=[], unconfirmed=[refused], stopped_at=stopped)

    outcomes = {"not confirmed": doubtful, "of faulty logs": faulty, "not kept": unkept}
    for name, outcome in outcomes.items():
        model = source("refined.json", replace(refined, closed_loop=outcome))
        tested = source("prediction.json", made_with(prediction_file(), model))
        yield f"a refinement {name}", [model]
        yield f"a refinement {name}, and a good prediction", [model, tested]


def of_diagnoses() -> Iterator[tuple[str, Documents]]:
    diagnosed = of(diagnosis=diagnosis_file())
    yield "a diagnosis", diagnosed
    yield (
        "a diagnosis, and the refined model",
        [*diagnosed, source("refined.json", full_file())],
    )
    poor = prediction_file(shares=(0.02, 0.5))
    yield "a poor prediction, and a diagnosis", of(None, poor, diagnosis_file())
    yield "nothing is missing", of(diagnosis=clean_diagnosis())

    for rmse, white in ((0.2, True), (0.12, False)):
        file = clean_diagnosis()
        file.joints["elbow"].rmse = rmse
        file.joints["elbow"].white = white
        yield f"no effect, {rmse} N m left, white: {white}", of(diagnosis=file)

    # The prediction's error is 0.1 N m.
    for most in (0.03, 0.11):
        file = clean_diagnosis()
        prediction = prediction_file()
        elbow = file.joints["elbow"]
        elbow.rmse = most
        elbow.noise_floor = 0.02
        elbow.noise_floor_interval = [0.01, most]
        file.inputs = [
            replace(log(x.path, ""), sha256=x.sha256) for x in prediction.logs
        ]
        yield f"noise up to {most} N m on the same logs", of(None, prediction, file)
        fewer = replace(file, inputs=file.inputs[1:])
        yield f"noise up to {most} N m on other logs", of(None, prediction, fewer)


def cases() -> Iterator[tuple[str, Documents]]:
    yield "good", good_documents()
    yield "parameters alone", good_documents()[:1]
    elsewhere = source("prediction.json", prediction_file())
    yield "parameters that lie elsewhere", [good_documents()[0], elsewhere]
    changed = good_documents()
    changed[1].content.robot.sha256 = "1" * 64
    yield "a changed robot file", changed
    yield from of_training_logs()

    poor = inertia_file()
    poor.stages.friction.verdicts[0] = FRICTION
    yield "a poor stage", of(poor)[:1]
    yield "a poor stage, and a good prediction", of(poor)

    dark = inertia_file()
    dark.stages.inertia.not_excited = ["Iyy_2"]
    dark.stages.inertia.missing_pairs = [["shoulder", "elbow"]]
    yield "a parameter that no log excites", of(dark)

    tested = inertia_file()
    tested.stages.friction.joints["elbow"].held_out_rmse = 0.1
    yield "friction tested at speeds left out", of(tested)[:1]
    yield from of_diagnoses()
    yield from of_refinement()


def described(judgement: Judgement) -> str:
    points = [
        f"- {point.weight}:"
        f" {' | '.join(filter(None, (point.text, point.where, point.remedy)))}"
        + (f"\n    {point.command}" if point.command else "")
        for point in judgement.points
    ]
    support = [f"+ {line}" for line in judgement.support]
    return "\n".join(
        [f"{judgement.title}. {judgement.sentence}", *points, *support, ""]
    )


def test_every_case_is_judged_as_it_was() -> None:
    """Lines that speak for the good model are not repeated for the others."""
    texts = {}
    for name, documents in cases():
        texts[name] = described(judge(collect(documents))).splitlines()
    usual = {line for line in texts["good"] if line.startswith("+")}
    for name in texts.keys() - {"good"}:
        texts[name] = [line for line in texts[name] if line not in usual]
    paragraphs = ["\n".join([f"# {name}", *lines, ""]) for name, lines in texts.items()]
    check_text(Path(__file__).with_name("judgement.txt"), "\n".join(paragraphs))


def test_what_is_poor_of_a_refinement_leads_its_section() -> None:
    leads = {}
    for name, documents in of_refinement():
        if name.startswith("a refinement") and len(documents) == 1:
            (group,) = closed_loop(collect(documents)).groups
            leads[name] = (group.title, group.lead)

    added = "Added: stribeck at elbow"
    doubt = "the held-out logs do not confirm stribeck at elbow"
    assert leads == {
        "a refinement not confirmed": (added, doubt),
        "a refinement of faulty logs": (added, "elbow: is stuck"),
        "a refinement not kept": (
            "Nothing was added: the held-out logs confirm nothing",
            (
                "not kept, as the held-out logs do not confirm it: stribeck at elbow;"
                " the refinement stopped at the limit of rounds (1); not tried:"
                " presliding hysteresis at shoulder"
            ),
        ),
    }
