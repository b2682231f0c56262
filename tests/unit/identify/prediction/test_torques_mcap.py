"""Torques as MCAP, read back by the readers that others use."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from seqid_cli.identify.prediction.layouts import NAMES, write_layouts
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.identify.prediction.torque_files import TOPICS, mcap_writer
from seqid_cli.robot.file import load_robot
from tests import ROOT
from tests.plants.robots.made import made_prediction

LAYOUTS = ROOT / "docs" / "how-to" / "layouts"
JOINTS = ("shoulder", "elbow_with_a_longer_name", "wrist")
SAMPLES = 40


def prediction(name: str, start: float) -> LogPrediction:
    tau, predicted, q, dq = np.random.default_rng(0).normal(
        size=(4, SAMPLES, len(JOINTS))
    )
    bounds = {"low": predicted - 0.5, "high": predicted + 0.5}
    bounds["std"] = np.full(tau.shape, 0.3)
    return made_prediction(name, tau, predicted, **bounds, q=q, dq=dq, start=start)


def messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, state in reader.iter_decoded_messages():
            yield channel.topic, message.log_time, state


def save(path: Path, *logs: LogPrediction) -> Path:
    with mcap_writer(path, JOINTS) as write:
        for log in logs:
            write(log)
    return path


@pytest.mark.parametrize("name", ["a", "logs/move.parquet"])
def test_torques_read_back(tmp_path: Path, name: str) -> None:
    log = prediction(name, 1_700_000_000.25)
    residual = log.tau - log.predicted
    torques = (log.tau, log.predicted, residual, log.std, log.low, log.high)
    expected = dict(zip(TOPICS, torques, strict=True))
    seen = dict.fromkeys(TOPICS, 0)
    for topic, log_time_ns, state in messages(save(tmp_path / "out.mcap", log)):
        k = seen[topic]
        seen[topic] += 1
        assert tuple(state.name) == JOINTS
        assert state.header.frame_id == name
        wanted = [x[k] for x in (expected[topic], log.q, log.dq)]
        np.testing.assert_array_equal(
            [state.effort, state.position, state.velocity], wanted
        )
        stamp = state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        assert stamp == log_time_ns
        assert abs(stamp - (1_700_000_000_250_000_000 + k * 4_000_000)) < 1000
    assert set(seen.values()) == {SAMPLES}


def times(path: Path) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for _, log_time_ns, state in messages(path):
        found.setdefault(state.header.frame_id, []).append(log_time_ns * 1e-9)
    return found


def test_logs_without_a_clock_follow_each_other(tmp_path: Path) -> None:
    logs = [
        prediction(name, start) for name, start in (("a", 0.0), ("b", 0.0), ("c", -5.0))
    ]
    path = save(tmp_path / "out.mcap", *logs)
    a, b, c = times(path).values()
    assert [a[0], b[0], c[0]] == pytest.approx([0.0, a[-1] + 1.0, b[-1] + 1.0])
    with path.open("rb") as stream:
        records = {r.name: r.metadata for r in make_reader(stream).iter_metadata()}
    assert records["seqid.logs"]["2"].startswith("b: 1.156000 to ")


@pytest.mark.parametrize("start", [float("nan"), 1e30])
def test_a_clock_that_no_stamp_holds_starts_from_zero(
    tmp_path: Path, start: float
) -> None:
    assert times(save(tmp_path / "out.mcap", prediction("a", start)))["a"][0] == 0.0


def shown(folder: Path) -> tuple[list[str], list[str], list[str]]:
    """What layouts show: PlotJuggler's curves, Foxglove's paths, panels in order."""
    layout = ElementTree.parse(folder / "plotjuggler.xml")
    curves = [curve.get("name", "") for curve in layout.iter("curve")]
    document = json.loads((folder / "foxglove.json").read_text())
    panels = document["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel["paths"]]

    def leaves(part: object) -> list[str]:
        if isinstance(part, str):
            return [part]
        assert isinstance(part, dict)
        return leaves(part["first"]) + leaves(part["second"])

    titles = [panels[name]["title"] for name in leaves(document["layout"])]
    return curves, paths, titles


def test_layouts_show_the_topics() -> None:
    curves, paths, _ = shown(LAYOUTS)
    for topic in TOPICS:
        assert f"{topic}/elbow/effort" in curves
        assert f"{topic}.effort[5]" in paths


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7])
def test_layouts_for_a_robot_s_own_joints(tmp_path: Path, count: int) -> None:
    joints = [f'a<{k}>&"' for k in range(count)]  # any name is possible in a URDF
    folder = tmp_path / "new" / "folder"
    assert [path.name for path in write_layouts(folder, joints)] == list(NAMES)
    curves, paths, titles = shown(folder)
    assert titles == joints
    for topic in TOPICS:
        for number, joint in enumerate(joints):
            assert f"{topic}/{joint}/effort" in curves
            assert f"{topic}.effort[{number}]" in paths
    assert len(paths) == len(set(paths)) == count * len(TOPICS)


def test_the_layouts_of_the_documents_are_those_of_the_sample_arm(
    tmp_path: Path,
) -> None:
    joints = load_robot(ROOT / "sample_logs" / "six_joint" / "robot.toml").joint_names
    write_layouts(tmp_path, joints)
    assert shown(tmp_path) == shown(LAYOUTS)
