"""Which stages logs serve, each by itself and all together."""

import msgspec
import pytest

from seqid_cli.inspect.parts import serve_together
from seqid_cli.params.results.inspection import InspectedLog


def log(speed: float, *serves: str, backward: int = 1, effort: str = "torque") -> InspectedLog:
    """Return a log of one joint that moves at one speed."""
    unsaid = dict.fromkeys(("encoder_step", "effort_rms", "temperature"))
    moving = {"moves": True, "low": -1.0, "high": 1.0, "top_speed": 1.0, "effort": effort}
    moves = {"joint": "elbow", "forward": 1, "backward": backward, "postures": 1}
    document = {
        "joints": [{"name": "elbow"} | moving | unsaid],
        "moves": [{**moves, "slowest": speed, "fastest": speed}],
        "serves": serves,
    }
    known = {"path": f"{speed}", "sha256": "", "format": "csv", "verdict": "good"}
    return msgspec.convert(known | document, InspectedLog)


@pytest.mark.parametrize(
    ("logs", "served"),
    [
        ([log(0.1, "gravity"), log(0.2), log(0.4)], ["friction gravity", "friction", "friction"]),
        ([log(0.1), log(0.2), log(0.21)], ["", "", ""]),
        ([log(0.1), log(0.2), log(0.4, backward=0)], ["", "", ""]),
        ([log(0.1), log(0.2), log(0.4, effort="")], ["", "", ""]),
        ([log(0.1), log(0.2), log(0.4, "friction")], ["", "", "friction"]),
    ],
    ids=["one log per speed", "two speeds", "one way", "no torque", "one serves alone"],
)
def test_logs_serve_friction_together(logs: list[InspectedLog], served: list[str]) -> None:
    assert [" ".join(one.serves) for one in serve_together(logs)] == served
