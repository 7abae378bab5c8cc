"""The drives that trackers learn from, and those that their thresholds are chosen on: the junction with other seeds.

`python -m studies.support.drive_training [--out runs/drives]` (ten minutes on an idle core; needs the extra `sim`). A
seed gives a minute with a laser on a car or a robot, and the same minute with a laser that stands beside its way, so
that the same weights serve both; for validation also with the poses of wheel odometry. Files that exist are kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from gridtrack.simulation.junction import WARM_UP_S
from gridtrack.simulation.junction.drives import CARRIERS, Drive, simulate_drive
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import write_recording

VALIDATION_SEEDS, TRAINING_SEEDS = range(401, 405), range(301, 321)
"""None is a seed of the drives that trackers are compared on, 201 to 220, or of another recording of the junction."""


def simulate_training(out: Path) -> None:
    """Write the validation and the training drives of a minute below `out`."""
    for name, seeds in (("validation", VALIDATION_SEEDS), ("training", TRAINING_SEEDS)):
        for seed in seeds:
            carrier = list(CARRIERS)[seed % len(CARRIERS)]
            views: dict[str, Callable[[Drive], Tracks]] = {"": Drive.carried, "-beside": Drive.beside}
            if name == "validation":
                views["-odometry"] = with_odometry
            paths = {out / name / f"{carrier}-{seed}{which}.tracks": view for which, view in views.items()}
            missing = {path: view for path, view in paths.items() if not path.exists()}
            if missing:
                drive = simulate_drive(1.0, seed, WARM_UP_S, carrier)
            for path, view in missing.items():
                write_recording(path, view(drive))
                print(path, flush=True)


def with_odometry(drive: Drive) -> Tracks:
    """The drive with the poses of wheel odometry."""
    return drive.carried(1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/drives"))
    simulate_training(parser.parse_args().out)


if __name__ == "__main__":
    main()
