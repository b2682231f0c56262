"""The IMU section says where the motion behind the inertias came from."""

from seqid_cli.params.schema import MotionUse, ParameterFile
from seqid_cli.report.make import make_report
from tests.unit.params.documents import full_file
from tests.unit.report.pages import source


def used(log: str, *warnings: str) -> MotionUse:
    return MotionUse(
        log=log,
        source="fused" if not warnings else "encoder",
        imus=[] if warnings else ["imu_a"],
        cutoff_hz=20.0,
        acceleration_error={"shoulder": 0.0123},
        encoder_error={"shoulder": 0.987},
        warnings=list(warnings),
    )


def page(*uses: MotionUse) -> str:
    file: ParameterFile = full_file()
    file.stages.inertia.motion_use = list(uses)
    return make_report([source("inertia.json", file)]).html


def test_motion_of_every_log_with_its_errors() -> None:
    text = page(used("inertia/a.parquet"), used("inertia/b.parquet", "imu_a is not recorded"))
    assert "Where the motion of the inertia logs came from" in text
    for expected in ("inertia/a.parquet", "fused", "0.012", "0.99", "rad/s\u00b2"):
        assert expected in text
    assert "imu_a is not recorded (inertia/b.parquet)" in text


def test_the_same_remark_on_many_logs_is_one() -> None:
    text = page(*(used(f"{name}.parquet", "imu_a is left out") for name in "ab"))
    assert text.count("imu_a is left out") == 1
    assert "imu_a is left out (a.parquet, b.parquet)" in text


def test_nothing_of_it_without_motion() -> None:
    assert "Where the motion of the inertia logs" not in page()
