"""What export writes is run over logs: it passes, and what is spoilt is found."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from seqid_cli.__main__ import main
from seqid_cli.export import export
from seqid_cli.export.equations import joint_sums, sum_of
from seqid_cli.export.fitting import Fitting
from seqid_cli.export.loss import LostTorque, written_torque
from seqid_cli.export.model import export_model
from seqid_cli.export.motions import FullModel, find_logs, motions_of
from seqid_cli.export.replay import failures, replayed
from seqid_cli.export.written import code as code_readers
from seqid_cli.export.written.arm import UnreadableFormError
from seqid_cli.export.written.code import compiler
from seqid_cli.export.written.model_files import MujocoArm, PinocchioMjcfArm
from seqid_cli.export.written.read import read_written
from seqid_cli.params.io import read_parameters, write_json_atomic
from seqid_cli.params.results.export import ExportFile, ReplayedJoint
from seqid_cli.params.schema import InputLog, ParameterFile
from seqid_cli.robot.file import load_robot
from tests import Array
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
    """A module for numpy is run on the first seconds of a log:
    Python takes its time.
    """
    monkeypatch.setattr(code_readers, "MOST_IN_PYTHON", 900)


@pytest.fixture(params=RIGS)
def dragged(request: pytest.FixtureRequest, tmp_path: Path) -> Logged:
    return logged(tmp_path, request.param, [DRAG])


def exported(case: Logged, kind: str, **more: object) -> ExportFile:
    return export(case.file, case.robot, case.folder / NAMES[kind], **more)  # type: ignore[arg-type]


def errors(path: Path, kind: str, full: FullModel, logs: Sequence[Path]) -> Array:
    """Return the error (n,) N m of a written file on logs,
    filtered as `full` filters.
    """
    found = replayed(path, kind, full, logs, {})
    return np.array([joint.export_rmse or 0.0 for joint in found.values()])


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("kind", REDUCED)
def test_the_stated_loss_is_right_on_the_held_out_log(
    dragged: Logged, kind: str
) -> None:
    file = exported(dragged, kind)
    assert file.refitted
    lost = loss_of_written(dragged, kind, dragged.held_out)
    assert file.loss["joint_1"] == pytest.approx(lost, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", REDUCED)
def test_the_stated_loss_is_right_on_a_log_that_is_asked_for(
    dragged: Logged, kind: str
) -> None:
    file = exported(dragged, kind, replay=[dragged.other])
    lost = loss_of_written(dragged, kind, dragged.other)
    assert file.loss["joint_1"] == pytest.approx(lost, rel=0.1)


def test_without_held_out_logs_the_loss_is_that_of_left_out_pieces(
    dragged: Logged,
) -> None:
    """More than on the motion of the fit, of which `other` is the same way back."""
    alone = dragged.folder / "alone.json"
    plain = structs.replace(read_parameters(dragged.file), closed_loop=None)
    write_json_atomic(alone, plain)
    file = export(alone, dragged.robot, dragged.folder / "arm.urdf")
    lost = loss_of_written(dragged, "URDF", dragged.other)
    assert file.replay is None
    stated = file.loss["joint_1"]
    assert stated is not None
    assert 1.01 * lost < stated < 1.2 * lost


def loss_of_written(case: Logged, kind: str, log: Path) -> float:
    """Return the RMS [N m] of the file's torque minus that of the written file, read
    again.
    """
    robot = load_robot(case.robot)
    full = FullModel.of(robot, read_parameters(case.file).stages)
    # A log of exactly the file's torque: what the written form errs there is what it
    # loses.
    found = replayed(case.folder / NAMES[kind], kind, full, [log], {})
    joint = found["joint_1"]
    assert joint.export_rmse is not None
    assert joint.file_rmse is not None
    return float(np.sqrt(joint.export_rmse**2 - joint.file_rmse**2))


def test_the_fit_loses_less_than_the_numbers_of_the_file(dragged: Logged) -> None:
    fitted = exported(dragged, "URDF")
    robot, stages = load_robot(dragged.robot), read_parameters(dragged.file).stages
    full = FullModel.of(robot, stages)
    motions = motions_of(
        full, read_parameters(dragged.file).inputs, [], [dragged.folder]
    )
    plain = export_model(robot, stages, (), None)
    left = LostTorque.of(plain, list(motions.samples(full)), plain.added).rms
    first = robot.joint_names[0]
    assert fitted.loss[first] < 0.7 * left[0]


def with_incoming(case: Logged) -> ParameterFile:
    """Return a file of which refinement has changed the effects alone, and says so."""
    file = read_parameters(case.file)
    assert file.closed_loop is not None
    loop = structs.replace(
        file.closed_loop, incoming=structs.replace(file.stages, effects=None)
    )
    changed = structs.replace(file, closed_loop=loop)
    write_json_atomic(case.file, changed)
    return changed


def test_a_joint_without_gain_keeps_its_torque(tmp_path: Path) -> None:
    case = logged(tmp_path, "two_joint", [DRAG])
    file = with_incoming(case)
    done = exported(case, "URDF")
    assert done.replay is not None
    note = "joint_2: the torque of links and friction is that from before"
    assert note in " ".join(done.notes)
    robot = load_robot(case.robot)
    full = FullModel.of(robot, file.stages)
    new = errors(case.folder / "arm.urdf", "URDF", full, [case.other])
    plain = structs.replace(file, stages=file.closed_loop.incoming, closed_loop=None)
    export(plain, case.robot, case.folder / "plain.urdf")
    old = errors(case.folder / "plain.urdf", "URDF", full, [case.other])
    assert new[0] < 0.7 * old[0]
    assert new[1] == pytest.approx(old[1], rel=2e-3)


def test_sums_tell_the_error_of_a_model(tmp_path: Path) -> None:
    """Of whole motions and of their pieces, by both torques."""
    case = logged(tmp_path, "two_joint", [DRAG])
    file = read_parameters(case.file)
    robot = load_robot(case.robot)
    full = FullModel.of(robot, file.stages)
    samples = list(motions_of(full, file.inputs, [], [case.folder]).samples(full))
    model = export_model(robot, file.stages, (), None)
    fitting = Fitting(model=model, stages=file.stages, added=model.added)
    pieces = joint_sums(model, fitting.identified, samples, pieces=3)
    numbers = fitting.numbers(model)
    lost = LostTorque.of(model, samples, model.added).rms
    whole = sum_of(pieces)
    squares = whole.squared_errors(numbers, of_model=True)
    np.testing.assert_allclose(np.sqrt(squares / whole.counts), lost, rtol=1e-5)

    (part,) = samples
    error = part.measured - written_torque(model, part.motion, model.added)
    error = np.where(part.sliding, error, 0.0)
    rows = np.array_split(np.arange(len(error)), 3)[1]
    found = np.sqrt(pieces[1].squared_errors(numbers) / pieces[1].counts)
    expected = np.sqrt(
        np.sum(error[rows] ** 2, axis=0) / part.sliding[rows].sum(axis=0)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-5)


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


@pytest.mark.slow
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


def test_without_logs_a_form_keeps_what_it_had_before_the_refinement(
    tmp_path: Path,
) -> None:
    case = logged(tmp_path, "two_joint", [DRAG])
    file = read_parameters(case.file)
    assert file.closed_loop is not None
    incoming = structs.replace(file.stages, effects=None)
    assert incoming.friction is not None
    loop = structs.replace(file.closed_loop, incoming=incoming)
    write_json_atomic(case.file, structs.replace(file, closed_loop=loop))
    unrefined = tmp_path / "unrefined.json"
    write_json_atomic(
        unrefined, structs.replace(file, stages=incoming, closed_loop=None)
    )
    case.training.unlink()
    case.held_out.unlink()

    kept = exported(case, "URDF")
    before = export(unrefined, case.robot, tmp_path / "unrefined.urdf")
    assert kept.joints == before.joints
    # The drag is lost, and said to be.
    assert kept.loss["joint_1"] > 5.0 * kept.loss["joint_2"]


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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["URDF", "MJCF"])
def test_a_refined_plant_is_never_worse_in_a_model_file(
    plant: Recorded, kind: str
) -> None:
    before, after = (plant.folder / f"{name}_{NAMES[kind]}" for name in ("old", "new"))
    export(plant.simultaneous, plant.robot, before, no_replay=True)
    done = export(plant.refined, plant.robot, after)
    assert done.replay is not None
    assert done.replay.passed, done.replay.failures
    full = FullModel.of(load_robot(plant.robot), read_parameters(plant.refined).stages)
    for logs in (plant.held_out, plant.others):
        old = errors(before, kind, full, logs)
        # Where a joint keeps its torque, it does so to a thousandth or two.
        assert np.all(errors(after, kind, full, logs) <= 1.002 * old)


@pytest.mark.slow
@pytest.mark.parametrize("kind", REDUCED)
def test_a_plant_that_gains_nowhere_is_written_as_before(kind: str) -> None:
    plant = recorded("one_joint")
    before, after = (plant.folder / f"{name}_{NAMES[kind]}" for name in ("old", "new"))
    old = export(plant.simultaneous, plant.robot, before, no_replay=True)
    new = export(plant.refined, plant.robot, after, no_replay=True)
    assert new.joints == old.joints
    assert not new.refitted
    assert "whose numbers are those from before the refinement" in " ".join(new.notes)


@pytest.mark.slow
def test_a_joint_gains_while_the_others_keep_their_torque() -> None:
    """Load-dependent friction of the shoulder is in part what links can say."""
    plant = recorded("six_joint")
    full = FullModel.of(load_robot(plant.robot), read_parameters(plant.refined).stages)
    before, after = plant.folder / "before.urdf", plant.folder / "after.urdf"
    export(plant.simultaneous, plant.robot, before, no_replay=True)
    export(plant.refined, plant.robot, after, no_replay=True)
    old = errors(before, "URDF", full, plant.others)
    change = errors(after, "URDF", full, plant.others) / old
    assert change[1] < 0.97
    np.testing.assert_allclose(np.delete(change, 1), 1.0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["URDF", "MJCF"])
def test_what_a_plant_loses_is_stated(plant: Recorded, kind: str) -> None:
    """Right to ten percent on the logs that are asked for, by their measured torque."""
    target = plant.folder / NAMES[kind]
    done = export(plant.refined, plant.robot, target, replay=plant.others)
    assert done.replay is not None
    for name, joint in done.replay.joints.items():
        assert joint.file_rmse is not None
        assert done.loss[name] == joint.loss
        stated = np.hypot(joint.file_rmse, done.loss[name] or 0.0)
        assert joint.export_rmse == pytest.approx(stated, rel=0.1), name


@pytest.mark.slow
def test_what_a_plant_loses_most_is_known_beforehand(plant: Recorded) -> None:
    """On logs that nobody has asked for: the stated loss, and its range by log."""
    target = plant.folder / "arm.urdf"
    done = export(plant.refined, plant.robot, target)
    robot = load_robot(plant.robot)
    full = FullModel.of(robot, read_parameters(plant.refined).stages)
    found = replayed(target, "URDF", full, plant.others, {})
    most = max(done.loss, key=lambda name: done.loss[name] or 0.0)
    for name, joint in found.items():
        assert joint.export_rmse is not None
        assert joint.file_rmse is not None
        stated = np.hypot(joint.file_rmse, done.loss[name] or 0.0)
        if name == most:
            assert joint.export_rmse == pytest.approx(stated, rel=0.1)
        smallest, largest = np.hypot(joint.file_rmse, done.loss_range[name])
        assert 0.9 * smallest < joint.export_rmse < 1.1 * largest


@pytest.mark.slow
@needs_cc
def test_a_refined_plant_in_code(plant: Recorded) -> None:
    done = export(plant.refined, plant.robot, plant.folder / "arm.h")
    assert done.replay is not None
    assert done.replay.passed, done.replay.failures
