"""Every command as a function: same results, nothing printed; tables and recordings as
logs.
"""

import importlib
import inspect as signatures
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import seqid_cli
from seqid_cli import compare, discover, identify, inspect, report
from seqid_cli.commands.app import COMMANDS, run
from seqid_cli.errors import ConfigError, InputError, SeqidWarning, UsageError
from seqid_cli.inspect.progress import Progress
from seqid_cli.logs.read import read_recording
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from seqid_cli.working import heard_by
from tests import ROOT
from tests.unit.params.documents import diagnosis_file

SAMPLES = ROOT / "sample_logs" / "one_joint"
ROBOT = SAMPLES / "robot.toml"
GOLDEN = SAMPLES / "golden.json"
ORDERS = identify.FrictionOptions(position_order=2, velocity_order=3)
ENCODER = identify.PredictOptions(source="encoder")
ON_SCREEN_ONLY = {"context", "strict", "form", "explain"}
ON_SCREEN_ONLY |= {"quiet", "verbose", "json", "no_color", "debug"}
OTHERWISE = {"jobs", "engine", "scheduler"}  # an executor
OTHERWISE |= {"set_values", "show_settings"}  # settings
OTHERWISE |= {"start", "stop", "exclude"}  # a part
OTHERWISE |= {"layouts"}  # for viewers
# a shell's script, a template, and the others in a row
WITHOUT = {"completion", "init", "run"}


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - WITHOUT))
def test_functions_take_what_commands_take(name: str) -> None:
    python_name = name.replace("-", "_")
    module = importlib.import_module(COMMANDS[name].module)
    packages = [getattr(seqid_cli, package) for package in seqid_cli.PACKAGES]
    found = [getattr(package, python_name, None) for package in packages]
    command, function = getattr(module, python_name), next(filter(callable, found))
    asked_for = set(signatures.signature(command).parameters)
    asked = asked_for - ON_SCREEN_ONLY - OTHERWISE
    taken = signatures.signature(function).parameters
    options = taken["options"].default if "options" in taken else None
    known = set(taken) | set(getattr(options, "__dataclass_fields__", ()))
    assert asked - known == set()
    assert "start" not in asked_for or "part" in known
    assert function.__doc__
    assert issubclass(_result(function), msgspec.Struct)


def _result(function: Callable[..., object]) -> type:
    found = signatures.signature(function).return_annotation
    return (
        getattr(sys.modules[function.__module__], found)
        if isinstance(found, str)
        else found
    )


def test_the_result_is_the_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_hand, by_function = tmp_path / "command.json", tmp_path / "function.json"
    logs = SAMPLES / "friction"
    assert run(["friction", str(logs), "-r", str(ROBOT), "-o", str(by_hand)]) == 0
    capsys.readouterr()
    found = identify.friction(logs, ROBOT, output=by_function)
    assert capsys.readouterr() == ("", "")
    assert found.stages.friction is not None
    assert by_hand.read_bytes() == by_function.read_bytes()


@pytest.fixture(scope="module")
def friction() -> ParameterFile:
    return identify.friction(SAMPLES / "friction", ROBOT, ORDERS)


def test_results_pass_from_one_function_to_the_next(tmp_path: Path) -> None:
    """As files and as documents."""
    path, gravity = tmp_path / "friction.json", tmp_path / "gravity.json"
    friction = identify.friction(
        str(SAMPLES / "friction"), str(ROBOT), ORDERS, output=path
    )
    by_file = identify.gravity([SAMPLES / "gravity"], ROBOT, path, output=gravity)
    by_document = identify.gravity([SAMPLES / "gravity"], load_robot(ROBOT), friction)
    first, second = (f.stages.gravity.parameters for f in (by_file, by_document))
    assert [p.value for p in first] == pytest.approx(
        [p.value for p in second], rel=1e-9
    )
    assert compare.compare(gravity, gravity).changed == 0


@pytest.mark.slow
def test_a_table_is_a_log(friction: ParameterFile) -> None:
    """An Arrow table, or whatever gives itself away as one,
    goes wherever a path does.
    """

    class Frame:
        def __init__(self, table: pa.Table) -> None:
            self.table = table

        def __arrow_c_stream__(self, requested_schema: object = None) -> object:
            return self.table.__arrow_c_stream__(requested_schema)

    (path,) = (SAMPLES / "friction").glob("*.parquet")
    table = pq.read_table(path)
    for log in (Frame(table), [table]):
        found = identify.friction(log, ROBOT, ORDERS)  # type: ignore[arg-type]
        assert found.stages.friction == friction.stages.friction
        assert [log.path for log in found.inputs] == ["table_1"]
    held = read_recording(path, load_robot(ROBOT))
    assert identify.friction(held, ROBOT, ORDERS).stages == friction.stages
    with pytest.raises(InputError, match="int is no log"):
        identify.friction(3, ROBOT)  # type: ignore[arg-type]


@pytest.mark.slow
def test_tables_are_inspected_predicted_and_diagnosed() -> None:
    path, *_ = sorted((SAMPLES / "validation").glob("*.parquet"))
    table = pq.read_table(path)
    seen = inspect.inspect([table], ROBOT)
    assert [log.path for log in seen.logs] == ["table_1"]
    assert seen.verdict == inspect.inspect(path, ROBOT).verdict
    by_path, by_table = (
        identify.predict(log, ROBOT, GOLDEN, ENCODER) for log in (path, table)
    )
    assert by_table.joints == by_path.joints
    with pytest.raises(UsageError, match="given both to fit and to hold out"):
        discover.refine(table, table, ROBOT, GOLDEN)


def test_progress_is_told() -> None:
    told: list[Progress] = []
    logs = sorted((SAMPLES / "validation").glob("*.parquet"))
    identify.predict(logs, ROBOT, GOLDEN, ENCODER, on_progress=told.append)
    done = [(one.done, one.total, one.log) for one in told if one.state == "done"]
    assert done == [(k, len(logs), str(log)) for k, log in enumerate(logs, start=1)]
    notes = [one.note for one in told if one.note is not None]
    assert all(note.samples > 0 and note.rate_hz > 0.0 for note in notes)


def test_steps_of_a_search_are_told_as_well() -> None:
    told: list[Progress] = []
    heard: list[str] = []
    path, *_ = sorted((SAMPLES / "validation").glob("*.parquet"))
    with heard_by(lambda done, total, text: heard.append(text)):
        discover.diagnose(path, ROBOT, GOLDEN, on_progress=told.append)
    steps = [one for one in told if one.state == "step"]
    assert [one.text for one in steps] == heard  # whoever listens outside hears them
    assert "choosing effects" in heard
    assert all(0 <= one.done <= one.total for one in steps)
    assert [one.log for one in told if one.state == "done"] == [str(path)]


def test_logs_that_fail_are_left_out_of_one_least_squares(tmp_path: Path) -> None:
    broken = tmp_path / "broken.parquet"
    broken.write_bytes(b"PAR1 and no more")
    logs = [broken, *sorted((SAMPLES / "inertia").glob("*.parquet"))]
    with pytest.raises(InputError, match="broken"):
        identify.simultaneous(logs, ROBOT)
    options = identify.SimultaneousOptions(skip_failed=True)
    with pytest.warns(SeqidWarning, match="left out: .*broken"):
        file = identify.simultaneous(logs, ROBOT, (), options)
    assert [log.path for log in file.inputs] == [str(log) for log in logs[1:]]


def test_problems_are_exceptions_and_warnings_pythons(
    tmp_path: Path, friction: ParameterFile
) -> None:
    with pytest.raises(InputError, match="does not exist"):
        identify.friction(tmp_path / "none.parquet", ROBOT)
    damaged = tmp_path / "damaged.json"
    damaged.write_text("{")
    with pytest.raises(ConfigError):
        identify.gravity(SAMPLES / "gravity", ROBOT, damaged)
    other = tmp_path / "robot.toml"
    other.write_text(ROBOT.read_text().replace("gear_ratio = ", "gear_ratio = 2"))
    with pytest.warns(SeqidWarning):
        identify.gravity(SAMPLES / "gravity", other, friction)


@pytest.mark.parametrize("logs", [[], ()])
def test_no_log_is_said_to_be_none(logs: list[Path]) -> None:
    with pytest.raises(UsageError, match="no log is given"):
        identify.friction(logs, ROBOT)
    with pytest.raises(UsageError, match="no log is given"):
        discover.diagnose(logs, ROBOT, GOLDEN)


def test_the_package_is_light_until_it_is_used() -> None:
    text = (
        "import sys, seqid_cli as s; s.identify.friction; s.discover.refine;"
        " s.inspect.inspect; s.plan.plan; s.report.report; s.export.export;"
        " s.compare.compare;print(sorted({'numpy', 'scipy', 'pyarrow', 'pinocchio',"
        " 'jinja2'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


def test_documents_show_themselves_and_plots_are_the_reports_drawings() -> None:
    file = msgspec.json.decode(GOLDEN.read_bytes(), type=ParameterFile)
    shown = file._repr_html_()
    assert "<table" in shown
    assert "joint_1" in shown
    drawn = report.plot_friction(file, "joint_1")
    assert len(drawn.svg) == 3
    assert all(svg.startswith("<svg") for svg in drawn.svg)
    assert "srcdoc=" in drawn._repr_html_()
    # escaped: the report's style stays in its frame
    assert "<svg" not in drawn._repr_html_()
    with pytest.raises(UsageError, match="no friction of 'elbow'"):
        report.plot_friction(file, "elbow")
    found = diagnosis_file()
    parts = [*found.findings, *found.unexplained]
    assert len(report.plot_evidence(found).svg) == sum(
        part.evidence is not None for part in parts
    )


def test_both_names_are_one_package() -> None:
    """Classes of both are the same, and completion shows what there is."""
    import seqid

    assert seqid.identify is identify
    assert seqid.__version__ == seqid_cli.__version__
    assert {"load", "table", "identify", "plan"} <= set(dir(seqid))
    assert dir(seqid) == dir(seqid_cli)
    with pytest.raises(AttributeError, match="no attribute 'identity'"):
        _ = seqid.identity


def test_load_reads_documents_and_robots(tmp_path: Path) -> None:
    assert seqid_cli.load(GOLDEN) == read_parameters(GOLDEN)
    assert seqid_cli.load(str(ROBOT)).joint_names == ("joint_1",)
    path = tmp_path / "inspection.json"
    inspect.inspect(SAMPLES / "friction", ROBOT, output=path)
    inspection = seqid_cli.load(path)
    assert isinstance(inspection, InspectionFile)
    assert encode(inspection) == path.read_text()
    with pytest.raises(ConfigError, match="nowhere"):
        seqid_cli.load("nowhere.json")


def test_a_shell_shows_one_line() -> None:
    document, robot = seqid_cli.load(GOLDEN), seqid_cli.load(ROBOT)
    (path,) = (SAMPLES / "friction").glob("*.parquet")
    log = read_recording(path, robot)
    assert (
        repr(document) == "<ParameterFile: one_joint, friction, gravity, imu, inertia>"
    )
    assert repr(robot) == "<Robot one_joint: joint_1>"
    assert repr(log).startswith("<Recording joint_1.parquet: ")
    assert max(len(repr(shown)) for shown in (document, robot, log)) < 120


def test_documents_are_tables() -> None:
    """Lists are tables by their place; structures by name have their name in `key`."""
    document = seqid_cli.load(GOLDEN)
    tables = document.tables()
    parameters = tables["stages.inertia.parameters"]
    assert parameters["value"].to_pylist() == [
        parameter.value for parameter in document.stages.inertia.parameters
    ]
    assert tables["stages.friction.joints"]["key"].to_pylist() == ["joint_1"]
    speeds = tables["stages.friction.joints.joint_1.speeds"]
    assert speeds["speed"].to_pylist() == [
        level.speed for level in document.stages.friction.joints["joint_1"].speeds
    ]


@pytest.mark.slow
def test_a_log_is_a_table_and_back() -> None:
    """The table of a log is a log itself, and so is a dictionary of its arrays."""
    (path,) = (SAMPLES / "friction").glob("*.parquet")
    table = seqid_cli.table(path, ROBOT)
    robot = load_robot(ROBOT)
    recording = read_recording(path, robot)
    assert table["joint_1.position"].to_numpy() == pytest.approx(recording.q[:, 0])
    again = seqid_cli.table(table.drop_columns(["valid"]), ROBOT)
    for name in ("t", "joint_1.position", "joint_1.torque"):
        assert again[name].to_numpy() == pytest.approx(table[name].to_numpy(), abs=1e-9)
    arrays = {name: table[name].to_numpy() for name in table.column_names[:1]}
    arrays |= {
        "joint_1.position": recording.q[:, 0],
        "joint_1.torque": recording.tau[:, 0],
    }
    assert seqid_cli.table(arrays, ROBOT).num_rows == table.num_rows


def test_friction_as_arrays(friction: ParameterFile) -> None:
    joint = friction.stages.friction.joints["joint_1"]
    speed = np.linspace(joint.speed_range[0], joint.speed_range[1], 5)
    position = np.array([[0.0], [0.2]])
    values = identify.friction_values(friction, "joint_1", position, speed)
    surface = FrictionSurface.from_stage(joint)
    assert values.torque.shape == (2, 5)
    assert values.torque[1] == pytest.approx(surface.torque(np.full(5, 0.2), speed))
    assert (values.std_error > 0.0).all()
    assert not values.outside.any()
    with pytest.raises(UsageError, match="no friction of 'elbow'"):
        identify.friction_values(friction, "elbow", 0.0, 1.0)
