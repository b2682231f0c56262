"""Base parameters with their expressions, intervals and units; effects with theirs."""

from collections.abc import Sequence

from markupsafe import Markup

from seqid_cli.model.effects.registry import setting_units
from seqid_cli.model.effects.units import UNEXPLAINED, smooth_in_words
from seqid_cli.params.results.diagnosis import FindingEntry
from seqid_cli.params.results.tables import Head, Values, heads, of_joints
from seqid_cli.params.schema import EffectOfJoint, RigidStage
from seqid_cli.report import views, words
from seqid_cli.report.collection import Collection, Model
from seqid_cli.report.views import VALUE_HEADS, Absent, Group, Section, Table, value_row

_TITLES = {"gravity": "Gravity", "inertia": "Inertia"}
_MADE_BY = {
    "gravity": "seqid gravity LOG... -r robot.toml -p friction.json -o gravity.json",
    "inertia": "seqid inertia LOG... -r robot.toml -p imu.json -o inertia.json",
}
_LEAD = (
    "Base parameters are all that joint torque can tell of the links: each stands for"
    " the sum of standard link parameters beside it. Index i is the link that joint i"
    " moves; m is its mass, mx, my, mz its first moment, Ixx to Izz its inertia about"
    " the origin of its joint frame, Ia the rotor inertia of its drive on the motor"
    " side. Intervals are 95 %."
)


def parameters(collection: Collection) -> Section:
    """Return the section on gravity, inertia and effects."""
    model = collection.model
    if model is None:
        text, call = "No parameter file is among the files given.", _MADE_BY["inertia"]
        return views.lacking("parameters", "Parameters", text, call)
    groups, absent_stages = [], []
    for name in _TITLES:
        stage = getattr(model.stages, name)
        if stage is not None:
            groups.append(_rigid(name, stage, collection))
        elif model.kind != "simultaneous" or name == "inertia":
            text = f"The {name} stage is not in the files given."
            absent_stages.append(Absent(text, _MADE_BY[name]))
    if model.stages.effects:
        rows = [
            (words.effect_at(item.effect, item.joint or "the whole arm"), *row)
            for item in model.stages.effects
            for row in value_rows(item)
        ]
        found = Values([*heads("effect", "text"), *VALUE_HEADS], rows)
        effects = Table("Effects that refinement added", found)
        groups.append(Group("effects", "Effects", tables=[effects]))
    return Section("parameters", "Parameters", _LEAD, groups, absent=absent_stages)


def _rigid(name: str, stage: RigidStage, collection: Collection) -> Group:
    title, own, facts, state = _TITLES[name], stage.verdicts, [], ""
    if stage.parameters:
        whole = f" of {stage.structural_rank}" if stage.structural_rank else ""
        facts = [
            ("rank", f"{stage.rank}{whole}"),
            ("condition", words.number(stage.condition)),
        ]
        facts.append(("method", stage.method))
        facts += (
            [("cut-off", f"{words.number(stage.cutoff_hz)} Hz")]
            if stage.cutoff_hz
            else []
        )
        state = views.badge(own)
    notes = list(stage.notes)
    if stage.not_excited:
        notes.insert(
            0, f"Not determined by these logs: {words.listed(stage.not_excited, 40)}."
        )
    reasons = {v.joint: v.reason for v in own}
    rows = [(n, x, reasons.get(n, "")) for n, x in stage.rmse.items()]
    titles = "joint | RMS error [{unit}] | verdict"
    errors = of_joints(titles, "text number text", rows, collection.robot)
    fits = Table(f"{title}: error of the fit per joint", errors)
    return Group(
        f"{name}-parameters",
        title,
        lead="; ".join(v.reason for v in own if not v.joint and not v.good),
        badge=state,
        badge_text=state if stage.parameters else "nothing to identify",
        facts=facts,
        tables=[_table(name, stage, collection.models[1:]), fits],
        notes=notes,
        unfolded=True,
    )


def _table(name: str, stage: RigidStage, others: Sequence[Model]) -> Table:
    """The parameters of a stage, beside them those of other models where they differ."""
    mine, columns = {item.name: item.value for item in stage.parameters}, [*VALUE_HEADS]
    columns += heads("stands for", "text")
    earlier = []
    for model in others:
        theirs = getattr(model.stages, name)
        known = {item.name: item for item in theirs.parameters} if theirs else {}
        if any(
            mine.get(item.name, item.value) != item.value for item in known.values()
        ):
            earlier.append(
                {n: words.with_error(x.value, x.std_error)[0] for n, x in known.items()}
            )
            columns.append(Head(f"in {words.short_path(model.path)}", "number"))
    rows = []
    for item in stage.parameters:
        _, *estimate = value_row("", item.value, item.std_error, item.unit)
        sum_of = words.expression(item.terms, item.expression or item.name)
        formula = Markup('<span class="formula">{}</span>').format(sum_of)
        beside = (values.get(item.name) for values in earlier)
        rows.append((words.symbol(item.name), *estimate, formula, *beside))
    unclear = [
        p.name for p in stage.parameters if abs(p.value) < words.Z95 * p.std_error
    ]
    note = ""
    if unclear:
        hold = "holds" if len(unclear) == 1 else "hold"
        count = f"{words.plural(len(unclear), 'interval')} of {len(stage.parameters)}"
        note = f"{count} {hold} zero: {words.listed(unclear, 12)}."
    return Table(f"{_TITLES[name]}: base parameters", Values(columns, rows), note)


def value_rows(item: EffectOfJoint | FindingEntry) -> list[tuple[str, ...]]:
    """Return the rows of an effect's parameters and settings, under `VALUE_HEADS`."""
    if item.effect == UNEXPLAINED:
        text, none = smooth_in_words(item.parameters, item.settings), words.DASH
        return [(text, none, none, none, "")]
    own = [(words.effect_words(x.name), x) for x in item.parameters]
    rows = [value_row(name, x.value, x.std_error, x.unit) for name, x in own]
    named, units = {x.name for x in item.parameters}, setting_units(item.effect)
    for name, setting in item.settings.items():
        if name not in named:
            text = words.number(setting) if isinstance(setting, float) else str(setting)
            unit = words.unit_text(units.get(name, ""))
            rows.append((words.effect_words(name), text, "fixed", words.DASH, unit))
    return rows
