"""The whole way: `seqid run`, resumed where it stopped; results that repeat to the last bit.

It opens no connection and starts no other program.
"""

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
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.diagnosis import DIAGNOSIS_SCHEMA
from seqid_cli.params.results.prediction import PREDICTION_SCHEMA
from seqid_cli.params.schema import SCHEMA
from tests import ROOT
from tests.commands.conftest import ONE_JOINT
from tests.unit.params.generate import json_schema

NAMES = ("friction", "gravity", "imu", "inertia", "prediction", "diagnosis")
WATCH = """
import sys

def watch(event, arguments):
    if event.startswith(("socket.connect", "socket.bind", "socket.getaddrinfo", "subprocess.",
                         "os.system", "os.exec", "os.posix_spawn", "os.spawn", "pickle.find_class",
                         "urllib.", "ftplib.", "smtplib.", "webbrowser.")):
        sys.stderr.write(f"FORBIDDEN {event} {arguments}\\n")

sys.addaudithook(watch)
"""
MAIN = """
from seqid_cli.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def watched(code: str, *words: str) -> str:
    """What a command says on stderr whose process tells of every way out that it takes."""
    command = [sys.executable, "-W", "error", "-c", WATCH + code + MAIN, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stderr


def words_of_run(folder: Path, *more: str, robot: str = "logs/robot.toml") -> list[str]:
    """Command line of all stages on `logs` in a folder."""
    logs, file = str(folder / "logs"), str(folder / robot)
    return ["run", logs, "-r", file, "-o", str(folder / "out"), *more]


def run(folder: Path, *more: str, robot: str = "logs/robot.toml") -> int:
    return main(words_of_run(folder, *more, robot=robot))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a sample robot, old ones, what `seqid run` makes of them and what it said."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copytree(ONE_JOINT, folder / "logs")
    for path in (folder / "logs").rglob("*"):
        os.utime(path, (1e9, 1e9))
    (folder / "said.txt").write_text(watched("", *words_of_run(folder)))
    return folder


def test_the_whole_way_keeps_to_itself(lab: Path) -> None:
    assert "FORBIDDEN" not in (lab / "said.txt").read_text()
    assert "FORBIDDEN os.system" in watched("import os; os.system('true')", "--version")


def written(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "out").iterdir()}


def test_the_files_are_those_of_the_single_commands(lab: Path) -> None:
    out = lab / "out"
    files = {*(f"{name}.json" for name in NAMES), "torques.parquet", "report.html"}
    assert {path.name for path in out.iterdir()} == files
    alone = out.parent / "alone.json"
    command = ["friction", str(lab / "logs" / "friction"), "-r", str(lab / "logs" / "robot.toml")]
    assert main([*command, "-o", str(alone)]) == 0
    one, other = (json.loads(p.read_text())["stages"] for p in (alone, out / "friction.json"))
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


def test_only_old_files_are_made_again(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(lab, tmp_path / "lab"))  # with the times of all files
    before = written(folder)
    assert run(folder, "--json") == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert all(step["kept"] and step["good"] for step in steps)
    assert written(folder) == before
    os.utime(next((folder / "logs" / "validation").iterdir()))
    assert run(folder) == 0
    after = written(folder)
    again = {name for name in after if after[name] != before[name]}
    assert again == {"prediction.json", "torques.parquet", "diagnosis.json", "report.html"}


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
        assert "it would drive the joint" in shown.out + shown.err
        assert [path.name for path in (folder / "out").iterdir()] == ["friction.json"]


OF_THE_RUN = ("created", "parameters")  # when a file and the models that it used were made


def lines(lab: Path, out: Path) -> Iterator[list[str]]:
    """The command lines of a run one by one, logs the other way round, work in two processes."""
    robot, before = ["-r", str(lab / "logs" / "robot.toml")], list[str]()
    for command, result, *stages in (
        ("friction", "friction", "friction"),
        ("gravity", "gravity", "gravity", "friction"),
        ("imu-calib", "imu", "imu"),
        ("inertia", "inertia", "inertia"),
        ("predict", "prediction", "validation"),
        ("diagnose", "diagnosis", "validation"),
    ):
        logs = [str(log) for stage in stages for log in (lab / "logs" / stage).iterdir()]
        made = str(out / f"{result}.json")
        many = [] if command == "diagnose" else ["--jobs", "2"]
        yield [command, *sorted(logs, reverse=True), *robot, *before, *many, "-o", made]
        before = before if command == "predict" else ["-p", made]


def told(path: Path) -> str:
    document = json.loads(path.read_text("utf-8").replace(str(path.parent), ""))
    return json.dumps({key: own for key, own in document.items() if key not in OF_THE_RUN})


@pytest.mark.slow
def test_threads_processes_and_the_order_of_logs_change_no_bit(lab: Path, tmp_path: Path) -> None:
    commands = "import json, sys; from seqid_cli.__main__ import main\n" + (
        "for line in json.loads(sys.argv[1]): assert main(line) == 0"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "2"}
    command = [sys.executable, "-c", commands, json.dumps(list(lines(lab, tmp_path)))]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    for name in NAMES:
        assert told(tmp_path / f"{name}.json") == told(lab / "out" / f"{name}.json"), name


def test_blas_has_one_thread(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert main(["completion", "bash"]) == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
