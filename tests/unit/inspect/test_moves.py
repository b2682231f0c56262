"""Which stages logs serve, each by itself and all together."""

from seqid_cli.inspect.parts import serve_together
from seqid_cli.params.results.inspection import InspectedJoint, InspectedLog, InspectedMoves


def log(speed: float, *serves: str, backward: int = 1, effort: str = "torque") -> InspectedLog:
    """Return a log of one joint that moves at one speed."""
    joint = InspectedJoint(
        name="elbow",
        moves=True,
        low=-1.0,
        high=1.0,
        top_speed=speed,
        encoder_step=1e-4,
        effort=effort,
        effort_rms=1.0,
        temperature=None,
    )
    moves = InspectedMoves(
        joint="elbow", forward=1, backward=backward, slowest=speed, fastest=speed, postures=1
    )
    return InspectedLog(
        path=f"{speed}",
        sha256="",
        format="csv",
        verdict="good",
        joints=[joint],
        moves=[moves],
        serves=[*serves],
    )


def served(*logs: InspectedLog) -> list[list[str]]:
    return [one.serves for one in serve_together(logs)]


def test_one_log_per_speed_serves_friction_together() -> None:
    assert served(log(0.1, "gravity"), log(0.2), log(0.4)) == [
        ["friction", "gravity"],
        ["friction"],
        ["friction"],
    ]


def test_too_few_speeds_or_one_direction_do_not() -> None:
    assert served(log(0.1), log(0.2), log(0.21)) == [[], [], []]
    assert served(log(0.1), log(0.2), log(0.4, backward=0)) == [[], [], []]
    assert served(log(0.1), log(0.2), log(0.4, effort="")) == [[], [], []]


def test_logs_beside_one_that_serves_by_itself_stay_as_they_are() -> None:
    assert served(log(0.1), log(0.2), log(0.4, "friction")) == [[], [], ["friction"]]
