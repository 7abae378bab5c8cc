"""Drives at the junction: to learn from, to choose thresholds on, and every drive with poses of each kind.

`python -m studies.drive_recordings [--out runs/drives]` (ten minutes on an idle core; needs the extra `sim`) simulates
the drives to learn from and for validation: the junction with other seeds. A seed gives a minute with a laser on a car
or a robot, and the same minute with a laser that stands beside the drive, so that the same weights serve both; for
validation also with the poses of wheel odometry. Existing files are kept.

`studies/moving.py` compares trackers with each kind of poses. Forecasts are always scored by the true poses. Thresholds
are chosen with poses of the same kind on the validation drives, which are joined to one recording for that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.formats.native import write_native
from gridtrack.recordings.importing import import_recording
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.junction import WARM_UP_S
from gridtrack.simulation.junction.drives import CARRIERS, Drive, simulate_drive
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import write_recording

from studies.support.results_file import study_parser

VALIDATION_SEEDS, TRAINING_SEEDS = range(401, 405), range(301, 321)
"""Seeds that no other recording of the junction has; trackers are compared on the drives 201 to 220."""
RECORDED = {"perfect": "", "odometry": "-odometry", "beside": "-beside"}
"""Suffix of the file name, by kind of poses, of the drives that are simulated with them."""
KINDS = ("perfect", "odometry", "kiss-icp", "ignored", "beside")
"""Kinds of poses; beside: of a laser that stands beside the drive in the same minute."""
PAUSE_NS = 5_000_000_000
"""Between two joined drives: longer than a forecast, so that no forecast is scored on the next drive."""


def simulate_drives(out: Path) -> None:
    """Write the validation and the training drives of a minute below `out`."""
    for name, seeds in (("validation", VALIDATION_SEEDS), ("training", TRAINING_SEEDS)):
        for seed in seeds:
            carrier = list(CARRIERS)[seed % len(CARRIERS)]
            views: dict[str, Callable[[Drive], Tracks]] = {"": Drive.carried, "-beside": Drive.beside}
            if name == "validation":
                views["-odometry"] = lambda drive: drive.carried(1.0)
            paths = {out / name / f"{carrier}-{seed}{which}.tracks": view for which, view in views.items()}
            missing = {path: view for path, view in paths.items() if not path.exists()}
            if missing:
                drive = simulate_drive(1.0, seed, WARM_UP_S, carrier)
            for path, view in missing.items():
                write_recording(path, view(drive))
                print(path, flush=True)


def drives_in(folder: Path) -> list[str]:
    """The names of the drives in a folder, such as `car-202`."""
    return sorted(path.stem for path in folder.glob("*.tracks") if path.stem.count("-") == 1)


def recording_of(kind: str, drive: str, folder: Path, out: Path) -> Path:
    """The recording of a drive in `folder` with one of KINDS of poses; derived ones are written below `out`."""
    if kind in RECORDED:
        return folder / f"{drive}{RECORDED[kind]}.tracks"
    path = out / kind / f"{drive}.mcap"
    if not path.exists() and kind == "kiss-icp":
        import_recording(folder / f"{drive}.tracks", path, ego_motion="kiss-icp")
    elif not path.exists():
        source = open_recording(folder / f"{drive}.tracks")
        described = {"poses": "ignored", "source": source.name, "source_sha256": source.sha256}
        _write(path, source.info.model_copy(update=described), standing(source.scans()))
    return path


def joined_recording(kind: str, folder: Path, out: Path) -> Path:
    """All drives in `folder` with one of KINDS of poses as one recording below `out`."""
    path = out / kind / "validation.mcap"
    if not path.exists():
        recordings = [open_recording(recording_of(kind, drive, folder, out)) for drive in drives_in(folder)]
        info = recordings[0].info.model_copy(update={"source": "", "source_sha256": "", "command": ""})
        _write(path, info, joined(recordings))
    return path


def standing(scans: Iterable[Scan]) -> Iterator[Scan]:
    """`scans` as if the sensor stood at its first pose; the recorded poses become the reference poses."""
    first: SE2 | None = None
    for scan in scans:
        first = scan.world_T_sensor if first is None else first
        yield replace(scan, world_T_sensor=first, reference_T_sensor=scan.reference_T_sensor or scan.world_T_sensor)


def joined(recordings: Iterable[Recording]) -> Iterator[Scan]:
    """The scans of all recordings, each PAUSE_NS after the last scan of the previous recording."""
    start_ns = 0
    for recording in recordings:
        survey = recording.survey
        for scan in recording.scans():
            yield replace(scan, stamp_ns=start_ns + scan.stamp_ns - survey.first_ns)
        start_ns += survey.last_ns - survey.first_ns + PAUSE_NS


def _write(path: Path, info: RecordingInfo, scans: Iterable[Scan]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        write_native(file, info, scans)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/drives"), help="default: %(default)s")
    simulate_drives(parser.parse_args(arguments).out)


if __name__ == "__main__":
    main()
