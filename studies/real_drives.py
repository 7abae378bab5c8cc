"""Real drives: trackers with general weights on stretches of recordings of robots that drive, to be looked at.

`python -m studies.real_drives DATA FOLDER [--out FILE]` (some ten minutes): DATA has the folders datmo, radish and ual
(docs/results/real); FOLDER gets the imported recordings and the runs, whose reports have the pictures.
`persistence` is compared with poses from each source, every tracker with the refined ones. A last table counts the
confirmed tracks of `kalman` that are faster than MOVING_MPS, and those of them whose velocity is not zero at a
confidence of 99.9 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from gridtrack.common.files import sha256_of
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion import PoseSource
from gridtrack.recordings.stream import open_stream
from gridtrack.reports.run import read_runs
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.settings import ModelFreeSettings
from gridtrack.trackers.training.card import GENERAL

from studies.support.comparison import compare
from studies.support.forecast_pictures import forecast_pictures
from studies.support.real_recordings import REAL, RealRecording, import_real
from studies.support.results_file import ResultSection, measured_table, write_section
from studies.support.unseen_places import REFERENCE, TRAININGS, WEIGHTS, further_training, general_rows, not_measured

HORIZON_S, WARM_UP = 1.0, 20
POSES: tuple[PoseSource, ...] = ("recorded", "refined", "kiss-icp")
STRATA = ("visible", "dynamic", "in-motion")
SHOWN = (REFERENCE, "kalman", "dogma", "dilated-convgru")
PICTURES = {"aces": (24, 32), "overtakes": (16, 32)}
"""The kept samples that are drawn."""
MOVING_MPS, SIGNIFICANT = 0.5, 13.8
"""The second: squared Mahalanobis distance of a velocity from zero, 99.9 % of a chi-square with two degrees."""


@dataclass(frozen=True)
class Drive:
    """A stretch of a recording, and whose weights are used on it."""

    recording: RealRecording
    start_s: float
    end_s: float

    @property
    def name(self) -> str:
        """That of the recording."""
        return self.recording.name


RECORDED = {one.name: one for one in REAL}
DRIVES = (
    Drive(RECORDED["overtakes"], 0, 26),
    Drive(RECORDED["intersection"], 0, 6.4),
    Drive(RECORDED["two_robots"], 0, 32),
    Drive(RECORDED["aces"], 170, 220),
    Drive(RECORDED["intel"], 60, 110),
    Drive(RECORDED["ual"], 40, 80),
)


def scans_of(drive: Drive, data: Path) -> list[Scan]:
    """The scans from the beginning of the recording to the end of the stretch, with recorded poses."""
    scans = drive.recording.scans(data)
    first = next(scans)
    end_ns = first.stamp_ns + drive.end_s * 1e9
    return [first, *takewhile(lambda scan: scan.stamp_ns <= end_ns, scans)]


def imported(drive: Drive, scans: list[Scan], source: PoseSource, data: Path, folder: Path) -> str:
    """The stretch of the recording with poses from `source`."""
    out = import_real(drive.recording, scans, source, data, folder / f"{drive.name}-{source}.mcap")
    return f"{out}@{drive.start_s}s-{drive.end_s}s"


def compared(drive: Drive, recording: str, rows: Sequence[str], folder: Path) -> dict[str, list[str]]:
    """F1 of each tracker, HORIZON_S ahead, in the strata; thresholds are those of the cards."""
    out = folder / f"run-{Path(recording).name.partition('.')[0]}"
    compare([recording], None, rows, out, "--jobs", "1", "--horizon", f"{HORIZON_S}s", "--every", "0.4s")
    (run,) = read_runs([out])
    if drive.name in PICTURES and len(rows) > 1:
        drawing = forecast_pictures(run, SHOWN, PICTURES[drive.name], HORIZON_S)
        (folder / f"real-drive-{drive.name}.svg").write_text(drawing, "utf-8")
    found = {}
    for label, entry in run.summary.trackers.items():
        (trial,) = entry.recordings.values()
        f1 = [trial.strata[stratum].f1[-1] if stratum in trial.strata else None for stratum in STRATA]
        found[label] = ["" if value is None else f"{value:.2f}" for value in f1]
    return found


def tracks_in_motion(recording: str, card: Path) -> list[str]:
    """Confirmed tracks of `kalman` a frame, the fast ones, and those whose velocity is significant."""
    stream = open_stream(recording)
    spec = StreamSpec(stream.grid, stream.period_s, stream.site, weights=card, weights_sha256=sha256_of(card))
    tracker = KalmanTracker(spec, ModelFreeSettings())
    counts = []
    for frame in stream:
        tracker.update(frame)
        objects = tracker.predict(0).objects
        fast = [one for one in objects if np.hypot(*one.velocity) > MOVING_MPS]
        sure = [
            one for one in fast if one.velocity @ np.linalg.solve(one.covariance[2:, 2:], one.velocity) > SIGNIFICANT
        ]
        counts.append((len(objects), len(fast), len(sure)))
    return [f"{count:.2f}" for count in np.mean(counts[WARM_UP:], axis=0)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", help="the name of one drive")
    parser.add_argument("--out", type=Path, help="docs/results/moving/real_drives.json")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    rows = {label: row for label, row in general_rows(WEIGHTS, TRAININGS).items() if not further_training(label)}
    scores, tracks, poses = [], [], []
    for drive in DRIVES:
        if given.only not in (None, drive.name):
            continue
        scans = scans_of(drive, given.data)
        for source in POSES:
            recording = imported(drive, scans, source, given.data, given.folder)
            chosen = list(rows.values()) if source == "refined" else [REFERENCE]
            found = compared(drive, recording, chosen, given.folder)
            poses.append([f"{drive.name}, {source}", *found[REFERENCE]])
            if source == "refined":
                scores += [[f"{drive.name}, {label}", *row] for label, row in found.items()]
                tracks.append([drive.name, *tracks_in_motion(recording, WEIGHTS / "kalman" / f"{GENERAL}.toml")])
    tables = {
        "scores": measured_table(("drive and tracker", *(f"F1 {name}" for name in STRATA)), scores),
        "tracks": measured_table(("drive", "tracks", "faster than 0.5 m/s", "and significant"), tracks),
        "poses": measured_table(("drive and poses", *(f"F1 {name}" for name in STRATA)), poses),
    }
    print("\n\n".join(table.markdown() for table in tables.values()))
    if given.out is not None:
        values = {"not measured": not_measured(rows)}
        section = ResultSection(command="python -m studies.real_drives", tables=tables, values=values)
        write_section(given.out, "drives", section)


if __name__ == "__main__":
    main()
