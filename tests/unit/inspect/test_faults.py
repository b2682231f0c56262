"""Every planted fault leads to its own finding, at the right joint, and to no other."""

from pathlib import Path

import pytest

from seqid_cli.inspect.findings import ERRORS
from tests.unit.inspect.faults import Fault, groups
from tests.unit.inspect.rig import inspect_planted


# Those that share a log are many faults in few inspections: `make test` has them.
@pytest.mark.parametrize(
    "faults",
    [
        pytest.param(own, id=own[0].name, marks=[] if len(own) > 1 else [pytest.mark.slow])
        for own in groups()
    ],
)
def test_a_planted_fault_is_found_and_nothing_else(
    faults: tuple[Fault, ...], tmp_path: Path
) -> None:
    report = inspect_planted(faults, tmp_path)
    found = {(finding.code, finding.joint, finding.message) for finding in report.findings}
    assert {code for code, _, _ in found} == {fault.code for fault in faults}, found
    for fault in faults:
        mine = [f for f in report.findings if (f.code, f.joint) == (fault.code, fault.joint)]
        assert mine, (fault.name, found)
        if fault.channel is not None:
            assert [finding.channel for finding in mine] == [fault.channel]
    if len(faults) > 1 or faults[0].channel is not None:  # one channel each, so one finding each
        assert len(report.findings) == len(faults), found
    faulty = any(fault.code in ERRORS for fault in faults)
    assert report.verdict == ("faulty" if faulty else "usable")
    assert all(finding.remedy and finding.message for finding in report.findings)
