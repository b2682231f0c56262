"""The verdict on a model: good or not, its grounds, and the missing results."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from seqid_cli.params.results.diagnosis import (
    DiagnosisFile,
    UnexplainedPart,
    nothing_found,
    times_noise,
    values_at,
)
from seqid_cli.params.results.prediction import JointError
from seqid_cli.params.results.report import TITLES
from seqid_cli.params.schema import ClosedLoop, ParameterFile, Stages, Verdict
from seqid_cli.report.collection import Collection, Model, Prediction, of_kind
from seqid_cli.report.words import (
    effect_at,
    file_name,
    listed,
    number,
    percent,
    plural,
    short_path,
)

Level = Literal["good", "reservations", "poor", "not_judged"]
Weight = Literal["poor", "open"]


@dataclass(frozen=True, kw_only=True)
class Point:
    """A fault or a gap, its place and its remedy.

    Parameters
    ----------
    weight : {"poor", "open"}
    text : str
    where : str
        Path of the file that it is about.
    remedy : str
        In words.
    command : str
        The command that may help.
    """

    weight: Weight
    text: str
    where: str = ""
    remedy: str = ""
    command: str = ""

    @property
    def said(self) -> str:
        """The text as a sentence; a name that leads it keeps its case."""
        first_word = self.text.partition(" ")[0]
        is_name = first_word.endswith(":") or not first_word.isalpha()
        if is_name:
            return f"{self.text}."
        return f"{self.text[:1].upper()}{self.text[1:]}."


@dataclass(frozen=True)
class Judgement:
    """The verdict: its level, one sentence, the points for and against the model."""

    level: Level
    sentence: str
    support: tuple[str, ...]
    points: tuple[Point, ...]

    @property
    def title(self) -> str:
        """The verdict in a word or three."""
        return TITLES[self.level]


class IndependentPrediction(NamedTuple):
    """A prediction and the paths of its logs that are new to the model."""

    prediction: Prediction
    new_logs: list[str]


def judge(collection: Collection) -> Judgement:
    """Judge the model by all documents.

    Poor is what a prediction on independent logs, or without one a stage, calls poor.
    Good needs a prediction on logs that the model is not from; what is open besides is
    a reservation.
    """
    tested = []
    for prediction in collection.judged:
        new_logs = _new_logs(collection, prediction)
        if new_logs:
            tested.append(IndependentPrediction(prediction, new_logs))

    points = [
        *_prediction_points(collection),
        *_model_points(collection, is_tested=bool(tested)),
        *_diagnosis_points(collection),
        *(Point(weight="open", text=warning) for warning in collection.warnings),
    ]
    points.sort(key=lambda point: point.weight != "poor")

    level: Level = "good"
    if any(point.weight == "poor" for point in points):
        level = "poor"
    elif not tested:
        level = "not_judged"
    elif points:
        level = "reservations"
    return Judgement(
        level,
        _sentence(level, collection, tested, points),
        tuple(_support(collection, tested)),
        tuple(points),
    )


def judge_results(collection: Collection) -> Judgement:
    """Judge results by their own verdicts, where no model is given."""
    verdicts = [(x.path, x.content.verdicts) for x in collection.drives]
    verdicts += [(x.path, x.content.verdicts) for x in collection.replays]
    verdicts += [(x.path, x.content.verdicts) for x in collection.payloads]
    verdicts += [(x.path, x.content.verdicts) for x in collection.plans]
    points = []
    for path, of_file in verdicts:
        for verdict in of_file:
            if verdict.good:
                continue
            point = Point(
                weight="poor" if verdict.level == "poor" else "open",
                text=f"{verdict.joint}: {verdict.reason}".removeprefix(": "),
                where=path,
            )
            points.append(point)
    points += [Point(weight="open", text=warning) for warning in collection.warnings]
    points.sort(key=lambda point: point.weight != "poor")

    level: Level = "good"
    sentence = "Nothing in these files speaks against their use."
    if points:
        level = "poor" if points[0].weight == "poor" else "reservations"
        sentence = points[0].said
    return Judgement(level, sentence, (), tuple(points))


def _new_logs(collection: Collection, prediction: Prediction) -> list[str]:
    """Return the logs that judge the model: not those it was identified from."""
    used = {item.sha256 for item in prediction.content.parameters}
    made_with = [
        source.content
        for source in of_kind(collection.sources, ParameterFile)
        if source.sha256 in used
    ]
    # Where its parameter files were not given, those of all models count.
    if not made_with:
        made_with = [model.file for model in collection.models]

    training = set()
    for file in made_with:
        held_out = file.closed_loop.held_out if file.closed_loop is not None else []
        held_out_hashes = {log.sha256 for log in held_out}
        training |= {log.sha256 for log in file.inputs} - held_out_hashes
    new_logs = [log for log in prediction.content.logs if log.sha256 not in training]

    # Logs in which no joint slides judge nothing.
    errors: list[JointError] = []
    for log in new_logs:
        errors += log.joints.values()
    if all(error.relative_rmse is None for error in errors):
        return []
    return [log.path for log in new_logs]


def _relative_errors(tested: IndependentPrediction) -> dict[str, float]:
    """Return each joint's RMS error over its RMS torque.

    Where some logs are not new to the model, it is the largest of the new ones.
    """
    file = tested.prediction.content
    new_logs = [log for log in file.logs if log.path in tested.new_logs]
    joints_of_logs = [log.joints for log in new_logs]
    if len(new_logs) == len(file.logs):
        joints_of_logs = [file.joints]

    largest: dict[str, float] = {}
    for joints in joints_of_logs:
        for name, error in joints.items():
            if error.relative_rmse is not None:
                largest[name] = max(largest.get(name, 0.0), error.relative_rmse)
    return largest


def _sentence(
    level: Level,
    collection: Collection,
    tested: Sequence[IndependentPrediction],
    points: Sequence[Point],
) -> str:
    """Return the verdict as one sentence."""
    if level == "poor":
        poor = [point.text for point in points if point.weight == "poor"]
        further = ""
        if len(poor) > 1:
            further = f", and {plural(len(poor) - 1, 'more point')} below"
        return f"Do not rely on this model yet: {poor[0]}{further}."

    errors: list[tuple[str, float]] = []
    for item in tested:
        errors += _relative_errors(item).items()
    if not errors:
        return (
            "Nothing here shows how well the model predicts logs that it was not"
            " identified from."
        )
    worst_joint, largest_error = max(errors, key=lambda pair: pair[1])

    logs: set[str] = set()
    files: set[str] = set()
    for item in tested:
        logs.update(item.new_logs)
        parameters = item.prediction.content.parameters
        files.update(file_name(used.path) for used in parameters)
    has_several_joints = len(collection.robot.joints) > 1
    sentence = (
        f"On {plural(len(logs), 'log')} that it was not identified from, the model of"
        f" {listed(sorted(files), 3)} predicts the torque of"
        f" {'every' if has_several_joints else 'the'} joint to"
        f" {percent(largest_error)} or better"
    )
    if has_several_joints:
        sentence += f" (RMS error over RMS torque; the worst is {worst_joint})"
    if level == "reservations":
        verb = "is" if len(points) == 1 else "are"
        sentence += f"; {plural(len(points), 'point')} below {verb} open"
    return f"{sentence}."


def _prediction_points(collection: Collection) -> Iterator[Point]:
    """Return the points of predictions: verdicts, noise, and logs that are not new."""
    diagnose = collection.call("diagnose")
    for prediction in collection.judged:
        file = prediction.content
        path = prediction.path
        yield from _verdict_points(file.verdicts, "the prediction", path, diagnose)

        still = [name for name, error in file.joints.items() if not error.samples]
        if still:
            yield Point(
                weight="open",
                text=f"{listed(still)} never slides in these logs and is not judged",
                where=path,
                remedy="Predict logs in which every joint moves.",
            )
        for name, error in file.joints.items():
            residual = collection.residual(prediction, name)
            if residual is None:
                continue
            above_noise = times_noise(residual, error.rmse)
            if above_noise:
                yield Point(
                    weight="open",
                    text=f"{name}: the RMS error on the same logs is {above_noise}",
                    where=path,
                    command=diagnose,
                )
        yield from _old_log_points(collection, prediction)

    if not collection.predictions:
        call = collection.call("predict", output="prediction.json")
        yield Point(
            weight="open",
            text=(
                "no prediction was given, so nothing tests the model on logs it has"
                " not seen"
            ),
            command=f"{call} --torques torques.parquet",
        )


def _old_log_points(collection: Collection, prediction: Prediction) -> Iterator[Point]:
    """Return a point where a model is judged by logs that it was identified from."""
    n_logs = len(prediction.content.logs)
    n_new = len(_new_logs(collection, prediction))
    if n_new == 0:
        yield Point(
            weight="open",
            text="the prediction is on logs that the model was identified from",
            where=prediction.path,
            remedy="Predict logs that no stage has read.",
        )
    elif n_new < n_logs:
        yield Point(
            weight="open",
            text=(
                f"{n_logs - n_new} of the {plural(n_logs, 'log')} predicted had been"
                " used to identify the model; the first line counts the others"
            ),
            where=prediction.path,
        )


def _verdict_points(
    verdicts: Iterable[Verdict], subject: str, path: str, command: str = ""
) -> Iterator[Point]:
    """Return the points of verdicts that are not good.

    `subject` is what a verdict without a joint is on.
    """
    for verdict in verdicts:
        if verdict.good:
            continue
        yield Point(
            weight="open" if verdict.level == "usable" else "poor",
            text=f"{verdict.joint or subject}: {verdict.reason}",
            where=path,
            command=command,
        )


def _model_points(collection: Collection, *, is_tested: bool) -> Iterator[Point]:
    """Return what is wrong with the model or missing of it.

    A prediction on independent logs makes faults open points.
    """
    model = collection.model
    if model is None:
        yield Point(
            weight="open",
            text="no parameter file was given, so the model itself is not shown",
            remedy="Name the parameter file as well.",
        )
        return
    weight: Weight = "open" if is_tested else "poor"
    yield from _refinement_points(model, weight)
    yield from _stage_points(model, weight)
    yield from _excitation_points(model)
    yield from _missing_stage_points(collection, model)


def _refinement_points(model: Model, weight: Weight) -> Iterator[Point]:
    """Return the points of a refinement."""
    loop = model.file.closed_loop
    if loop is None:
        return
    yield from _verdict_points(loop.verdicts, "the refinement", model.path)
    for text in unconfirmed(loop):
        yield Point(weight=weight, text=text, where=model.path)
    for text in not_kept(loop):
        yield Point(weight="open", text=text, where=model.path)


def _stage_points(model: Model, weight: Weight) -> Iterator[Point]:
    """Return the points of stages whose verdicts are not good."""
    stages = model.stages
    by_name = {
        "friction": stages.friction,
        "gravity": stages.gravity,
        "imu": stages.imu,
        "inertia": stages.inertia,
    }
    for name, stage in by_name.items():
        for verdict in stage.verdicts if stage else []:
            if verdict.good:
                continue
            subject = f"the {name} stage"
            if verdict.joint:
                subject = f"{name} of {verdict.joint}"
            yield Point(
                weight="open" if verdict.level == "usable" else weight,
                text=f"{subject}: {verdict.reason}",
                where=model.path,
            )


def _excitation_points(model: Model) -> Iterator[Point]:
    """Return what the logs of gravity and inertia did not excite."""
    by_name = {"gravity": model.stages.gravity, "inertia": model.stages.inertia}
    for name, stage in by_name.items():
        if stage is None:
            continue
        if stage.not_excited:
            yield Point(
                weight="open",
                text=f"not determined by the {name} logs: {listed(stage.not_excited)}",
                where=model.path,
                remedy="Record motions that excite them.",
            )
        if stage.missing_pairs:
            pairs = [" with ".join(pair) for pair in stage.missing_pairs]
            yield Point(
                weight="open",
                text=(
                    "what is open shows where these joints move together, fast and over"
                    f" wide positions: {listed(pairs)}"
                ),
                where=model.path,
                remedy=(
                    "Record these pairs, two joints at a time; the postures that the"
                    " logs lack come from seqid plan inertia."
                ),
            )


def _missing_stage_points(collection: Collection, model: Model) -> Iterator[Point]:
    """Return the stages that a model lacks, and joints of unknown friction."""
    stages = model.stages
    missing = []
    if stages.friction is None:
        missing.append("friction")
    # One least squares, and a refinement of it, has gravity among its inertia.
    if stages.gravity is None and model.kind == "identified":
        missing.append("gravity")
    if stages.inertia is None:
        missing.append("inertia")
    for name in missing:
        yield Point(
            weight="open",
            text=f"the model has no {name} stage",
            where=model.path,
            command=f"seqid {name}",
        )

    if stages.friction is None:
        return
    without_friction = [
        name for name in collection.robot.joints if name not in stages.friction.joints
    ]
    if without_friction:
        yield Point(
            weight="open",
            text=f"no friction is known of {listed(without_friction)}",
            where=model.path,
            command="seqid friction",
        )


def unconfirmed(loop: ClosedLoop) -> list[str]:
    """Return, in words, what held-out logs do not confirm: a sentence or none."""
    names = [effect_at(item.effect, item.joint) for item in loop.doubtful]
    return [f"the held-out logs do not confirm {listed(names)}"] if names else []


def not_kept(loop: ClosedLoop) -> list[str]:
    """Return, in words, what a refinement left out: a sentence for each cause."""
    sentences = []
    if loop.unconfirmed:
        names = [effect_at(item.effect, item.joint) for item in loop.unconfirmed]
        sentences.append(
            f"not kept, as the held-out logs do not confirm it: {listed(names)}"
        )
    if loop.stopped_at is not None:
        names = [effect_at(item.effect, item.joint) for item in loop.stopped_at.untried]
        limit = f"the limit of rounds ({loop.stopped_at.rounds})"
        sentences.append(
            f"the refinement stopped at {limit}; not tried: {listed(names)}"
        )
    return sentences


def _diagnosis_points(collection: Collection) -> Iterator[Point]:
    """Return what diagnoses found that the model does not hold."""
    effects_of_model = known_effects(collection)
    refine = collection.call(
        "refine", "LOG...", "--holdout", "LOG...", output="refined.json"
    )
    for diagnosis in collection.diagnoses:
        file = diagnosis.content
        path = diagnosis.path
        yield from _verdict_points(file.verdicts, "the diagnosis", path)

        # A refined model may hold the effect already.
        for finding in file.findings:
            if (finding.effect, finding.joint) in effects_of_model:
                continue
            yield Point(
                weight="open",
                text=(
                    f"the model lacks {effect_at(finding.effect, finding.joint)}"
                    f" (confidence {percent(finding.confidence, 0)}, explains"
                    f" {percent(finding.explains, 0)} of the residual above the noise)"
                ),
                where=path,
                command=refine,
            )

        for text in _texts_without_effect(file):
            yield Point(weight="open", text=text, where=path)


def _texts_without_effect(file: DiagnosisFile) -> list[str]:
    """Return what a diagnosis says that no effect of the catalogue explains."""
    texts = []
    saw_little = file.verdict in ("too_short", "nothing_seen")
    if saw_little or (file.verdict == "nothing_missing" and file.leaves_more):
        texts.append(nothing_found(file))
    texts += [
        f"the file's values do not hold: {values_at(changed)}"
        for changed in file.changed
    ]
    texts += [
        f"{unexplained(part)}, but fits no known effect" for part in file.unexplained
    ]
    return texts


def unexplained(part: UnexplainedPart) -> str:
    """Return how much of the residual is not explained, and what it depends on."""
    quantities = listed([name.replace("_", " ") for name in part.depends_on])
    return (
        f"{part.joint}: {percent(part.share, 0)} of the residual above the noise"
        f" depends on {quantities or 'nothing that was logged'}"
    )


def known_effects(collection: Collection) -> frozenset[tuple[str, str | None]]:
    """Return the effects that a refined model holds, with their joints."""
    effects = set()
    for model in collection.models:
        for item in model.stages.effects or []:
            effects.add((item.effect, item.joint))
    return frozenset(effects)


def _support(
    collection: Collection, tested: Sequence[IndependentPrediction]
) -> Iterator[str]:
    """Return what speaks for the model, a sentence each."""
    for item in tested:
        shares = _relative_errors(item).values()
        if shares:
            span = f"{percent(min(shares))} to {percent(max(shares))}"
            yield (
                f"Torque predicted on {plural(len(item.new_logs), 'new log')} with an"
                f" RMS error of {span} of the RMS torque."
            )
    stages = collection.model.stages if collection.model else Stages()
    yield from _support_of_stages(stages)

    for diagnosis in collection.diagnoses:
        file = diagnosis.content
        if file.verdict == "nothing_missing" and not file.leaves_more:
            yield (
                f"What {plural(len(file.inputs), 'log')} leave of the torque is noise:"
                f" nothing is missing ({short_path(diagnosis.path)})."
            )
    for model in collection.models:
        loop = model.file.closed_loop
        if loop is not None and loop.rounds and loop.verdict != "poor":
            yield _support_of_refinement(loop)


def _support_of_stages(stages: Stages) -> Iterator[str]:
    """Return what speaks for friction, gravity and inertia."""
    friction = stages.friction
    if friction is not None and all(verdict.good for verdict in friction.verdicts):
        n_held_out = sum(
            joint.held_out_rmse is not None for joint in friction.joints.values()
        )
        if n_held_out:
            yield (
                f"Friction of {plural(n_held_out, 'joint')} holds at speeds that were"
                " left out of the fit."
            )
    for name, stage in (("Gravity", stages.gravity), ("Inertia", stages.inertia)):
        if stage is not None and stage.parameters and not stage.not_excited:
            yield (
                f"{name}: all {plural(len(stage.parameters), 'parameter')} of the stage"
                f" determined by the logs (condition {number(stage.condition)})."
            )


def _support_of_refinement(loop: ClosedLoop) -> str:
    """Return what a refinement added, and the gain of the joint that gains most."""
    added = listed([effect_at(item.effect, item.joint) for item in loop.rounds])
    gains = [
        (limits[0], joint) for joint, limits in loop.gain_interval.items() if limits
    ]
    least_gain, joint = max(gains, default=(0.0, ""))
    if not least_gain > 0.0:
        return f"Refinement added {added}."
    return (
        f"Refinement added {added}; on held-out logs the error variance of {joint}"
        f" falls by at least {percent(least_gain, 0)} (95 %)."
    )
