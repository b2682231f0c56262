"""The documents of one report: one robot, its models, predictions and diagnoses."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, NoReturn

from seqid_cli.errors import ConfigError
from seqid_cli.params.document import check_same_robot, join, present
from seqid_cli.params.io import D, Document, Result, Source
from seqid_cli.params.results.diagnosis import DiagnosisFile, ResidualEntry
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.results.prediction import FileId, PredictionFile
from seqid_cli.params.results.replay import ReplayFile
from seqid_cli.params.schema import ParameterFile, RobotId, Stages
from seqid_cli.report.words import command, short_path, unit_text

Kind = Literal["identified", "refined", "simultaneous"]
KINDS: tuple[Kind, ...] = ("refined", "identified", "simultaneous")
WRITTEN_BY: Mapping[type, str] = {
    PredictionFile: "predict",
    DiagnosisFile: "diagnose",
    PayloadFile: "payload",
    PlanFile: "plan",
    DriveFile: "drive",
    ReplayFile: "replay",
}
_MOST_JOINTS = 200
Sources = Sequence[Source[Document]]
Parameters = Source[ParameterFile]
Prediction = Source[PredictionFile]


class Place(NamedTuple):
    """A joint, and the units of its torque and its position as on the page."""

    joint: str
    unit: str
    length: str


@dataclass(frozen=True)
class Model:
    """Parameter files that belong to one model, joined.

    Parameters
    ----------
    kind : Kind
        "identified" step by step, "refined" with effects in it, or "simultaneous" in
        one least squares.
    sources : tuple of Source
        The one that holds most comes last.
    file : ParameterFile
        All of them together.
    """

    kind: Kind
    sources: tuple[Parameters, ...]
    file: ParameterFile

    @property
    def path(self) -> str:
        """The file that holds most of it."""
        return self.sources[-1].path

    @property
    def stages(self) -> Stages:
        """The stages that were identified."""
        return self.file.stages


@dataclass(frozen=True, kw_only=True)
class Collection:
    """The documents of the report.

    Parameters
    ----------
    robot : RobotId
    sources : tuple of Source
        All documents.
    models : tuple of Model
        The best first.
    predictions : tuple of Source
        Those of the best model first.
    diagnoses, payloads, plans, drives, replays : tuples of Source
    warnings : tuple of str
        About files that fit, but not perfectly.
    """

    robot: RobotId
    sources: tuple[Source[Document], ...]
    models: tuple[Model, ...]
    predictions: tuple[Prediction, ...]
    diagnoses: tuple[Source[DiagnosisFile], ...]
    payloads: tuple[Source[PayloadFile], ...]
    plans: tuple[Source[PlanFile], ...]
    warnings: tuple[str, ...]
    drives: tuple[Source[DriveFile], ...] = ()
    replays: tuple[Source[ReplayFile], ...] = ()

    @property
    def model(self) -> Model | None:
        """The model that the report shows, if a parameter file was given."""
        return self.models[0] if self.models else None

    @property
    def is_about_a_model(self) -> bool:
        """True where a model, a prediction or a diagnosis was given."""
        return bool(self.models or self.predictions or self.diagnoses)

    def place(self, joint: str) -> Place:
        """Return a joint with its units."""
        return Place(
            joint=joint,
            unit=unit_text(self.robot.unit("N m", joint)),
            length=unit_text(self.robot.unit("rad", joint)),
        )

    def residual(self, prediction: Prediction, joint: str) -> ResidualEntry | None:
        """Return a joint's residual from a diagnosis of the prediction's own logs.

        Parameters
        ----------
        prediction : Source
        joint : str

        Returns
        -------
        ResidualEntry or None
            None where no diagnosis is of exactly these logs.
        """
        logs = {log.sha256 for log in prediction.content.logs}
        for diagnosis in self.diagnoses:
            file = diagnosis.content
            is_of_same_logs = {log.sha256 for log in file.inputs} == logs
            if is_of_same_logs and joint in file.joints:
                return file.joints[joint]
        return None

    def model_of(self, prediction: Prediction) -> Model | None:
        """Return the model that a prediction was made with, if its file was given."""
        used = {item.sha256 for item in prediction.content.parameters}
        for model in self.models:
            if used & {source.sha256 for source in model.sources}:
                return model
        return None

    def call(self, name: str, *logs: str, output: str = "") -> str:
        """Return a command line that goes on from the model of the report.

        Parameters
        ----------
        name : str
            The command.
        *logs : str
            Paths and options of logs; a place to fill in where there are none.
        output : str
            Where the result goes, if anywhere.

        Returns
        -------
        str
        """
        path = self.model.path if self.model else "inertia.json"
        words = ["seqid", name, *(logs or ("LOG...",)), "-r", "robot.toml", "-p", path]
        if output:
            words += ["-o", output]
        return command(*words)

    @property
    def judged(self) -> tuple[Prediction, ...]:
        """The predictions of the model that the report shows; all if it has none."""
        if not self.models:
            return self.predictions
        of_model = [p for p in self.predictions if self.model_of(p) is self.model]
        return tuple(of_model) or self.predictions

    def label(self, prediction: Prediction) -> str:
        """Return the file of a prediction's model.

        Where there is one before and one after refinement, it says which.
        """
        path = prediction.path
        if prediction.content.parameters:
            path = prediction.content.parameters[-1].path
        name = short_path(path)

        models = [self.model_of(item) for item in self.predictions]
        kinds = sorted(model.kind for model in models if model is not None)
        model = self.model_of(prediction)
        if kinds != ["identified", "refined"] or model is None:
            return name
        return f"after: {name}" if model.kind == "refined" else f"before: {name}"


def of_kind(
    documents: Iterable[Source[Document]], kind: type[D]
) -> tuple[Source[D], ...]:
    """Return the documents of one kind."""
    of_this_kind = (item for item in documents if isinstance(item.content, kind))
    return tuple(of_this_kind)  # type: ignore[arg-type]


def collect(documents: Sources) -> Collection:
    """Sort documents and make sure that they are about one robot and agree.

    Parameters
    ----------
    documents : sequence of Source
        The same file twice counts once.

    Returns
    -------
    Collection

    Raises
    ------
    ConfigError
        There is none, they are about two robots, or a result was made with a parameter
        file that has changed since.
    """
    if not documents:
        raise ConfigError(
            "no file given", hint="Name the JSON files that the stages wrote."
        )
    by_content = {(item.path, item.sha256): item for item in documents}
    unique = tuple(by_content.values())
    robot = _common_robot(unique)
    collection = Collection(
        robot=robot,
        sources=unique,
        models=tuple(_models(of_kind(unique, ParameterFile))),
        predictions=of_kind(unique, PredictionFile),
        diagnoses=of_kind(unique, DiagnosisFile),
        payloads=of_kind(unique, PayloadFile),
        plans=of_kind(unique, PlanFile),
        warnings=tuple(_warnings(unique)),
        drives=of_kind(unique, DriveFile),
        replays=of_kind(unique, ReplayFile),
    )

    # Predictions in the order of their models; those of no model come last.
    rank_of_model = {id(model): rank for rank, model in enumerate(collection.models)}
    no_rank = len(rank_of_model)

    def rank(prediction: Prediction) -> int:
        return rank_of_model.get(id(collection.model_of(prediction)), no_rank)

    best_first = sorted(collection.predictions, key=rank)
    return replace(collection, predictions=tuple(best_first))


def _common_robot(documents: Sources) -> RobotId:
    """Return the robot that all documents are about."""
    first = documents[0]
    robot = first.content.robot
    for item in documents[1:]:
        check_same_robot(
            (first.path, robot),
            (item.path, item.content.robot),
            "Report on one robot at a time.",
        )
    joints = robot.joints
    if not 0 < len(joints) == len(set(joints)) <= _MOST_JOINTS:
        message = f"$.robot.joints: must name 1 to {_MOST_JOINTS} joints, each once"
        raise ConfigError(
            message, where=first.path, hint="Run the command again that wrote it."
        )
    return robot


def models_of(content: Result) -> list[FileId]:
    """Return the parameter files that a result was made with."""
    if isinstance(content, ReplayFile):
        # It was made with a drive, which is no parameter file.
        return []
    if isinstance(content, PayloadFile | DriveFile):
        return content.models
    return content.parameters


def _warnings(documents: Sources) -> Iterator[str]:
    """Say what does not fit perfectly.

    A result whose parameter file has changed since is refused.
    """
    path_of_robot: dict[str, str] = {}
    for item in documents:
        path_of_robot.setdefault(item.content.robot.sha256, item.path)
    if len(path_of_robot) > 1:
        yield (
            "the robot file changed between these results:"
            f" {', '.join(path_of_robot.values())}"
        )

    parameter_files = of_kind(documents, ParameterFile)
    by_path = {Path(item.path).resolve(): item for item in parameter_files}
    if not by_path:
        return
    hashes = {item.sha256 for item in by_path.values()}
    for item in documents:
        if isinstance(item.content, ParameterFile):
            continue
        for used in models_of(item.content):
            if used.sha256 in hashes:
                continue
            same_path = by_path.get(Path(used.path).resolve())
            if same_path is not None:
                _refuse_outdated(item, used, same_path)
            yield (
                f"{item.path} was made with {used.path} (sha256 {used.sha256[:12]}),"
                " which is not among the files given"
            )


def _refuse_outdated(
    item: Source[Document], used: FileId, current: Parameters
) -> NoReturn:
    """Raise that a result was made with a parameter file as it was before."""
    message = (
        f"was made with {used.path} as it was before (sha256 {used.sha256[:12]});"
        f" {current.path} has changed since (now {current.sha256[:12]})"
    )
    command_name = WRITTEN_BY[type(item.content)]
    hint = f"Run seqid {command_name} again, or leave {item.path} out."
    raise ConfigError(message, where=item.path, hint=hint)


def kind_of(file: ParameterFile) -> Kind:
    """Return whether a file is refined, of one least squares, or of separate steps."""
    stages = file.stages
    if file.closed_loop is not None or stages.effects is not None:
        return "refined"
    for stage in (stages.friction, stages.inertia):
        if stage is not None and stage.method == "simultaneous":
            return "simultaneous"
    return "identified"


def _models(files: Sequence[Parameters]) -> Iterator[Model]:
    """Join the files of each kind that agree on all their stages.

    The fullest file of a model comes last.
    """
    fullest_first = sorted(files, key=lambda item: -len(present(item.content.stages)))
    for kind in KINDS:
        # Each branch is a list of files that agree with each other.
        branches: list[list[Parameters]] = []
        for item in fullest_first:
            if kind_of(item.content) != kind:
                continue
            for branch in branches:
                if all(_agree(item.content, member.content) for member in branch):
                    branch.insert(0, item)
                    break
            else:
                branches.append([item])
        for branch in branches:
            named = [(item.path, item.content) for item in branch]
            yield Model(kind, tuple(branch), join(named))


def _agree(first: ParameterFile, second: ParameterFile) -> bool:
    """Return whether two files hold the same stages and the same refinement."""
    first_stages = present(first.stages)
    second_stages = present(second.stages)
    for name in first_stages.keys() & second_stages.keys():
        if first_stages[name] != second_stages[name]:
            return False
    if first.closed_loop is None or second.closed_loop is None:
        return True
    return first.closed_loop == second.closed_loop
