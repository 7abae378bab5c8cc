"""The files of an export that trackers share: a manifest of the stream and the weights, settings, and a README."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gridtrack.common.config import Settings
from gridtrack.common.files import sha256_of, write_text
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.training.card import Card
from gridtrack.trackers.training.weights import read_card

EXPORT_VERSION = 1
MANIFEST_FILE, SETTINGS_FILE, EXPORT_README = "manifest.json", "settings.json", "README.md"
SETTINGS_ONLY = "settings only: the tracker itself is Python code of gridtrack"
MOST_RECORDINGS = 5
"""Number of recordings that the README names."""


def write_manifest(folder: Path, stream: StreamSpec, entries: Mapping[str, Any]) -> None:
    """Write `manifest.json`: grid, period, classes, thresholds and hashes, then the `entries` of the tracker."""
    card, sha256 = card_of(stream)
    thresholds = None if card.thresholds is None else card.thresholds.model_dump(mode="json")
    manifest = {
        "version": EXPORT_VERSION,
        "tracker": card.tracker,
        "site": card.site,
        "cell_m": stream.grid.cell_m,
        "size": stream.grid.size,
        "corner_in_window_m": list(stream.grid.origin),
        "period_s": stream.period_s,
        "classes": list(card.classes),
        "thresholds": thresholds,
        "card_sha256": sha256,
        "arrays_sha256": card.arrays_sha256,
        "made_with": {"gridtrack": version("gridtrack")},
    }
    write_text(folder / MANIFEST_FILE, json.dumps(manifest | dict(entries), indent=1) + "\n")


def write_readme(folder: Path, stream: StreamSpec, content: str) -> None:
    """Write `README.md`: the `content` of the folder, and the origin of the weights."""
    card, _ = card_of(stream)
    names = list(dict.fromkeys(data.recording for data in card.train))
    more = f" and {len(names) - MOST_RECORDINGS} more" if len(names) > MOST_RECORDINGS else ""
    text = f"""# {card.tracker}, exported from gridtrack

{content}

Grid {stream.grid}, {1 / stream.period_s:g} frames per second. Weights: `{card.site}`, seed {card.seed}, learned from
{", ".join(names[:MOST_RECORDINGS])}{more} by

    {card.command}

gridtrack and the weights that ship with it are under the BSD 3-Clause License, copyright the gridtrack authors; the
recording `leg_tracker` is under the same licence, copyright Angus Leigh. Keep these names with the files. Other
weights: under the terms of their author and of their recordings.
"""
    write_text(folder / EXPORT_README, text)


def card_of(stream: StreamSpec) -> tuple[Card, str]:
    """The card that a running tracker was loaded from, and its hash. Raises WeightsError."""
    assert stream.weights is not None
    sha256 = stream.weights_sha256 or sha256_of(stream.weights)
    return read_card(stream.weights, sha256), sha256


def export_settings(folder: Path, stream: StreamSpec, settings: Settings) -> str:
    """Write the tuned `settings` of a tracker without a network; returns SETTINGS_ONLY."""
    write_text(folder / SETTINGS_FILE, settings.model_dump_json(indent=1) + "\n")
    write_manifest(folder, stream, {"settings": SETTINGS_FILE})
    write_readme(
        folder, stream, f"`{SETTINGS_FILE}`: the tuned settings. The tracker itself is Python code of gridtrack."
    )
    return SETTINGS_ONLY
