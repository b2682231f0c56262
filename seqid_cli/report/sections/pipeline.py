"""The way from the logs to the model: which command made which file from which."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from seqid_cli.params.document import present
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.report.collection import WRITTEN_BY, Collection, Model, models_of
from seqid_cli.report.judgement import stage_verdicts
from seqid_cli.report.torques import TorqueTable
from seqid_cli.report.views import Column, Section, Table
from seqid_cli.report.words import effect_at, file_name, listed, plural

_COMMANDS = {
    "friction": "friction",
    "gravity": "gravity",
    "imu": "imu-calib",
    "inertia": "inertia",
    "effects": "refine",
}
_STATES = {"good": "good", "poor": "poor", "empty": "nothing to identify", "none": "not given"}
_MOST_LOGS = 500


@dataclass(frozen=True)
class Step:
    """One command of the pipeline: its inputs, its output, its verdicts."""

    command: str
    reads: str
    writes: str
    state: str
    state_text: str


def pipeline(collection: Collection, tables: Sequence[TorqueTable]) -> Section:
    """Return the section on files and commands."""
    return Section(
        "pipeline",
        "Pipeline and files",
        lead="Each step builds on the one before. Hashes are SHA-256; two files with the same hash "
        "are the same to the last bit.",
        tables=[_files(collection), _logs(collection)],
        template="pipeline.html.j2",
        data={"steps": list(_steps(collection, tables))},
    )


def _steps(collection: Collection, tables: Sequence[TorqueTable]) -> Iterator[Step]:
    model = collection.model
    if model is not None:
        yield from _stage_steps(collection, model)
    if not collection.predictions:
        yield Step("predict", "", "", "none", _STATES["none"])
    for prediction in collection.predictions:
        good = all(verdict.good for verdict in prediction.file.verdicts)
        state = "good" if good else "poor"
        torques = [table.path for table in tables if table.prediction == prediction]
        made = ", ".join(map(file_name, (prediction.path, *torques)))
        yield Step("predict", _logs_text(prediction.file.inputs), made, state, state)
    if not collection.diagnoses:
        yield Step("diagnose", "", "", "none", _STATES["none"])
    for item in collection.diagnoses:
        found = item.file.verdict
        state = "good" if found == "nothing_missing" else "open"
        text = found.replace("_", " ")
        yield Step("diagnose", _logs_text(item.file.inputs), file_name(item.path), state, text)
    yield from _refine_steps(collection)


def _stage_steps(collection: Collection, model: Model) -> Iterator[Step]:
    if model.kind == "simultaneous":
        state = _state("inertia", model)
        reads = _logs_text(model.file.inputs)
        yield Step("simultaneous", reads, file_name(model.path), state, _STATES[state])
        return
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(model.stages, name)
        if stage is None:
            yield Step(_COMMANDS[name], "", "", "none", _STATES["none"])
            continue
        logs = [log for log in model.file.inputs if log.stage == name]
        made = _first_file(collection, name) or model.path
        state = _state(name, model)
        yield Step(_COMMANDS[name], _logs_text(logs), file_name(made), state, _STATES[state])


def _refine_steps(collection: Collection) -> Iterator[Step]:
    for model in collection.models:
        if model.kind != "refined":
            continue
        effects = model.stages.effects or []
        logs = [
            log for log in model.file.inputs if log.stage not in _COMMANDS or log.stage == "effects"
        ]
        text = listed([effect_at(item.effect, item.joint) for item in effects]) or "nothing added"
        loop = model.file.closed_loop
        state = "poor" if loop is not None and loop.verdict == "poor" else "good"
        yield Step("refine", _logs_text(logs), file_name(model.path), state, text)


def _first_file(collection: Collection, stage: str) -> str:
    """Return the file that a stage was made in: the file with the fewest stages that holds it."""
    holding = [
        (len(present(item.content.stages)), place, item.path)
        for place, item in enumerate(collection.sources)
        if isinstance(item.content, ParameterFile)
        and getattr(item.content.stages, stage) is not None
    ]
    return min(holding)[2] if holding else ""


def _state(name: str, model: Model) -> str:
    stage = getattr(model.stages, name)
    if stage is not None and getattr(stage, "parameters", None) == []:
        return "empty"
    mine = [verdict for stage, verdict in stage_verdicts(model.stages) if stage == name]
    return "good" if all(verdict.good for verdict in mine) else "poor"


def _logs_text(logs: Sequence[InputLog]) -> str:
    if not logs:
        return ""
    samples = _thousands(sum(log.samples for log in logs))
    return f"{plural(len(logs), 'log')}, {samples} samples"


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _files(collection: Collection) -> Table:
    columns = (
        Column("file"),
        Column("kind"),
        Column("holds"),
        Column("written"),
        Column("by"),
        Column("SHA-256"),
    )
    rows = []
    for item in collection.sources:
        content = item.content
        kind = content.schema.removeprefix("seqid/")
        if isinstance(content, ParameterFile):
            holds = ", ".join(present(content.stages))
        else:
            holds = "of " + ", ".join(
                f"{file_name(used.path)} {used.sha256[:12]}" for used in models_of(content)
            )
        made = f"{content.tool.name} {content.tool.version}"
        rows.append((item.path, kind, holds, content.created, made, item.sha256))
    return Table("The files of this report", columns, rows)


def _logs(collection: Collection) -> Table:
    columns = (
        Column("read by"),
        Column("log"),
        Column("samples", numeric=True),
        Column("SHA-256"),
    )
    found: dict[tuple[str, str, str], InputLog] = {}
    for item in collection.sources:
        content = item.content
        default = WRITTEN_BY.get(type(content), "refine")
        for log in [] if isinstance(content, PlanFile) else content.inputs:
            by = _COMMANDS.get(log.stage, log.stage) or default
            found.setdefault((by, log.sha256, log.path), log)
        if isinstance(content, ParameterFile) and content.closed_loop is not None:
            for log in content.closed_loop.held_out:
                found.setdefault(("refine, held out", log.sha256, log.path), log)
    rows = [
        (by, log.path, _thousands(log.samples), log.sha256) for (by, _, _), log in found.items()
    ]
    note = f"and {len(rows) - _MOST_LOGS} more" if len(rows) > _MOST_LOGS else ""
    return Table("The logs behind them", columns, rows[:_MOST_LOGS], note)
