"""What export writes is run over logs: it passes, and what is spoilt is found."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from seqid_cli.__main__ import main
from seqid_cli.export import export
from seqid_cli.export.motions import FullModel, find_logs, motions_of
from seqid_cli.export.reduced import lost_torque
from seqid_cli.export.replay import failures, replayed
from seqid_cli.export.written import code as code_readers
from seqid_cli.export.written.arm import UnreadableFormError
from seqid_cli.export.written.code import compiler
from seqid_cli.export.written.model_files import MujocoArm, PinocchioMjcfArm
from seqid_cli.export.written.read import read_written
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.export import ExportFile, ReplayedJoint
from seqid_cli.params.schema import InputLog
from seqid_cli.robot.file import load_robot
from tests.unit.export.logged import DRAG, Logged, logged
from tests.unit.export.plants import CASES, Recorded, recorded

RIGS = ("one_joint", "two_joint")
NAMES = {
    "C header": "arm.h",
    "numpy module": "arm.py",
    "URDF": "arm.urdf",
    "MJCF": "arm.xml",
    "ROS 2 parameters": "arm.yaml",
}
REDUCED = ("URDF", "MJCF", "ROS 2 parameters")
needs_cc = pytest.mark.skipif(compiler() is None, reason="no C compiler here")
FORMS = [
    pytest.param(kind, marks=needs_cc if kind == "C header" else ()) for kind in NAMES
]


@pytest.fixture(autouse=True)
def quick_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """A module for numpy is run on the first seconds of a log: Python takes its time."""
    monkeypatch.setattr(code_readers, "MOST_IN_PYTHON", 900)


@pytest.fixture(params=RIGS)
def dragged(request: pytest.FixtureRequest, tmp_path: Path) -> Logged:
    return logged(tmp_path, request.param, [DRAG])


def exported(case: Logged, kind: str, **more: object) -> ExportFile:
    return export(case.file, case.robot, case.folder / NAMES[kind], **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", FORMS)
def test_what_was_written_is_as_good_as_it_states(dragged: Logged, kind: str) -> None:
    file = exported(dragged, kind)
    assert file.replay is not None
    assert file.replay.passed, file.replay.failures
    assert file.replay.logs == [str(dragged.held_out)]
    for joint in file.replay.joints.values():
        assert joint.samples > 500
        if kind not in REDUCED:
            assert joint.loss is None
            assert joint.export_rmse == pytest.approx(joint.file_rmse, rel=0.02)


@pytest.mark.parametrize("kind", REDUCED)
def test_the_stated_loss_is_right_on_another_log(dragged: Logged, kind: str) -> None:
    """By the torques themselves: the file's own minus that of the written file, read
    again.
    """
    file = exported(dragged, kind)
    robot = load_robot(dragged.robot)
    full = FullModel.of(robot, read_parameters(dragged.file).stages)
    # A log of exactly the file's torque: what the written form errs there is what it
    # loses.
    found = replayed(dragged.folder / NAMES[kind], kind, full, [dragged.other], {})
    joint = found[robot.joint_names[0]]
    assert joint.export_rmse is not None
    assert joint.file_rmse is not None
    lost = np.sqrt(joint.export_rmse**2 - joint.file_rmse**2)
    assert file.loss[robot.joint_names[0]] == pytest.approx(lost, rel=0.1)
    assert file.refitted


def test_the_fit_loses_less_than_the_numbers_of_the_file(dragged: Logged) -> None:
    from seqid_cli.export.model import export_model

    fitted = exported(dragged, "URDF")
    robot, stages = load_robot(dragged.robot), read_parameters(dragged.file).stages
    full = FullModel.of(robot, stages)
    motions = motions_of(
        full, read_parameters(dragged.file).inputs, [], [dragged.folder]
    )
    plain = export_model(robot, stages, (), None)
    left = lost_torque(plain, list(motions.samples(full)), plain.added)
    first = robot.joint_names[0]
    assert fitted.loss[first] < 0.7 * left[0]


def test_without_effects_nothing_changes_but_what_is_stated(tmp_path: Path) -> None:
    case = logged(tmp_path, "two_joint")
    file = exported(case, "URDF")
    before = exported(case, "URDF", no_replay=True)
    alone = structs.replace(read_parameters(case.file), inputs=[])
    without_logs = export(alone, case.robot, case.folder / "alone.urdf")
    assert not file.refitted
    assert file.joints == before.joints == without_logs.joints
    for name, loss in file.loss.items():
        friction = file.joints[name].friction
        assert friction is not None
        assert 0.0 < loss < 0.2 * friction.rms


SPOILT: dict[str, Callable[[str], str]] = {
    "URDF": lambda text: re.sub(r'damping="[^"]*"', 'damping="9.0"', text),
    "MJCF": lambda text: re.sub(r'armature="[^"]*"', 'armature="5.0"', text),
    "ROS 2 parameters": lambda text: re.sub(r"coulomb: .*", "coulomb: 7.0", text),
    "C header": lambda text: text.replace("tanh(", "3.0 * tanh("),
    "numpy module": lambda text: text.replace("np.tanh(", "3.0 * np.tanh("),
}


@pytest.mark.parametrize("kind", FORMS)
def test_a_file_that_is_spoilt_by_hand_is_found(dragged: Logged, kind: str) -> None:
    file = exported(dragged, kind)
    robot = load_robot(dragged.robot)
    full = FullModel.of(robot, read_parameters(dragged.file).stages)
    path = dragged.folder / NAMES[kind]
    spoilt = SPOILT[kind](path.read_text(encoding="utf-8"))
    assert spoilt != path.read_text(encoding="utf-8")
    path.write_text(spoilt, encoding="utf-8")
    found = replayed(path, kind, full, [dragged.held_out], file.loss)
    first, *_ = failures(found, robot, path)
    joint = found[robot.joint_names[0]]
    for part in (str(path), robot.joint_names[0], f"{joint.export_rmse:.3g} N m"):
        assert part in first
    assert f"the parameter file by {joint.file_rmse:.3g} N m" in first


def run(
    case: Logged, *words: str, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str, str]:
    code = main(["export", str(case.file), "-r", str(case.robot), *words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_the_command_exits_with_1_and_keeps_what_it_wrote(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    case = logged(tmp_path, "one_joint", [DRAG])
    write = Path.read_text

    def spoilt(path: Path, *args: object, **more: object) -> str:
        text = write(path, *args, **more)  # type: ignore[arg-type]
        return SPOILT["URDF"](text) if path.suffix == ".urdf" else text

    target = case.folder / "arm.urdf"
    # The file as it lies there, spoilt between writing and reading.
    monkeypatch.setattr(Path, "read_text", spoilt)
    code, _, err = run(case, "-o", str(target), capsys=capsys)
    assert code == 1
    assert "joint_1: the written form errs by" in err
    assert "do: export again" in err
    assert target.is_file()


def test_the_command_says_what_it_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = logged(tmp_path, "one_joint", [DRAG])
    target = str(case.folder / "arm.urdf")
    code, out, err = run(case, "-o", target, capsys=capsys)
    assert code == 0
    assert "replayed over 1 log" in out
    code, out, _ = run(case, "-o", target, "--json", capsys=capsys)
    document = json.loads(out)
    joint = document["replay"]["joints"]["joint_1"]
    assert set(joint) == {"file_rmse", "export_rmse", "loss", "samples"}
    lost = document["loss"]["joint_1"]
    assert joint["loss"] == pytest.approx(lost, rel=0.2)
    assert f"joint_1: loses {lost:.3g} N m" in Path(target).read_text(encoding="utf-8")
    code, out, err = run(case, "-o", target, "--no-replay", capsys=capsys)
    assert code == 0
    assert "nothing was checked against logs (--no-replay)" in err
    assert "replayed" not in out
    code, out, _ = run(
        case, "-o", target, "--replay", str(case.other), "--json", capsys=capsys
    )
    assert json.loads(out)["replay"]["logs"] == [str(case.other)]
    code, _, err = run(
        case, "-o", target, "--replay", "x", "--no-replay", capsys=capsys
    )
    assert code == 2
    assert "exclude each other" in err


def test_without_a_held_out_log_it_says_so(tmp_path: Path) -> None:
    case = logged(tmp_path, "one_joint", [DRAG])
    file = structs.replace(read_parameters(case.file), closed_loop=None)
    done = export(file, case.robot, case.folder / "arm.yaml")
    assert done.replay is None
    assert "nothing was checked against logs: the file has no held-out log" in str(
        done.notes
    )


def test_logs_that_are_gone_are_replaced_by_made_motions(tmp_path: Path) -> None:
    case = logged(tmp_path, "two_joint", [DRAG])
    there = exported(case, "URDF")
    case.training.unlink()
    case.held_out.write_bytes(case.other.read_bytes())
    file = exported(case, "URDF")
    notes = " ".join(file.notes)
    assert "none of the file's logs is there: motions made within" in notes
    assert "held_out.parquet has another content than when it was used" in notes
    assert (
        "nothing was checked against logs: none of the held-out logs is there" in notes
    )
    assert file.fitted_on == [f"made motion {k}" for k in (1, 2, 3)]
    assert file.refitted
    # Another motion, but of the same speeds: about as much is lost.
    for name, loss in there.loss.items():
        assert file.loss[name] == pytest.approx(loss, rel=1.0, abs=0.05)


def test_logs_are_found_by_their_content(tmp_path: Path) -> None:
    case = logged(tmp_path, "one_joint")
    file = read_parameters(case.file)
    (entry,) = file.inputs
    moved = tmp_path / "moved"
    moved.mkdir()
    case.training.rename(moved / case.training.name)
    assert find_logs([entry], [tmp_path]).files == ()
    assert find_logs([entry], [moved]).files == (moved / case.training.name,)
    deep = InputLog(path="elsewhere/training.parquet", sha256=entry.sha256, samples=1)
    assert find_logs([deep], [moved]).files == (moved / case.training.name,)


def test_mjcf_is_read_by_pinocchio_as_by_mujoco(tmp_path: Path) -> None:
    spring = ("spring", 1, {"cubic": 0.0}, [3.0, -1.0])
    case = logged(tmp_path, "two_joint", [spring])
    file = exported(case, "MJCF")
    assert file.replay is not None
    assert file.replay.passed
    robot, path = load_robot(case.robot), case.folder / "arm.xml"
    rng = np.random.default_rng(2)
    states = rng.normal(size=(3, 20, 2))
    one, other = MujocoArm(path, robot), PinocchioMjcfArm(path, robot)
    np.testing.assert_allclose(one.rigid(*states), other.rigid(*states), atol=1e-8)
    np.testing.assert_allclose(one.friction(*states[:2]), other.friction(*states[:2]))


def test_a_form_without_a_compiler_is_not_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = logged(tmp_path, "one_joint")
    monkeypatch.setattr(code_readers, "COMPILERS", ("no-such-compiler",))
    file = exported(case, "C header")
    assert file.replay is None
    assert "no C compiler is here" in " ".join(file.notes)


def test_what_does_not_compile_is_said(tmp_path: Path) -> None:
    path = tmp_path / "arm.h"
    path.write_text("this is no C\n", encoding="utf-8")
    case = logged(tmp_path, "one_joint")
    if compiler() is None:
        pytest.skip("no C compiler here")
    robot = load_robot(case.robot)
    with (
        pytest.raises(UnreadableFormError, match="does not compile"),
        read_written(path, "C header", robot),
    ):
        pass


def test_a_joint_that_does_not_slide_is_not_judged() -> None:
    still = ReplayedJoint(file_rmse=None, export_rmse=None, loss=0.1, samples=0)
    robot = load_robot(Path(logged.__globals__["SAMPLES"]) / "one_joint" / "robot.toml")
    assert failures({"joint_1": still}, robot, Path("arm.urdf")) == []


# ---- simulated robots, identified and refined from their logs


@pytest.fixture(scope="module", params=CASES)
def plant(request: pytest.FixtureRequest) -> Recorded:
    return recorded(request.param)


def errors(file: ExportFile) -> dict[str, float]:
    assert file.replay is not None
    return {
        name: joint.export_rmse or 0.0 for name, joint in file.replay.joints.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["URDF", "MJCF"])
def test_a_refined_plant_in_a_model_file(plant: Recorded, kind: str) -> None:
    """Never worse than the unrefined one, and what it loses is right on other logs."""
    target = plant.folder / NAMES[kind]
    before = export(plant.simultaneous, plant.robot, target, replay=plant.held_out)
    after = export(plant.refined, plant.robot, target)
    assert after.replay is not None
    assert after.replay.passed, after.replay.failures
    old = errors(before)
    for name, error in errors(after).items():
        assert error <= 1.02 * old[name], name  # two percent: of the noise in the logs
    robot = load_robot(plant.robot)
    full = FullModel.of(robot, read_parameters(plant.refined).stages)
    found = replayed(target, kind, full, plant.others, {})
    most = max(after.loss, key=lambda name: after.loss[name] or 0.0)
    for name, joint in found.items():
        assert joint.export_rmse is not None
        assert joint.file_rmse is not None
        stated = np.hypot(joint.file_rmse, after.loss[name] or 0.0)
        # Five drawn motions of 20 s each: where little is lost, a few fast moves
        # decide.
        tolerance = 0.1 if name == most else 0.2
        right = joint.export_rmse == pytest.approx(stated, rel=tolerance)
        if robot.n == 6 and name == most and not right:
            pytest.xfail("on six joints the largest loss is right to 18 % only")
        assert right, name


@pytest.mark.slow
@needs_cc
def test_a_refined_plant_in_code(plant: Recorded) -> None:
    done = export(plant.refined, plant.robot, plant.folder / "arm.h")
    assert done.replay is not None
    assert done.replay.passed, done.replay.failures
