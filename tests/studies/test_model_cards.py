"""The page of the weights that ship has the cards that ship."""

from __future__ import annotations

from pathlib import Path

from studies.model_cards import labelled_scans, table
from studies.support.results_file import read_sections

RESULTS = Path(__file__).parents[2] / "docs" / "results" / "trackers" / "model-cards.json"


def test_the_committed_table_is_that_of_the_cards() -> None:
    assert read_sections(RESULTS)["shipped"].tables["table"] == table(), "run python -m studies.model_cards --out FILE"


def test_labelled_scans_are_those_of_the_tracker_or_of_its_class_decoder() -> None:
    assert labelled_scans({"labelled": "a.tracks, 20 scans from 1 s to 3 s"}) == "20"
    assert labelled_scans({"classes": {"labelled": "800 scans of 384 recordings"}}) == "800"
    assert labelled_scans({"classes": "none: a has no labels"}) == ""
