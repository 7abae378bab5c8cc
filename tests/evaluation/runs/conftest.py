"""A run of twenty recordings with drawn counts, and its summary."""

from __future__ import annotations

import pytest

from scenes.synthetic_run import summary_of, write_rows


@pytest.fixture(scope="session")
def twenty(tmp_path_factory):
    """One tracker better than persistence, one its twin, one that crashed once, and a ceiling; trials and summary."""
    skills = {"persistence": 0.6, "good": 0.8, "twin": 0.6, "unlucky": 0.9, "oracle": 1.0}
    trials = write_rows(tmp_path_factory.mktemp("twenty"), skills, frames=4, unlucky=3)
    return trials, summary_of(trials)
