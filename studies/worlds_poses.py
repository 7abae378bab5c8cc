"""What the poses of wheel odometry cost on the test worlds, and what refined ones give back.

`python -m studies.worlds_poses` takes the worlds of data/worlds/test whose robot drives with the poses of its wheels,
compares the trackers with general weights on them as they are recorded, and once more with refined poses (`recording
import --ego-motion refined`, which knows the scans and the odometry alone), in folders below `--out`. Forecasts are
scored by the true poses both times. Duration: a quarter of an hour of one idle core.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from gridtrack.recordings import open_recording

from studies.support.comparison import gridtrack
from studies.support.place_command import compare_places, place_parser, worlds_called
from studies.support.results_file import ResultSection, ResultTable, measured_table, write_section
from studies.support.unseen_places import NONE, STRATA, PlaceScores

RESULTS = Path("docs/results/worlds/poses.json")
COMMAND = "python -m studies.worlds_poses"
KINDS = ("odometry", "refined")
SHOWN = (("dynamic", 0.5), ("dynamic", 1.0), ("visible", 1.0), ("occluded", 1.0))
"""Stratum and horizon, seconds, of the columns: each once for each of KINDS."""


def with_odometry(worlds: Iterable[Path]) -> list[Path]:
    """Those whose forecasts are scored by other poses than the trackers get."""
    return [path for path in worlds if next(open_recording(path).scans()).reference_T_sensor is not None]


def refined(world: Path, folder: Path) -> Path:
    """The world with refined poses, in `folder`; nothing is done where it exists."""
    path = folder / f"{world.stem}.mcap"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        gridtrack("recording", "import", world, "--out", path, "--ego-motion", "refined")
    return path


def score_table(scores: Mapping[str, PlaceScores]) -> ResultTable:
    """F1 of each tracker with the poses of each kind."""
    columns = [f"{STRATA[stratum]}, {h:g} s, {kind}" for stratum, h in SHOWN for kind in KINDS]
    rows = [
        [label, *(scores[kind].text(label, stratum, "f1", h) for stratum, h in SHOWN for kind in KINDS)]
        for label in scores[KINDS[0]].labels
    ]
    return measured_table(("F1", *columns), rows)


def drift_table(recordings: Mapping[str, Sequence[Path]]) -> ResultTable:
    """How far a wall moves in a second by the poses of each kind, metres."""
    rows = [
        [world.stem, *map(drift_text, (world, mended))]
        for world, mended in zip(*(recordings[kind] for kind in KINDS), strict=True)
    ]
    return measured_table(("a wall moves in a second, m", *KINDS), rows)


def drift_text(path: Path) -> str:
    """That of one recording, as `recording info` finds it."""
    (sensor,) = open_recording(path).overview().sensors.values()
    return NONE if sensor.pose_drift_m is None else f"{sensor.pose_drift_m:.3f}"


def main() -> None:
    parser = place_parser(__doc__, Path("runs/worlds-poses"), RESULTS)
    parser.add_argument("--world", action="append", help="such as indoors-hall-1002; default: all with odometry")
    given = parser.parse_args()
    worlds, out = with_odometry(worlds_called(given.world)), given.out
    recordings = dict(zip(KINDS, (worlds, [refined(world, out / "recordings") for world in worlds]), strict=True))
    scores = {}
    for kind in KINDS:
        given.out = out / kind
        if not given.collect:
            compare_places(given, recordings[kind])
        scores[kind] = PlaceScores.read(given.out)
    tables = {"F1": score_table(scores), "drift": drift_table(recordings)}
    write_section(given.results, "poses", ResultSection(command=COMMAND, tables=tables))
    print("\n\n".join(table.markdown() for table in tables.values()))


if __name__ == "__main__":
    main()
