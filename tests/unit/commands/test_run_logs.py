"""Logs of a run that are held out: never one that a pair of joints needs."""

from seqid_cli.commands.run_logs import held_out_of
from seqid_cli.params.results.inspection import InspectedLog


def log(path: str, joints: str, *serves: str) -> InspectedLog:
    """A log in which joints with names of one letter move together."""
    return InspectedLog(
        path=path,
        sha256=path,
        format="parquet",
        verdict="good",
        moving_together=list(joints) if len(joints) > 1 else [],
        serves=list(serves or ("inertia",)),
    )


def held_out(*logs: InspectedLog) -> list[str]:
    return [item.path for item in held_out_of(logs)]


def test_a_pair_that_one_log_alone_has_is_kept() -> None:
    pairs = [log("1", "ab"), log("2", "bc"), log("3", "ac")]
    assert held_out(*pairs) == []
    assert held_out(*pairs, log("4", "abc")) == ["4"]


def test_of_logs_with_all_joints_the_last_is_held_out_and_one_stays() -> None:
    assert held_out(log("1", "abc")) == []
    assert held_out(log("1", "abc"), log("2", "abc")) == ["2"]
    names = [str(k) for k in range(8)]
    assert held_out(*(log(name, "abc") for name in names)) == ["7", "6"]


def test_trials_of_friction_and_gravity_always_stay() -> None:
    trials = [log("1", "a", "friction", "inertia"), log("2", "a", "gravity", "inertia")]
    assert held_out(*trials) == []
    assert held_out(*trials, log("3", "a", "imu-calib", "inertia"), log("4", "a")) == [
        "4"
    ]
