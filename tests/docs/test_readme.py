"""The Python on the pages runs, and the README's tracker keeps the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.contract_scene import scene
from gridtrack.trackers.contract import StreamSpec, Tracker
from gridtrack.trackers.registry import contract_breach

from docs.pages import PAGES, ROOT, blocks, name_of

BLOCKS = [(page, block) for page in PAGES for block in blocks(page, "python")]


@pytest.mark.usefixtures("trackers_here")
@pytest.mark.parametrize(("page", "block"), BLOCKS, ids=[name_of(page) for page, _ in BLOCKS])
def test_a_python_block_runs(page: Path, block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data").symlink_to(ROOT / "data")  # a block may write into runs
    monkeypatch.chdir(tmp_path)
    block = block.replace("    horizon_s=1.0,", "    horizon_s=1.0, no_floors=True,")
    exec(compile(block, str(page), "exec"), {"__name__": "page"})


def test_the_readmes_tracker_keeps_the_contract() -> None:
    (block,) = blocks(ROOT / "README.md", "python")
    names: dict[str, Any] = {"__name__": "readme"}
    exec(compile(block, "README.md", "exec"), names)
    kind: type[Tracker] = names["MyTracker"]
    assert contract_breach(kind) == ""
    stream = StreamSpec(GridSpec(40, 0.2), 0.125)
    tracker = kind(stream, kind.Options())
    frames = list(scene(stream.grid, stream.period_s, 12, seed=1))
    passes = []
    for _ in range(2):
        tracker.reset(0)
        for frame in frames:
            tracker.update(frame)
        passes.append(tracker.predict(5).occupancy)
    assert passes[0].shape == (6, 40, 40)
    assert passes[0].dtype == np.float32
    assert ((passes[0] >= 0) & (passes[0] <= 1)).all()
    assert (passes[0][0] == frames[-1].occupied)[frames[-1].visible].all()
    np.testing.assert_array_equal(passes[0], passes[1])
    np.testing.assert_array_equal(passes[0], tracker.predict(5).occupancy)
