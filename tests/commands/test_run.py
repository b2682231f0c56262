"""The whole way: `seqid run`, resumed where it stopped; results that repeat to the last
bit.

It opens no connection and starts no other program.
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest

from seqid_cli.__main__ import main
from seqid_cli.commands.run_logs import FOLDERS
from seqid_cli.commands.run_record import Record
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests import ROOT
from tests.commands.conftest import ONE_JOINT
from tests.unit.params.generate import json_schema

NAMES = ("friction", "gravity", "imu", "inertia", "prediction", "diagnosis", "refined")
WATCH = """
import sys

def watch(event, arguments):
    if event.startswith(("socket.connect", "socket.bind", "socket.getaddrinfo",
                         "subprocess.", "os.system", "os.exec", "os.posix_spawn",
                         "os.spawn", "pickle.find_class", "urllib.", "ftplib.",
                         "smtplib.", "webbrowser.")):
        sys.stderr.write(f"FORBIDDEN {event} {arguments}\\n")

sys.addaudithook(watch)
"""
URDF = """
<robot name="one_joint"><link name="base"/><link name="arm"/>
<joint name="joint_1" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-2.6" upper="2.6" velocity="8" effort="1"/></joint></robot>
"""
MAIN = """
from seqid_cli.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def watched(code: str, *words: str, folder: Path = ROOT) -> str:
    """What a command says on stderr whose process tells of every way out that
    it takes.
    """
    command = [sys.executable, "-W", "error", "-c", WATCH + code + MAIN, *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def run(folder: Path, *more: str, robot: str = "logs/robot.toml") -> int:
    """Run all stages on `logs` in a folder."""
    logs, file = str(folder / "logs"), str(folder / robot)
    return main(["run", logs, "-r", file, "-o", str(folder / "out"), *more])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a sample robot, old ones, what `seqid run` makes of them there and what
    it said.
    """
    folder = tmp_path_factory.mktemp("lab")
    shutil.copytree(ONE_JOINT, folder / "logs")
    for path in (folder / "logs").rglob("*"):
        os.utime(path, (1e9, 1e9))
    words = ["run", "logs", "-r", "logs/robot.toml", "-o", "out"]
    (folder / "said.txt").write_text(watched("", *words, folder=folder))
    return folder


def test_the_whole_way_keeps_to_itself(lab: Path) -> None:
    assert "FORBIDDEN" not in (lab / "said.txt").read_text()
    assert "FORBIDDEN os.system" in watched("import os; os.system('true')", "--version")


def written(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "out").iterdir()}


def test_the_files_are_those_of_the_single_commands(lab: Path) -> None:
    out = lab / "out"
    files = {
        *(f"{name}.json" for name in NAMES),
        "torques.parquet",
        "report.html",
        ".run.json",
    }
    assert {path.name for path in out.iterdir()} == files
    alone = out.parent / "alone.json"
    command = [
        "friction",
        str(lab / "logs" / "friction"),
        "-r",
        str(lab / "logs" / "robot.toml"),
    ]
    assert main([*command, "-o", str(alone)]) == 0
    one, other = (
        json.loads(p.read_text())["stages"] for p in (alone, out / "friction.json")
    )
    assert one == other


def test_every_file_keeps_to_its_schema_and_says_what_was_found(lab: Path) -> None:
    out = lab / "out"
    schemas = {"prediction": PREDICTION_SCHEMA, "diagnosis": DIAGNOSIS_SCHEMA}
    documents = {name: json.loads((out / f"{name}.json").read_text()) for name in NAMES}
    for name, document in documents.items():
        jsonschema.validate(document, json_schema(schemas.get(name, SCHEMA)))
    inputs = read_parameters(out / "inertia.json").inputs
    assert {log.stage for log in inputs} == {"friction", "gravity", "imu", "inertia"}
    prediction, diagnosis = documents["prediction"], documents["diagnosis"]
    assert prediction["joints"]["joint_1"]["relative_rmse"] < 0.1
    rows = sum(log["samples"] for log in prediction["logs"])
    assert pq.read_metadata(out / "torques.parquet").num_rows == rows
    joint = diagnosis["joints"]["joint_1"]
    assert 0.0 < joint["noise_floor"] <= 1.2 * joint["rmse"]
    assert diagnosis["verdict"] == "nothing_missing"


@pytest.fixture
def copied(lab: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The lab with its results in the working folder, as its own run has seen it."""
    folder = Path(shutil.copytree(lab, tmp_path / "lab"))
    monkeypatch.chdir(folder)
    return folder


def kept_steps(
    capsys: pytest.CaptureFixture[str], *words: str
) -> tuple[list[str], list[str]]:
    """Run a command with --json; return the commands whose results were kept,
    and made.
    """
    capsys.readouterr()
    assert main([*words, "--json", "-q"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] in ("good", "usable")
    kept = [step["command"] for step in document["steps"] if step["kept"]]
    return kept, [step["command"] for step in document["steps"] if not step["kept"]]


ON_VALIDATION = ["predict", "diagnose", "refine", "report"]
ALL_STEPS = ["friction", "gravity", "imu-calib", "inertia", *ON_VALIDATION]


@pytest.mark.slow
def test_a_result_is_kept_while_content_options_and_version_are_the_same(
    copied: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["run", "logs", "-o", "out"]
    before = written(copied)

    # Neither times nor the number of processes count.
    for path in (copied / "logs").rglob("*"):
        os.utime(path)
    assert kept_steps(capsys, *words, "--jobs", "1") == (ALL_STEPS, [])
    assert written(copied) == before

    # A log of the same size and time with another byte counts; so does one more, or one
    # less.
    log = next((copied / "logs" / "validation").iterdir())
    times = log.stat().st_atime_ns, log.stat().st_mtime_ns
    content = log.read_bytes()
    other = content.replace(b"parquet-cpp", b"parquet-cpq", 1)
    assert len(other) == len(content)
    assert other != content
    log.write_bytes(other)
    os.utime(log, ns=times)
    assert kept_steps(capsys, *words) == (ALL_STEPS[:4], ON_VALIDATION)
    log.unlink()
    assert kept_steps(capsys, *words) == (ALL_STEPS[:4], ON_VALIDATION)

    # A result that somebody edited is none of the run's. Made again it has the same
    # bytes, so that the report stays.
    diagnosis = copied / "out" / "diagnosis.json"
    diagnosis.write_text(diagnosis.read_text() + "\n")
    assert kept_steps(capsys, *words)[1] == ["diagnose"]

    # Without refine its file stays, but is not part of the run.
    assert kept_steps(capsys, *words, "--no-refine")[1] == ["report"]

    # What another version has made is made anew.
    record = Record(Path("out"))
    step = json.loads((copied / "out" / ".run.json").read_text())["steps"][
        "friction.json"
    ]
    made = step["command_line"], [Path("logs/friction"), Path("logs/robot.toml")]
    assert record.kept(*made, [Path("out/friction.json")]) is not None
    monkeypatch.setattr("seqid_cli.commands.run_record.__version__", "0.0.0")
    assert record.kept(*made, [Path("out/friction.json")]) is None


def rewrite_verdicts(out: Path, level: str) -> None:
    """Give all verdicts of a run's results one level, as if the run had found and kept
    them.
    """
    record = json.loads((out / ".run.json").read_text())
    for name in ("friction", "gravity", "imu", "inertia", "prediction", "refined"):
        path = out / f"{name}.json"
        document = json.loads(path.read_text())
        stages = document["stages"]  # a prediction names those of its model
        parts = [document, document.get("closed_loop")]
        parts += stages.values() if isinstance(stages, dict) else []
        for part in parts:
            for verdict in part.get("verdicts", []) if isinstance(part, dict) else []:
                verdict |= {
                    "good": level == "good",
                    "level": level,
                    "reason": "leaves 4 %",
                }
        path.write_text(json.dumps(document))
    for step in record["steps"].values():
        for content in [*step["inputs"], *step["outputs"]]:
            path = out.parent / content["path"]
            content["size"] = path.stat().st_size
            content["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    (out / ".run.json").write_text(json.dumps(record))


@pytest.mark.slow
def test_it_ends_with_the_worst_verdict(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last line on the screen; --strict counts what is only usable."""
    command = ["run", "logs", "-o", "out"]
    assert main(command) == 0
    assert "robot file: logs/robot.toml (beside the logs" in capsys.readouterr().err
    everywhere = "friction, gravity, imu-calib, inertia, predict"
    for level, strict, code in (
        ("good", True, 0),
        ("usable", False, 0),
        ("usable", True, 1),
        ("poor", False, 1),
    ):
        rewrite_verdicts(copied / "out", level)
        assert (
            main([*command, "--keep-going", *(["--strict"] if strict else [])]) == code
        )
        shown = capsys.readouterr()
        assert "--- " not in shown.err  # all is kept
        last = shown.out.splitlines()[-1]
        assert last.startswith(
            "run: good" if level == "good" else f"run: {level}: {everywhere}"
        )
        assert level == "good" or f"predict: {level}: joint_1: leaves 4 %" in shown.err


@pytest.mark.slow
def test_an_unsorted_folder_is_sorted_and_some_logs_are_held_out(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mixed"
    folder.mkdir()
    for stage in FOLDERS:
        for log in (lab / "logs" / stage).iterdir():
            shutil.copy(log, folder / f"{stage}_{log.name}")
    shutil.copy(lab / "logs" / "robot.toml", folder)
    words = ["run", str(folder), "-o", str(folder / "results")]
    words += ["--keep-going", "--no-refine"]
    main(words)
    shown = capsys.readouterr()
    lines = dict(
        line.split(": ", 1) for line in shown.err.splitlines() if line.count(": ") == 1
    )
    assert "friction_joint_1.parquet" in lines["friction"]
    assert "validation" not in lines["friction"]
    held_out = lines["held out, for predict, diagnose and refine"].split(", ")
    assert held_out
    assert not any(log in lines["inertia"] for log in held_out)
    assert shown.out.splitlines()[-1].startswith("run: ")

    # The results lie among the logs, and are none of them.
    assert (folder / "results" / "torques.parquet").is_file()
    main([*words, "--json"])
    assert all(step["kept"] for step in json.loads(capsys.readouterr().out)["steps"])


def test_it_stops_at_the_first_poor_stage_also_when_resumed(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (lab / "logs" / "robot.toml").read_text()
    line = next(line for line in text.splitlines() if line.startswith("gear_ratio"))
    turned = text.replace(line, line.replace("= ", "= -"))
    folder = Path(shutil.copytree(lab / "logs", tmp_path / "logs")).parent
    (folder / "turned.toml").write_text(turned)
    for _ in range(2):
        assert run(folder, robot="turned.toml") == 1
        shown = capsys.readouterr()
        assert "stopped at friction" in shown.err
        assert shown.out.splitlines()[-1] == "run: poor: friction"
        assert "it would drive the joint" in shown.out + shown.err
        made = {path.name for path in (folder / "out").iterdir()}
        assert made == {"friction.json", ".run.json"}


@pytest.mark.slow
def test_a_robot_file_is_made_of_a_urdf_and_then_kept(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = copied / "logs" / "robot.toml"
    urdf = copied / "arm.urdf"
    urdf.write_text(URDF)
    text = robot.read_text()
    robot.unlink()
    words = ["run", "logs", "--urdf", str(urdf), "-o", "out", "--no-refine"]
    assert main(words) == 2  # the drive's constants are not in a URDF
    assert "torque_constant and gear_ratio" in capsys.readouterr().err
    made = copied / "out" / "robot.toml"
    assert made.is_file()
    made.write_text(text)
    main(words)
    assert "robot.toml, made by an earlier run, kept" in capsys.readouterr().err
    assert made.read_text() == text
    assert main([*words, "-r", str(made)]) == 2
    assert "either -r or --urdf" in capsys.readouterr().err


# when a file and the models that it used were made
OF_THE_RUN = ("created", "parameters")


def lines(lab: Path, out: Path) -> Iterator[list[str]]:
    """The command lines of a run one by one, logs the other way round, work in two
    processes.
    """
    robot, before = ["-r", "logs/robot.toml"], list[str]()
    for command, result, *stages in (
        ("friction", "friction", "friction"),
        ("gravity", "gravity", "gravity", "friction"),
        ("imu-calib", "imu", "imu"),
        ("inertia", "inertia", "inertia"),
        ("predict", "prediction", "validation"),
        ("diagnose", "diagnosis", "validation"),
    ):
        logs = [
            str(log.relative_to(lab))
            for stage in stages
            for log in (lab / "logs" / stage).iterdir()
        ]
        made = str(out / f"{result}.json")
        many = [] if command == "diagnose" else ["--jobs", "2"]
        yield [command, *sorted(logs, reverse=True), *robot, *before, *many, "-o", made]
        before = before if command == "predict" else ["-p", made]


def told(path: Path) -> str:
    document = json.loads(path.read_text("utf-8").replace(str(path.parent), ""))
    return json.dumps(
        {key: own for key, own in document.items() if key not in OF_THE_RUN}
    )


@pytest.mark.slow
def test_threads_processes_and_the_order_of_logs_change_no_bit(
    lab: Path, tmp_path: Path
) -> None:
    commands = (
        "import json, sys; from seqid_cli.__main__ import main\n"
        + "for line in json.loads(sys.argv[1]): assert main(line) == 0"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "2"}
    command = [sys.executable, "-c", commands, json.dumps(list(lines(lab, tmp_path)))]
    subprocess.run(command, cwd=lab, env=environment, check=True, capture_output=True)
    for name in NAMES[:-1]:
        assert told(tmp_path / f"{name}.json") == told(lab / "out" / f"{name}.json"), (
            name
        )


def test_blas_has_one_thread(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert main(["completion", "bash"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
