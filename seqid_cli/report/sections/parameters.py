"""Base parameters with their expressions, intervals and units; effects with theirs."""

from collections.abc import Sequence

from markupsafe import Markup

from seqid_cli.effects.registry import setting_units
from seqid_cli.effects.units import UNEXPLAINED, smooth_in_words
from seqid_cli.params.results.diagnosis import FindingEntry
from seqid_cli.params.results.tables import Head, Values, heads, of_joints
from seqid_cli.params.schema import EffectOfJoint, RigidStage
from seqid_cli.report import views, words
from seqid_cli.report.collection import Collection, Model
from seqid_cli.report.sections.correlation import correlation_figure
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
        text = "No parameter file is among the files given."
        return views.lacking("parameters", "Parameters", text, _MADE_BY["inertia"])

    groups = []
    absent_stages = []
    for name in _TITLES:
        stage = getattr(model.stages, name)
        if stage is not None:
            groups.append(_rigid_group(name, stage, collection))
        # One least squares has gravity among its inertia.
        elif model.kind != "simultaneous" or name == "inertia":
            text = f"The {name} stage is not in the files given."
            absent_stages.append(Absent(text, _MADE_BY[name]))
    if model.stages.effects:
        groups.append(_effects_group(model.stages.effects))
    return Section(
        id="parameters",
        title="Parameters",
        lead=_LEAD,
        groups=groups,
        absent=absent_stages,
    )


def _effects_group(effects: Sequence[EffectOfJoint]) -> Group:
    """Return the group on effects that refinement added."""
    rows = []
    for item in effects:
        title = words.effect_at(item.effect, item.joint or "the whole arm")
        rows += [(title, *row) for row in value_rows(item)]
    table = Table(
        caption="Effects that refinement added",
        values=Values([*heads("effect", "text"), *VALUE_HEADS], rows),
    )
    return Group(id="effects", title="Effects", tables=[table])


def _rigid_group(name: str, stage: RigidStage, collection: Collection) -> Group:
    """Return the group on the base parameters of a stage."""
    title = _TITLES[name]
    state = views.badge(stage.verdicts) if stage.parameters else ""
    notes = list(stage.notes)
    if stage.not_excited:
        names = words.listed(stage.not_excited, 40)
        notes.insert(0, f"Not determined by these logs: {names}.")

    reason_of_joint = {verdict.joint: verdict.reason for verdict in stage.verdicts}
    rows = [
        (joint, rmse, reason_of_joint.get(joint, ""))
        for joint, rmse in stage.rmse.items()
    ]
    errors = of_joints(
        "joint | RMS error [{unit}] | verdict",
        "text number text",
        rows,
        collection.robot,
    )
    faults = [v.reason for v in stage.verdicts if not v.joint and not v.good]
    return Group(
        id=f"{name}-parameters",
        title=title,
        lead="; ".join(faults),
        badge=state,
        badge_text=state if stage.parameters else "nothing to identify",
        facts=_facts(stage),
        figures=[correlation_figure(stage, title)],
        tables=[
            _parameter_table(name, stage, collection.models[1:]),
            Table(caption=f"{title}: error of the fit per joint", values=errors),
        ],
        notes=notes,
        unfolded=True,
    )


def _facts(stage: RigidStage) -> list[tuple[str, str]]:
    """Return how well a stage is determined; nothing where it has no parameters."""
    if not stage.parameters:
        return []
    rank = f"{stage.rank}"
    if stage.structural_rank:
        rank += f" of {stage.structural_rank}"
    facts = [
        ("rank", rank),
        ("condition", words.number(stage.condition)),
        ("method", stage.method),
    ]
    if stage.cutoff_hz:
        facts.append(("cut-off", f"{words.number(stage.cutoff_hz)} Hz"))
    return facts


def _parameter_table(
    name: str, stage: RigidStage, other_models: Sequence[Model]
) -> Table:
    """Return the parameters of a stage, beside those of models where they differ."""
    columns = [*VALUE_HEADS, *heads("stands for", "text")]
    values_of_others = []
    for model in other_models:
        values = _differing_values(name, stage, model)
        if values:
            values_of_others.append(values)
            columns.append(Head(f"in {words.short_path(model.path)}", "number"))

    rows = []
    for item in stage.parameters:
        _, *estimate = value_row("", item.value, item.std_error, item.unit)
        sum_of_terms = words.expression(item.terms, item.expression or item.name)
        formula = Markup('<span class="formula">{}</span>').format(sum_of_terms)
        beside = [values.get(item.name) for values in values_of_others]
        rows.append((words.symbol(item.name), *estimate, formula, *beside))
    return Table(
        caption=f"{_TITLES[name]}: base parameters",
        values=Values(columns, rows),
        note=_note_on_zero(stage),
    )


def _differing_values(name: str, stage: RigidStage, model: Model) -> dict[str, str]:
    """Return another model's values of a stage; nothing where all are the same."""
    other_stage = getattr(model.stages, name)
    if other_stage is None:
        return {}
    values = {item.name: item.value for item in stage.parameters}
    differs = any(
        values.get(item.name, item.value) != item.value
        for item in other_stage.parameters
    )
    if not differs:
        return {}
    return {
        item.name: words.with_error(item.value, item.uncertainty)[0]
        for item in other_stage.parameters
    }


def _note_on_zero(stage: RigidStage) -> str:
    """Return which parameters have an interval that holds zero, if any."""
    names = [
        item.name
        for item in stage.parameters
        if abs(item.value) < words.Z95 * item.uncertainty
    ]
    if not names:
        return ""
    verb = "holds" if len(names) == 1 else "hold"
    count = f"{words.plural(len(names), 'interval')} of {len(stage.parameters)}"
    return f"{count} {verb} zero: {words.listed(names, 12)}."


def value_rows(item: EffectOfJoint | FindingEntry) -> list[tuple[str, ...]]:
    """Return an effect's parameters and settings as rows under `VALUE_HEADS`."""
    if item.effect == UNEXPLAINED:
        text = smooth_in_words(item.parameters, item.settings)
        return [(text, words.DASH, words.DASH, words.DASH, "")]
    rows = []
    for parameter in item.parameters:
        name = words.effect_words(parameter.name)
        row = value_row(name, parameter.value, parameter.std_error, parameter.unit)
        rows.append(row)

    # A setting with an error of its own stands among the parameters already.
    parameter_names = {parameter.name for parameter in item.parameters}
    units = setting_units(item.effect)
    for name, setting in item.settings.items():
        if name in parameter_names:
            continue
        text = str(setting)
        if isinstance(setting, float):
            text = words.number(setting)
        unit = words.unit_text(units.get(name, ""))
        rows.append((words.effect_words(name), text, "fixed", words.DASH, unit))
    return rows
