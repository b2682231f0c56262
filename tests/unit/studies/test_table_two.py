"""The twin of Table II: its arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.params.schema import ImuCalibration, ImuStage
from tests.studies import table_two
from tests.studies.table_two import WAYS, faults, range_of, table_of


def test_the_range_holds_95_percent_of_signed_errors() -> None:
    values = np.arange(-100.0, 101.0)
    found = range_of(values.tolist())
    assert found.median == 50.0
    assert [found.low, found.high] == pytest.approx([-95.0, 95.0])


def test_the_table_has_a_row_per_way_and_two_cells_per_encoder() -> None:
    one = dict.fromkeys(WAYS, 0.5)
    text = table_of({1: [one, one], 4: [one]})
    lines = text.splitlines()
    assert len(lines) == 2 + len(WAYS)
    assert "100 counts: median" in lines[0]
    assert "400 counts: median" in lines[0]
    assert lines[2 + list(WAYS).index("imu")].endswith(
        "| 0.50 | 0.50 to 0.50 | 0.50 | 0.50 to 0.50 | 16 |"
    )


def test_sensors_have_faults_of_their_own() -> None:
    first, other = faults(1), faults(2)
    assert not np.array_equal(first.gains(12), other.gains(12))
    assert first.delay > 0
    assert first.gains(12).std() > 1e-3


def test_the_study_is_known_and_its_document_has_its_place() -> None:
    from tests.studies.__main__ import DOCUMENTS, LONG, STUDIES
    from tests.studies.tables import placed

    assert "table_two" in STUDIES
    assert "table_two" in LONG
    text = DOCUMENTS["table_two"].read_text(encoding="utf-8")
    assert "| x |" in placed(text, "table_two", "| x |")
    assert table_two.DOCUMENT.name == "motion.md"


def test_the_options_of_all_studies_go_together() -> None:
    from tests.studies.__main__ import main

    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0


def test_mountings_alone_are_what_the_paper_calibrates() -> None:
    known = ImuCalibration(
        rotation=np.eye(3).tolist(),
        std_error_deg=0.1,
        time_offset_s=0.002,
        accelerometer_bias=[0.2] * 12,
        accelerometer_scale=[1.01] * 12,
    )
    left = table_two.mounting_alone(ImuStage(imus={"imu_a": known})).imus["imu_a"]
    assert left.rotation == known.rotation
    assert left.time_offset_s == 0.0
    assert left.accelerometer_bias == left.accelerometer_scale == []
