"""The way from the logs to the model: which command made which file from which."""

from collections.abc import Iterator, Sequence

from seqid_cli.params.document import COMMAND_OF, present
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.report.collection import WRITTEN_BY, Collection, Model, models_of, of_kind
from seqid_cli.report.judgement import stage_verdicts
from seqid_cli.report.torques import TorqueTable
from seqid_cli.report.views import Group, Section, Table, badge, badge_text, table
from seqid_cli.report.words import effect_at, file_name, listed, plural

_MOST_LOGS = 500


def pipeline(collection: Collection, tables: Sequence[TorqueTable]) -> Section:
    """Return the section on files and commands."""
    titles, rows = "command | read | wrote | verdict", _steps(collection, tables)
    steps = table("Commands in their order", titles, "text text text text", rows)
    return Section(
        "pipeline",
        "Pipeline and files",
        lead="Each step builds on the one before. Hashes are SHA-256; two files with the same hash "
        "are the same to the last bit.",
        groups=[Group("steps", "Step by step", tables=[steps])],
        tables=[_files(collection), _logs(collection)],
    )


def _steps(collection: Collection, tables: Sequence[TorqueTable]) -> Iterator[Sequence[str]]:
    if collection.model is not None:
        yield from _stage_steps(collection, collection.model)
    for prediction in collection.predictions:
        state = badge(prediction.content.verdicts)
        torques = [table.path for table in tables if table.prediction == prediction]
        made = ", ".join(map(file_name, (prediction.path, *torques)))
        yield _step("predict", prediction.content.inputs, made, state, state or "not judged")
    if not collection.predictions:
        yield _step("predict")
    for item in collection.diagnoses:
        found = item.content.verdict
        state = "good" if found == "nothing_missing" else "open"
        text = found.replace("_", " ")
        yield _step("diagnose", item.content.inputs, file_name(item.path), state, text)
    if not collection.diagnoses:
        yield _step("diagnose")
    for model in collection.models:
        if model.kind == "refined":
            logs = [x for x in model.file.inputs if COMMAND_OF.get(x.stage, "refine") == "refine"]
            effects = [effect_at(x.effect, x.joint) for x in model.stages.effects or []]
            loop = model.file.closed_loop
            state = "poor" if loop is not None and loop.verdict == "poor" else "good"
            text = listed(effects) or "nothing added"
            yield _step("refine", logs, file_name(model.path), state, text)


def _step(
    name: str,
    logs: Sequence[InputLog] = (),
    writes: str = "",
    state: str = "",
    text: str = "not given",
) -> Sequence[str]:
    samples = _thousands(sum(log.samples for log in logs))
    reads = f"{plural(len(logs), 'log')}, {samples} samples" if logs else ""
    return f"seqid {name}", reads, writes, badge_text(state, text)


def _stage_steps(collection: Collection, model: Model) -> Iterator[Sequence[str]]:
    if model.kind == "simultaneous":
        state = _state("inertia", model)
        yield _step("simultaneous", model.file.inputs, file_name(model.path), *state)
        return
    known = {s.path: present(s.content.stages) for s in of_kind(collection.sources, ParameterFile)}
    for name in ("friction", "gravity", "imu", "inertia"):
        if getattr(model.stages, name) is None:
            yield _step(COMMAND_OF[name])
            continue
        logs = [log for log in model.file.inputs if log.stage == name]
        # A stage was made in the file with the fewest stages that holds it.
        made = min((len(own), path) for path, own in known.items() if name in own)[1]
        yield _step(COMMAND_OF[name], logs, file_name(made), *_state(name, model))


def _state(name: str, model: Model) -> tuple[str, str]:
    """Return the verdict on a stage as its badge and its text."""
    if getattr(getattr(model.stages, name), "parameters", None) == []:
        return "", "nothing to identify"
    own = [verdict for stage, verdict in stage_verdicts(model.stages) if stage == name]
    return badge(own), badge(own) or "not judged"


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _files(collection: Collection) -> Table:
    rows = []
    for item in collection.sources:
        content = item.content
        if isinstance(content, ParameterFile):
            holds = ", ".join(present(content.stages))
        else:
            used = [f"{file_name(x.path)} {x.sha256[:12]}" for x in models_of(content)]
            holds = f"of {', '.join(used)}"
        kind, tool = content.schema.removeprefix("seqid/"), content.tool
        made = f"{tool.name} {tool.version}"
        rows.append((item.path, kind, holds, content.created, made, item.sha256))
    titles = "file | kind | holds | written | by | SHA-256"
    return table("The files of this report", titles, "text text text text text text", rows)


def _logs(collection: Collection) -> Table:
    found: dict[tuple[str, str, str], InputLog] = {}
    for item in collection.sources:
        content = item.content
        default = WRITTEN_BY.get(type(content), "refine")
        for log in [] if isinstance(content, PlanFile) else content.inputs:
            by = COMMAND_OF.get(log.stage, log.stage) or default
            found.setdefault((by, log.sha256, log.path), log)
        if isinstance(content, ParameterFile) and content.closed_loop is not None:
            for log in content.closed_loop.held_out:
                found.setdefault(("refine, held out", log.sha256, log.path), log)
    rows = [(by, x.path, _thousands(x.samples), x.sha256) for (by, *_), x in found.items()]
    note = f"and {len(rows) - _MOST_LOGS} more" if len(rows) > _MOST_LOGS else ""
    titles, kinds = "read by | log | samples | SHA-256", "text text count text"
    return table("The logs behind them", titles, kinds, rows[:_MOST_LOGS], note)
