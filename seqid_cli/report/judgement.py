"""The verdict on a model: good or not, its grounds, and the missing results."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from seqid_cli.params.results.diagnosis import (
    UnexplainedPart,
    nothing_found,
    times_noise,
    values_at,
)
from seqid_cli.params.results.report import TITLES
from seqid_cli.params.schema import ClosedLoop, ParameterFile, Stages, Verdict
from seqid_cli.report.collection import Collection, Prediction, of_kind
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
# predictions with the logs that are new to the model
Tested = list[tuple[Prediction, list[str]]]


@dataclass(frozen=True)
class Point:
    """A fault or a gap, its place and its remedy."""

    weight: Weight
    text: str
    where: str = ""
    remedy: str = ""
    command: str = ""

    @property
    def said(self) -> str:
        """The text as a sentence; a name that leads it keeps its case."""
        first = self.text.partition(" ")[0]
        as_it_is = first.endswith(":") or not first.isalpha()
        return f"{self.text if as_it_is else self.text[:1].upper() + self.text[1:]}."


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


def judge(collection: Collection) -> Judgement:
    """Judge the model by all documents.

    Poor is what a prediction on independent logs, or without one a stage, calls poor.
    Good needs a prediction on logs that the model is not from; what is open besides is
    a reservation.
    """
    tested = [(p, new) for p in collection.judged if (new := _new_logs(collection, p))]
    points = [
        *_prediction_points(collection),
        *_model_points(collection, bool(tested)),
        *_diagnosis_points(collection),
        *(Point("open", warning) for warning in collection.warnings),
    ]
    points.sort(key=lambda point: point.weight != "poor")
    level: Level
    if any(point.weight == "poor" for point in points):
        level = "poor"
    elif not tested:
        level = "not_judged"
    else:
        level = "reservations" if points else "good"
    sentence = _sentence(level, collection, tested, points)
    return Judgement(
        level, sentence, tuple(_support(collection, tested)), tuple(points)
    )


def _new_logs(collection: Collection, prediction: Prediction) -> list[str]:
    """Return the logs that judge the model: not those it was identified from."""
    used, trained = {item.sha256 for item in prediction.content.parameters}, set()
    made_with = [
        x.content
        for x in of_kind(collection.sources, ParameterFile)
        if x.sha256 in used
    ]
    # Where its parameter files were not given, those of all models count.
    for file in made_with or [model.file for model in collection.models]:
        held_out = file.closed_loop.held_out if file.closed_loop is not None else []
        trained |= {log.sha256 for log in file.inputs} - {
            log.sha256 for log in held_out
        }
    counted = [log for log in prediction.content.logs if log.sha256 not in trained]
    errors = [error for log in counted for error in log.joints.values()]
    judged = any(error.relative_rmse is not None for error in errors)
    return [log.path for log in counted] if judged else []


def _errors(item: Prediction, new: list[str]) -> dict[str, float]:
    """Return each joint's relative error; on the new logs alone where others are among them."""
    logs = [log.joints for log in item.content.logs if log.path in new]
    found: dict[str, float] = {}
    for joints in (
        [item.content.joints] if len(logs) == len(item.content.logs) else logs
    ):
        for name, error in joints.items():
            if error.relative_rmse is not None:
                found[name] = max(found.get(name, 0.0), error.relative_rmse)
    return found


def _sentence(
    level: Level, collection: Collection, tested: Tested, points: list[Point]
) -> str:
    if level == "poor":
        poor = [point.text for point in points if point.weight == "poor"]
        rest = (
            f", and {plural(len(poor) - 1, 'more point')} below"
            if len(poor) > 1
            else ""
        )
        return f"Do not rely on this model yet: {poor[0]}{rest}."
    errors = [pair for item, new in tested for pair in _errors(item, new).items()]
    if not errors:
        return (
            "Nothing here shows how well the model predicts logs that it was not"
            " identified from."
        )
    name, share = max(errors, key=lambda pair: pair[1])
    logs = {path for _, new in tested for path in new}
    made = sorted(
        {file_name(p.path) for item, _ in tested for p in item.content.parameters}
    )
    several = len(collection.robot.joints) > 1
    said = (
        f"On {plural(len(logs), 'log')} that it was not identified from, the model of"
        f" {listed(made, 3)} predicts the torque of {'every' if several else 'the'}"
        f" joint to {percent(share)} or better"
    )
    said += f" (RMS error over RMS torque; the worst is {name})" if several else ""
    if level == "reservations":
        said += (
            f"; {plural(len(points), 'point')} below"
            f" {'is' if len(points) == 1 else 'are'} open"
        )
    return said + "."


def _prediction_points(collection: Collection) -> Iterator[Point]:
    diagnose = collection.call("diagnose")
    for item in collection.judged:
        file, new = item.content, _new_logs(collection, item)
        yield from _poor(file.verdicts, "the prediction", item.path, diagnose)
        if still := [n for n, error in file.joints.items() if not error.samples]:
            text = f"{listed(still)} never slides in these logs and is not judged"
            yield Point(
                "open", text, item.path, "Predict logs in which every joint moves."
            )
        for name, error in file.joints.items():
            entry = collection.residual(item, name)
            if entry is not None and (times := times_noise(entry, error.rmse)):
                text = f"{name}: the RMS error on the same logs is {times}"
                yield Point("open", text, item.path, command=diagnose)
        if not new:
            text = "the prediction is on logs that the model was identified from"
            yield Point("open", text, item.path, "Predict logs that no stage has read.")
        elif len(new) < len(file.logs):
            text = (
                f"{len(file.logs) - len(new)} of the {plural(len(file.logs), 'log')}"
                " predicted had been used to identify the model; the first line counts"
                " the others"
            )
            yield Point("open", text, item.path)
    if not collection.predictions:
        text = (
            "no prediction was given, so nothing tests the model on logs it has not"
            " seen"
        )
        call = collection.call("predict", output="prediction.json")
        yield Point("open", text, command=f"{call} --torques torques.parquet")


def _poor(
    verdicts: Iterable[Verdict], whole: str, path: str, call: str = ""
) -> Iterator[Point]:
    for verdict in verdicts:
        if not verdict.good:
            weight: Weight = "open" if verdict.level == "usable" else "poor"
            yield Point(
                weight,
                f"{verdict.joint or whole}: {verdict.reason}",
                path,
                command=call,
            )


def _model_points(collection: Collection, judged: bool) -> Iterator[Point]:
    """What is wrong with the model or missing of it; a good prediction makes faults open points."""
    model = collection.model
    if model is None:
        text = "no parameter file was given, so the model itself is not shown"
        yield Point("open", text, remedy="Name the parameter file as well.")
        return
    weight: Weight = "open" if judged else "poor"
    stages, path = model.stages, model.path
    if (loop := model.file.closed_loop) is not None:
        yield from _poor(loop.verdicts, "the refinement", path)
        yield from (Point(weight, text, path) for text in unconfirmed(loop))
        yield from (Point("open", text, path) for text in not_kept(loop))
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(stages, name)
        for verdict in stage.verdicts if stage else []:
            if not verdict.good:
                what = (
                    f"{name} of {verdict.joint}"
                    if verdict.joint
                    else f"the {name} stage"
                )
                usable = verdict.level == "usable"
                yield Point(
                    "open" if usable else weight, f"{what}: {verdict.reason}", path
                )
    for name, rigid in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        if rigid is not None and rigid.not_excited:
            text = f"not determined by the {name} logs: {listed(rigid.not_excited)}"
            yield Point("open", text, path, "Record motions that excite them.")
        if rigid is not None and rigid.missing_pairs:
            pairs = [" with ".join(pair) for pair in rigid.missing_pairs]
            text = f"joints that never moved together: {listed(pairs)}"
            yield Point("open", text, path, "Record these pairs, two joints at a time.")
    for name in ("friction", "gravity", "inertia"):
        needed = name != "gravity" or model.kind == "identified"
        if needed and getattr(stages, name) is None:
            yield Point(
                "open", f"the model has no {name} stage", path, command=f"seqid {name}"
            )
    known = stages.friction.joints if stages.friction else collection.robot.joints
    if without := [name for name in collection.robot.joints if name not in known]:
        text = f"no friction is known of {listed(without)}"
        yield Point("open", text, path, command="seqid friction")


def unconfirmed(loop: ClosedLoop) -> list[str]:
    """Return, in words, what the model has unconfirmed by held-out logs: a sentence or none."""
    names = [effect_at(item.effect, item.joint) for item in loop.doubtful]
    return [f"the held-out logs do not confirm {listed(names)}"] if names else []


def not_kept(loop: ClosedLoop) -> list[str]:
    """Return, in words, what a refinement has left out of its model: a sentence for each cause."""
    said = []
    if loop.unconfirmed:
        names = [effect_at(item.effect, item.joint) for item in loop.unconfirmed]
        said.append(
            f"not kept, as the held-out logs do not confirm it: {listed(names)}"
        )
    if loop.stopped_at is not None:
        names = [effect_at(item.effect, item.joint) for item in loop.stopped_at.untried]
        limit = f"the limit of rounds ({loop.stopped_at.rounds})"
        said.append(f"the refinement stopped at {limit}; not tried: {listed(names)}")
    return said


def _diagnosis_points(collection: Collection) -> Iterator[Point]:
    known = known_effects(collection)
    refine = collection.call(
        "refine", "LOG...", "--holdout", "LOG...", output="refined.json"
    )
    for item in collection.diagnoses:
        file = item.content
        yield from _poor(file.verdicts, "the diagnosis", item.path)
        for finding in file.findings:
            if (finding.effect, finding.joint) not in known:
                text = (
                    f"the model lacks {effect_at(finding.effect, finding.joint)}"
                    f" (confidence {percent(finding.confidence, 0)}, explains"
                    f" {percent(finding.explains, 0)} of the residual above the noise)"
                )
                yield Point("open", text, item.path, command=refine)
        silent = file.verdict in ("too_short", "nothing_seen")
        if silent or (file.verdict == "nothing_missing" and file.leaves_more):
            yield Point("open", nothing_found(file), item.path)
        for one in file.changed:
            yield Point(
                "open", f"the file's values do not hold: {values_at(one)}", item.path
            )
        for part in file.unexplained:
            yield Point(
                "open", f"{unexplained(part)}, but fits no known effect", item.path
            )


def unexplained(part: UnexplainedPart) -> str:
    """Return how much of the residual is not explained, and what it depends on."""
    on = (
        listed([name.replace("_", " ") for name in part.depends_on])
        or "nothing that was logged"
    )
    return (
        f"{part.joint}: {percent(part.share, 0)} of the residual above the noise"
        f" depends on {on}"
    )


def known_effects(collection: Collection) -> frozenset[tuple[str, str | None]]:
    """Return the effects that a refined model holds, with their joints."""
    added = [
        effect for model in collection.models for effect in model.stages.effects or []
    ]
    return frozenset((effect.effect, effect.joint) for effect in added)


def _support(collection: Collection, tested: Tested) -> Iterator[str]:
    for item, new in tested:
        shares = _errors(item, new).values()
        if shares:
            logs = plural(len(new), "new log")
            span = f"{percent(min(shares))} to {percent(max(shares))}"
            yield (
                f"Torque predicted on {logs} with an RMS error of {span} of the RMS"
                " torque."
            )
    stages = collection.model.stages if collection.model else Stages()
    if stages.friction is not None and all(v.good for v in stages.friction.verdicts):
        held_out = [
            x for x in stages.friction.joints.values() if x.held_out_rmse is not None
        ]
        if held_out:
            count = plural(len(held_out), "joint")
            yield f"Friction of {count} holds at speeds that were left out of the fit."
    for name, stage in (("Gravity", stages.gravity), ("Inertia", stages.inertia)):
        if stage is not None and stage.parameters and not stage.not_excited:
            yield (
                f"{name}: all {plural(len(stage.parameters), 'parameter')} of the stage"
                f" determined by the logs (condition {number(stage.condition)})."
            )
    for diagnosis in collection.diagnoses:
        file, path = diagnosis.content, short_path(diagnosis.path)
        if file.verdict == "nothing_missing" and not file.leaves_more:
            logs = plural(len(file.inputs), "log")
            yield (
                f"What {logs} leave of the torque is noise: nothing is missing"
                f" ({path})."
            )
    loops = [
        loop
        for model in collection.models
        if (loop := model.file.closed_loop) is not None
    ]
    for loop in [loop for loop in loops if loop.rounds and loop.verdict != "poor"]:
        added = listed([effect_at(item.effect, item.joint) for item in loop.rounds])
        gains = [
            (limits[0], joint) for joint, limits in loop.gain_interval.items() if limits
        ]
        gain, joint = max(gains, default=(0.0, ""))
        proof = f"; on held-out logs the error variance of {joint} falls by at least "
        proof = f"{proof}{percent(gain, 0)} (95 %)" if gain > 0.0 else ""
        yield f"Refinement added {added}{proof}."
