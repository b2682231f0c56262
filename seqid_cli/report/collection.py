"""The documents of one report, sorted: one robot, its models, their predictions and diagnoses."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from seqid_cli.errors import ConfigError
from seqid_cli.params.document import check_same_robot, join, present
from seqid_cli.params.io import D, Document, Result, Source
from seqid_cli.params.results.diagnosis import DiagnosisFile, ResidualEntry
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.results.prediction import FileId, PredictionFile
from seqid_cli.params.schema import ParameterFile, RobotId, Stages
from seqid_cli.report.words import command, short_path, unit_text

Kind = Literal["identified", "refined", "simultaneous"]
KINDS: tuple[Kind, ...] = ("refined", "identified", "simultaneous")
WRITTEN_BY: Mapping[type, str] = {
    PredictionFile: "predict",
    DiagnosisFile: "diagnose",
    PayloadFile: "payload",
    PlanFile: "plan",
}
_MOST_JOINTS = 200
Sources = Sequence[Source[Document]]
Parameters = Source[ParameterFile]
Prediction = Source[PredictionFile]


class Place(NamedTuple):
    """A joint, and the units of its torque and its position as they stand on the page."""

    joint: str
    unit: str
    length: str


@dataclass(frozen=True)
class Model:
    """Parameter files that belong to one model, joined.

    `identified` step by step, `refined` with effects in it, or `simultaneous` in one
    least squares.
    """

    kind: Kind
    sources: tuple[Parameters, ...]  # the one that holds most comes last
    file: ParameterFile

    @property
    def path(self) -> str:
        """The file that holds most of it."""
        return self.sources[-1].path

    @property
    def stages(self) -> Stages:
        """What was identified."""
        return self.file.stages


@dataclass(frozen=True)
class Collection:
    """The documents of the report; `models` holds the best first.

    `warnings` name files that fit, but not perfectly.
    """

    robot: RobotId
    sources: tuple[Source[Document], ...]
    models: tuple[Model, ...]
    predictions: tuple[Prediction, ...]
    diagnoses: tuple[Source[DiagnosisFile], ...]
    payloads: tuple[Source[PayloadFile], ...]
    plans: tuple[Source[PlanFile], ...]
    warnings: tuple[str, ...]

    @property
    def model(self) -> Model | None:
        """The model that the report shows, if a parameter file was given."""
        return self.models[0] if self.models else None

    def place(self, joint: str) -> Place:
        """Return a joint with its units."""
        return Place(
            joint, *(unit_text(self.robot.unit(unit, joint)) for unit in ("N m", "rad"))
        )

    def residual(self, prediction: Prediction, joint: str) -> ResidualEntry | None:
        """Return a joint's residual from a diagnosis of the prediction's own logs."""
        logs = {log.sha256 for log in prediction.content.logs}
        own = (
            d.content
            for d in self.diagnoses
            if {x.sha256 for x in d.content.inputs} == logs
        )
        return next((file.joints[joint] for file in own if joint in file.joints), None)

    def model_of(self, prediction: Prediction) -> Model | None:
        """Return the model that a prediction was made with, if its file was given."""
        used = {item.sha256 for item in prediction.content.parameters}
        known = (
            model for model in self.models if used & {s.sha256 for s in model.sources}
        )
        return next(known, None)

    def call(self, name: str, *logs: str, output: str = "") -> str:
        """Return a command line that takes the model shown on."""
        path = self.model.path if self.model else "inertia.json"
        files = ("-r", "robot.toml", "-p", path, *(("-o", output) if output else ()))
        return command("seqid", name, *(logs or ("LOG...",)), *files)

    @property
    def judged(self) -> tuple[Prediction, ...]:
        """The predictions of the model that the report shows; all if there is none of it."""
        own = [
            p
            for p in self.predictions
            if self.models and self.model_of(p) is self.model
        ]
        return tuple(own) or self.predictions

    def label(self, prediction: Prediction) -> str:
        """Return the file of a prediction's model, and which is before and after refinement."""
        paths = [item.path for item in prediction.content.parameters[-1:]] or [
            prediction.path
        ]
        kinds = [model.kind for p in self.predictions if (model := self.model_of(p))]
        model, name = self.model_of(prediction), short_path(paths[0])
        if sorted(kinds) != ["identified", "refined"] or model is None:
            return name
        return f"{'after' if model.kind == 'refined' else 'before'}: {name}"


def of_kind(
    documents: Iterable[Source[Document]], kind: type[D]
) -> tuple[Source[D], ...]:
    """Return the documents of one kind."""
    found = (item for item in documents if isinstance(item.content, kind))
    return tuple(found)  # type: ignore[arg-type]


def collect(documents: Sources) -> Collection:
    """Sort documents and make sure that they are about one robot and agree."""
    if not documents:
        raise ConfigError(
            "no file given", hint="Name the JSON files that the stages wrote."
        )
    unique = tuple({(item.path, item.sha256): item for item in documents}.values())
    first = (unique[0].path, unique[0].content.robot)
    for item in unique[1:]:
        check_same_robot(
            first, (item.path, item.content.robot), "Report on one robot at a time."
        )
    joints = first[1].joints
    if not 0 < len(joints) == len(set(joints)) <= _MOST_JOINTS:
        message = f"$.robot.joints: must name 1 to {_MOST_JOINTS} joints, each once"
        raise ConfigError(
            message, where=first[0], hint="Run the command again that wrote it."
        )
    found = Collection(
        robot=first[1],
        sources=unique,
        models=tuple(_models(of_kind(unique, ParameterFile))),
        predictions=of_kind(unique, PredictionFile),
        diagnoses=of_kind(unique, DiagnosisFile),
        payloads=of_kind(unique, PayloadFile),
        plans=of_kind(unique, PlanFile),
        warnings=tuple(_warnings(unique)),
    )
    ranks = {id(model): rank for rank, model in enumerate(found.models)}
    best = sorted(
        found.predictions, key=lambda p: ranks.get(id(found.model_of(p)), len(ranks))
    )
    return replace(found, predictions=tuple(best))


def models_of(content: Result) -> list[FileId]:
    """Return the parameter files that a result was made with."""
    return content.models if isinstance(content, PayloadFile) else content.parameters


def _warnings(documents: Sources) -> Iterator[str]:
    """Say what does not fit perfectly; refuse a result whose parameter file has changed since."""
    hashes: dict[str, str] = {}
    for item in documents:
        hashes.setdefault(item.content.robot.sha256, item.path)
    if len(hashes) > 1:
        yield (
            "the robot file changed between these results:"
            f" {', '.join(hashes.values())}"
        )
    given = {Path(s.path).resolve(): s for s in of_kind(documents, ParameterFile)}
    known = {item.sha256 for item in given.values()}
    made_with = [
        (item, used)
        for item in documents
        if not isinstance(item.content, ParameterFile)
        for used in models_of(item.content)
        if given and used.sha256 not in known
    ]
    for item, used in made_with:
        was, now = (
            f"{used.path} (sha256 {used.sha256[:12]})",
            given.get(Path(used.path).resolve()),
        )
        if now is not None:
            message = (
                f"was made with {used.path} as it was before (sha256"
                f" {used.sha256[:12]}); {now.path} has changed since (now"
                f" {now.sha256[:12]})"
            )
            again = f"Run seqid {WRITTEN_BY[type(item.content)]} again"
            raise ConfigError(
                message, where=item.path, hint=f"{again}, or leave {item.path} out."
            )
        yield f"{item.path} was made with {was}, which is not among the files given"


def kind_of(file: ParameterFile) -> Kind:
    """Return whether a file is refined, of one least squares, or identified step by step."""
    stages = file.stages
    if file.closed_loop is not None or stages.effects is not None:
        return "refined"
    methods = {
        stage.method for stage in (stages.friction, stages.inertia) if stage is not None
    }
    return "simultaneous" if "simultaneous" in methods else "identified"


def _models(files: Sequence[Parameters]) -> Iterator[Model]:
    """Join the files of each kind that agree on all their stages; the fullest comes last."""
    fullest = sorted(files, key=lambda item: -len(present(item.content.stages)))
    for kind in KINDS:
        branches: list[list[Parameters]] = []
        for given in [item for item in fullest if kind_of(item.content) == kind]:
            agreeing = (
                b for b in branches if all(_agree(given.content, x.content) for x in b)
            )
            if branch := next(agreeing, None):
                branch.insert(0, given)
            else:
                branches.append([given])
        for branch in branches:
            yield Model(
                kind,
                tuple(branch),
                join([(item.path, item.content) for item in branch]),
            )


def _agree(one: ParameterFile, other: ParameterFile) -> bool:
    mine, theirs = present(one.stages), present(other.stages)
    loops = [file.closed_loop for file in (one, other) if file.closed_loop is not None]
    same = all(mine[name] == theirs[name] for name in mine.keys() & theirs.keys())
    return same and all(loop == loops[0] for loop in loops)
