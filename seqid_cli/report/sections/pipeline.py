"""The way from the logs to the model: which command made which file from which."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from seqid_cli.params.document import present
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.report.collection import WRITTEN_BY, Collection, Model, models_of
from seqid_cli.report.judgement import stage_verdicts
from seqid_cli.report.torques import TorqueTable
from seqid_cli.report.views import Cell, Group, Section, Table, badge_text, numbers, texts
from seqid_cli.report.words import effect_at, file_name, listed, plural

_COMMANDS = {
    "friction": "friction",
    "gravity": "gravity",
    "imu": "imu-calib",
    "inertia": "inertia",
    "effects": "refine",
}
_MOST_LOGS = 500


def pipeline(collection: Collection, tables: Sequence[TorqueTable]) -> Section:
    """Return the section on files and commands."""
    columns = texts("command", "read", "wrote", "verdict")
    steps = Table("Commands in their order", columns, list(_steps(collection, tables)))
    return Section(
        "pipeline",
        "Pipeline and files",
        lead="Each step builds on the one before. Hashes are SHA-256; two files with the same hash "
        "are the same to the last bit.",
        groups=[Group("steps", "Step by step", tables=[steps])],
        tables=[_files(collection), _logs(collection)],
    )


def _steps(collection: Collection, tables: Sequence[TorqueTable]) -> Iterator[Sequence[Cell]]:
    model = collection.model
    if model is not None:
        yield from _stage_steps(collection, model)
    if not collection.predictions:
        yield _step("predict")
    for prediction in collection.predictions:
        good = all(verdict.good for verdict in prediction.file.verdicts)
        state = "good" if good else "poor"
        torques = [table.path for table in tables if table.prediction == prediction]
        made = ", ".join(map(file_name, (prediction.path, *torques)))
        yield _step("predict", _logs_text(prediction.file.inputs), made, state, state)
    if not collection.diagnoses:
        yield _step("diagnose")
    for item in collection.diagnoses:
        found = item.file.verdict
        state = "good" if found == "nothing_missing" else "open"
        text = found.replace("_", " ")
        yield _step("diagnose", _logs_text(item.file.inputs), file_name(item.path), state, text)
    yield from _refine_steps(collection)


def _step(
    name: str, reads: str = "", writes: str = "", state: str = "", text: str = "not given"
) -> Sequence[Cell]:
    return f"seqid {name}", reads, writes, badge_text(state, text)


def _stage_steps(collection: Collection, model: Model) -> Iterator[Sequence[Cell]]:
    if model.kind == "simultaneous":
        reads = _logs_text(model.file.inputs)
        state = _state("inertia", model)
        yield _step("simultaneous", reads, file_name(model.path), *state)
        return
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(model.stages, name)
        if stage is None:
            yield _step(_COMMANDS[name])
            continue
        logs = [log for log in model.file.inputs if log.stage == name]
        made = _first_file(collection, name) or model.path
        state = _state(name, model)
        yield _step(_COMMANDS[name], _logs_text(logs), file_name(made), *state)


def _refine_steps(collection: Collection) -> Iterator[Sequence[Cell]]:
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
        yield _step("refine", _logs_text(logs), file_name(model.path), state, text)


def _first_file(collection: Collection, stage: str) -> str:
    """Return the file that a stage was made in: the file with the fewest stages that holds it."""
    holding = [
        (len(present(item.content.stages)), place, item.path)
        for place, item in enumerate(collection.sources)
        if isinstance(item.content, ParameterFile)
        and getattr(item.content.stages, stage) is not None
    ]
    return min(holding)[2] if holding else ""


def _state(name: str, model: Model) -> tuple[str, str]:
    """Return the verdict on a stage as its badge and its text."""
    if getattr(getattr(model.stages, name), "parameters", None) == []:
        return "", "nothing to identify"
    mine = [verdict for stage, verdict in stage_verdicts(model.stages) if stage == name]
    state = "good" if all(verdict.good for verdict in mine) else "poor"
    return state, state


def _logs_text(logs: Sequence[InputLog]) -> str:
    if not logs:
        return ""
    samples = _thousands(sum(log.samples for log in logs))
    return f"{plural(len(logs), 'log')}, {samples} samples"


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _files(collection: Collection) -> Table:
    columns = texts("file", "kind", "holds", "written", "by", "SHA-256")
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
    columns = (*texts("read by", "log"), *numbers("samples"), *texts("SHA-256"))
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
