"""Real drives: trackers with general weights on stretches of recordings of driving robots.

`python -m studies.real_drives DATA FOLDER [--out FILE]` (ten minutes): DATA has the folders datmo, radish and ual
(docs/results/real); FOLDER gets the imported recordings, the runs with their reports, and the pictures. `persistence`
is compared with poses from each source, every tracker with refined ones. The last table counts the confirmed tracks of
`kalman`, the tracks faster than MOVING_MPS, and of these the ones with a velocity that is not zero at 99.9 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from gridtrack.common.files import sha256_of
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.samples import SAMPLES, read_samples
from gridtrack.recordings.read_options import PoseSource
from gridtrack.recordings.stream import open_stream
from gridtrack.reports.run import ReportedRun, read_runs
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.model_free.kalman import KalmanTracker
from gridtrack.trackers.model_free.settings import ModelFreeSettings
from gridtrack.trackers.training.card import GENERAL

from studies.real_results import REAL, RealRecording, import_real
from studies.support.comparison import compare
from studies.support.drawings import draw_pictures, forecast_pictures
from studies.support.results_file import ResultSection, measured_table, study_parser, write_section
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
    """A stretch of a recording."""

    recording: RealRecording
    start_s: float
    end_s: float

    @property
    def name(self) -> str:
        """The name of the recording."""
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
    """F1 of each tracker in STRATA, HORIZON_S ahead, with the thresholds of the cards."""
    out = folder / f"run-{Path(recording).name.partition('.')[0]}"
    compare([recording], None, rows, out, "--jobs", "1", "--horizon", f"{HORIZON_S}s", "--every", "0.4s")
    (run,) = read_runs([out])
    if drive.name in PICTURES and len(rows) > 1:
        draw_samples(run, PICTURES[drive.name], folder / f"real-drive-{drive.name}.svg")
    found = {}
    for label, entry in run.summary.trackers.items():
        (trial,) = entry.recordings.values()
        (described,) = run.summary.recordings.values()
        f1 = [trial.at(stratum, "f1", "f1", len(described.horizons_s) - 1).value for stratum in STRATA]
        found[label] = ["" if value is None else f"{value:.2f}" for value in f1]
    return found


def draw_samples(run: ReportedRun, numbers: Sequence[int], path: Path) -> None:
    """Draw the kept forecasts of these numbers in a run of one recording, as SHOWN trackers made them."""
    (recording,) = run.summary.recordings
    kept = {name: list(read_samples(run.trial_folder(name, recording) / SAMPLES)) for name in SHOWN}
    rows = [{name: found[number] for name, found in kept.items()} for number in numbers]
    draw_pictures([forecast_pictures("scan", row, HORIZON_S) for row in rows], path)


def tracks_in_motion(recording: str, card: Path) -> list[str]:
    """Confirmed tracks of `kalman` per frame, the fast ones, and the fast ones with a significant velocity."""
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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/moving/real_drives.json")
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", help="the name of one drive")
    given = parser.parse_args(arguments)
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
    values = {"not measured": not_measured(rows)}
    section = ResultSection(command="python -m studies.real_drives", tables=tables, values=values)
    print(section.text())
    write_section(given.out, "drives", section)


if __name__ == "__main__":
    main()
