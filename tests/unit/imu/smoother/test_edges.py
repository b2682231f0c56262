"""Edges of an encoder lie midway between the samples that they are between."""

import numpy as np
import pytest

from seqid_cli.imu.smoother.chunk import encoder_view

STEP = 0.01  # rad


@pytest.mark.parametrize("stride", [1, 2, 3, 4, 8])
def test_edges_stay_midway_however_many_places_a_sample_has(stride: int) -> None:
    codes = STEP * np.repeat(np.arange(6.0), 5)  # one count every five samples
    view = encoder_view(codes, STEP)
    before = np.flatnonzero(np.isfinite(view.edge)) + view.edge_offset
    assert before.tolist() == [4.5, 9.5, 14.5, 19.5, 24.5]  # samples

    refined = view.refined(stride)
    after = np.flatnonzero(np.isfinite(refined.edge)) + refined.edge_offset
    assert (after / stride).tolist() == before.tolist()
