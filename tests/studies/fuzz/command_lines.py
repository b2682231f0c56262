"""Command lines for every subcommand and every kind of input, from the table of
commands.

Each line gives one damaged file to one place where a command reads a file, and sound
files to the others. A new command, or a new option that reads, is fuzzed without a word
here; an option of a name that is not known yet fails a test.
"""

from collections.abc import Iterator
from itertools import product

from typer.core import TyperArgument, TyperOption

from seqid_cli.commands.app import COMMANDS, load_command
from tests.studies.fuzz.target import Line

# Kinds of input, by the names of the parameters that read them.
KINDS = {
    "logs": "log",
    "holdout": "log",
    "have": "log",
    "folder": "log",
    "robot": "robot",
    "urdf": "URDF",
    "parameters": "parameters",
    "first": "parameters",
    "second": "parameters",
    "files": "document",
    "plan": "plan",
    "torques": "torques",
}
# Places that read another kind than their name says.
_OTHER_KINDS = {("export", "replay"): "log", ("replay", "parameters"): "drive"}
# Parameters that name what is written.
WRITTEN = frozenset({"output", "trajectories", "layouts", "table", "figures"})
# Places that write in one command what they read in another.
OTHER_WRITTEN = frozenset({("predict", "torques")})
_SOUND = {
    "log": "{@}/log",
    "robot": "{@}/robot.toml",
    "URDF": "{@}/arm.urdf",
    "parameters": "{@}/model.json",
    "document": "{@}/model.json",
    "drive": "{@}/drive.json",
}
# Sound files of places that need others than most.
_OTHER_SOUND = {
    ("friction", "logs"): "{@}/friction",
    ("gravity", "logs"): "{@}/gravity",
    ("imu-calib", "logs"): "{@}/imu",
    ("inertia", "logs"): "{@}/inertia",
    ("plan", "have"): "{@}/inertia",
    ("refine", "holdout"): "{@}/held_out",
    ("run", "folder"): "{@}/folder",
}
# A folder in place of a damaged log in it.
_FOLDERS = {("run", "folder"): "{@}/folder"}
# Words of parameters that a command asks for and that name no file.
_WORDS = {"what": "PLAN", "shell": "bash", "output": "OUTPUT"}
_OUTPUTS = {
    "init": ("{@}/out.toml",),
    "report": ("{@}/out.html",),
    "export": ("{@}/out.urdf", "{@}/out.xml", "{@}/out.yaml"),
    "run": ("{@}/out",),
}
_PLANS = ("friction", "gravity", "imu-calib", "inertia", "payload", "validation")
# What keeps a line short, of which there are to be many; what a command needs two of.
_MORE = {
    "run": ("--no-refine", "--force"),
    "refine": ("--rounds", "1"),
    "trend": ("{@}/later.json",),
}


def reading_places(command: str) -> dict[str, str]:
    """Return the kinds of input that a command reads, by its parameters' names."""
    found = {}
    for param in load_command(command).params:
        place = (command, str(param.name))
        kind = _OTHER_KINDS.get(place, KINDS.get(place[1]))
        if kind is not None and place not in OTHER_WRITTEN:
            found[place[1]] = kind
    return found


def lines_for(kind: str) -> list[Line]:
    """Return the lines that give a damaged file of a kind to a command."""
    return [
        line
        for command in COMMANDS
        for place, read in reading_places(command).items()
        if read == kind
        for line in _lines_of(command, place)
    ]


def sound_lines() -> list[Line]:
    """Return lines of every command with sound files in all places."""
    return [line for command in COMMANDS for line in _lines_of(command, "")]


def _lines_of(command: str, damaged: str) -> Iterator[Line]:
    """Yield the lines of a command with a damaged file in one place."""
    words = [command]
    for param in load_command(command).params:
        value = _value_of(command, param, damaged)
        if value and param.param_type_name == "option":
            words.append(param.opts[0])
        if value:
            words.append(value)
    words += _MORE.get(command, ())

    outputs = _OUTPUTS.get(command, ("{@}/out.json",)) if "OUTPUT" in words else ("",)
    plans = _PLANS if "PLAN" in words else ("",)
    for output, plan in product(outputs, plans):
        filled = {"OUTPUT": output, "PLAN": plan}
        yield tuple(filled.get(word, word) for word in words)


def _value_of(command: str, param: TyperArgument | TyperOption, damaged: str) -> str:
    """Return what a parameter is given; empty where it is left out."""
    name = str(param.name)
    place = (command, name)
    kind = reading_places(command).get(name)
    if name == damaged:
        return _FOLDERS.get(place, "{}")
    if name in _WORDS:
        return _WORDS[name]
    # The URDF of a command stands for a robot file.
    is_given = name == "parameters" or (name == "robot" and damaged != "urdf")
    if kind is None or not (param.required or is_given):
        return ""
    return _OTHER_SOUND.get(place, _SOUND[kind])
