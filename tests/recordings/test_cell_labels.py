"""Labelled frames have the class of each occupied cell whose beams are labelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.stream import frame_digest, open_stream


def labelled(scan: Scan, label: int) -> Scan:
    return replace(scan, labels=np.full(scan.ranges.size, label, np.uint8))


def test_frames_have_the_class_of_every_occupied_cell(write, scan) -> None:
    scans = [labelled(scan(k), k % 2) if k < 6 else scan(k) for k in range(9)]
    stream = open_stream(write(scans, classes=["car", "wall"]))
    found = list(stream.labelled())
    assert [frame_digest(item.frame) for item in found] == [frame_digest(frame) for frame in stream]
    for k, (frame, cells, labels) in enumerate(found):
        assert cells.tolist() == (np.flatnonzero(frame.occupied).tolist() if k < 6 else [])
        assert set(labels.tolist()) == ({k % 2} if k < 6 else set())
        assert labels.dtype == np.uint8


def test_cells_of_beams_without_a_label_have_no_class(write, scan) -> None:
    half = labelled(scan(0), 0)
    half.labels[: half.labels.size // 2] = 255
    frame, cells, _ = next(open_stream(write([half, scan(1)], classes=["car"])).labelled())
    assert 0 < cells.size < frame.occupied.sum()


def test_a_label_without_a_class_is_refused(write, scan) -> None:
    stream = open_stream(write([labelled(scan(k), 1) for k in range(3)], classes=["car"]))
    with pytest.raises(RecordingError, match=r"a label is class 1 at .* but the recording has 1 classes"):
        list(stream.labelled())
