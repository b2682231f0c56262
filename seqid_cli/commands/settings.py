"""`--show-settings` and `--set`: which settings each command has, and their table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from typer.core import TyperCommand

from seqid_cli.commands.screen.render import Screen, screen_for
from seqid_cli.discover.settings import (
    DiscoverSettings,
    EventSettings,
    EvidenceSettings,
)
from seqid_cli.drive.settings import DriveSettings
from seqid_cli.identify.settings import (
    AgreementSettings,
    CutoffCheckSettings,
    CutoffSettings,
    FrictionSettings,
    GravityFitSettings,
    GravitySettings,
    HuntingSettings,
    ImuCalibSettings,
    InertiaSettings,
    JudgingSettings,
    MountingSettings,
    PredictionErrorSettings,
    PredictSettings,
    ResidualSettings,
    ReversalSettings,
    RotorSettings,
    SimultaneousSettings,
    SurfaceSettings,
    TrialSettings,
)
from seqid_cli.inspect.settings import EchoSettings, InspectSettings
from seqid_cli.payload.settings import PayloadSettings
from seqid_cli.plan.settings import PlanSettings
from seqid_cli.settings import Entry, Settings, entries, overridden


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """The settings of `run`: those of the commands that it runs, each group once.

    Commands of a run that have a group of one name have the same group.
    """

    judging: JudgingSettings = JudgingSettings()
    surface: SurfaceSettings = SurfaceSettings()
    trials: TrialSettings = TrialSettings()
    hunting: HuntingSettings = HuntingSettings()
    fit: GravityFitSettings = GravityFitSettings()
    mounting: MountingSettings = MountingSettings()
    residual: ResidualSettings = ResidualSettings()
    reversals: ReversalSettings = ReversalSettings()
    cutoff: CutoffSettings = CutoffSettings()
    cutoff_check: CutoffCheckSettings = CutoffCheckSettings()
    rotors: RotorSettings = RotorSettings()
    agreement: AgreementSettings = AgreementSettings()
    errors: PredictionErrorSettings = PredictionErrorSettings()
    evidence: EvidenceSettings = EvidenceSettings()
    events: EventSettings = EventSettings()
    echo: EchoSettings = EchoSettings()


SETTINGS_OF_COMMANDS: Mapping[str, Settings] = {
    "inspect": InspectSettings(),
    "run": RunSettings(),
    "friction": FrictionSettings(),
    "gravity": GravitySettings(),
    "imu-calib": ImuCalibSettings(),
    "inertia": InertiaSettings(),
    "predict": PredictSettings(),
    "diagnose": DiscoverSettings(),
    "refine": DiscoverSettings(),
    "simultaneous": SimultaneousSettings(),
    "plan": PlanSettings(),
    "payload": PayloadSettings(),
    "drive": DriveSettings(),
}


def words_for_step(command: str, set_values: Sequence[str]) -> list[str]:
    """Return the --set options of a run that one of its commands takes.

    `set_values` have been checked against the settings of the run.
    """
    if command not in SETTINGS_OF_COMMANDS:
        return []
    groups = {group.name for group in fields(SETTINGS_OF_COMMANDS[command])}
    words = []
    for text in set_values:
        group_name = text.partition(".")[0].strip()
        if group_name in groups:
            words += ["--set", text]
    return words


def show_settings(command: TyperCommand, name: str, words: Sequence[str]) -> int:
    """Show the settings of a command as the words behind it would make them.

    The words need not hold what the command asks for otherwise, such as logs: they are
    read as for completion, which misses nothing.
    """
    with command.make_context(name, list(words), resilient_parsing=True) as context:
        options = context.params
    screen = screen_for(
        name,
        quiet=options["quiet"],
        verbose=options["verbose"],
        json=options["json"],
        no_color=options["no_color"],
    )
    effective = overridden(SETTINGS_OF_COMMANDS[name], options["set_values"] or ())
    _show(screen, list(entries(effective)))
    return 0


def _show(screen: Screen, settings: Sequence[Entry]) -> None:
    """Print settings as a table, or as one JSON document."""
    document = [
        {
            "name": entry.name,
            "value": entry.value,
            "default": entry.default,
            "unit": entry.unit,
            "low": entry.low,
            "high": entry.high,
            "reason": entry.reason,
        }
        for entry in settings
    ]
    screen.document({"settings": document})
    rows = [
        (entry.name, value_text(entry), entry.unit, entry.reason) for entry in settings
    ]
    screen.table(("setting", "value", "unit", "reason"), rows)


def value_text(entry: Entry) -> str:
    """Return the value of a setting, with its default where it is another."""
    if not entry.changed:
        return f"{entry.value:g}"
    return f"{entry.value:g} (default {entry.default:g})"
