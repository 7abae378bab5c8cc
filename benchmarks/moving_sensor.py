"""Cost of a sensor that moves and of a second one, beside one standing sensor.

`python -m benchmarks.moving_sensor [TRACKER...] [--out FILE]` (two minutes). Aim: making a frame of two moving sensors,
and moving the cells that a tracker keeps, take together at most 0.5 ms more than a frame of one standing sensor.

Frames are made by the grid stream from the scans of a drive, in memory: at its poses, or all at the first one; the
second sensor has the same ranges, looks back and stands a metre behind. A roll is an update with a window that has
moved by one cell, less an update of the same scan with a fixed window. All take turns, and the least processor time of
each frame counts, so that other work on the machine affects the caches only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.observation import frame_of
from gridtrack.recordings.stream import GridStream, open_stream
from gridtrack.trackers.contract import Tracker

from studies.support.results_file import ResultSection, measured_table, study_parser, write_section
from studies.support.shipped import DATA, JUNCTION, HeldRecording, shipped_tracker

TRACKERS = (
    *("persistence", "static-map", "one-shot", "kalman", "factor-graph", "dogma"),
    *("dilated-convgru", "deep-tracking-rnn"),
)
AIM_MS = 0.5
SPAN = 10
"""Cells by which the window of the trackers moves to the right and back."""
SENSORS = {
    "one standing sensor": (1, False),
    "one moving sensor": (1, True),
    "two standing sensors": (2, False),
    "two moving sensors": (2, True),
}
"""Number of sensors, and whether they move."""


def held_streams() -> dict[str, GridStream]:
    """The streams of SENSORS, from the scans of one drive."""
    drive = open_recording(DATA / "drives" / "robot-203.tracks")
    scans = [replace(scan, scene=None, labels=None) for scan in drive.scans()]
    streams = {}
    for name, (sensors, moves) in SENSORS.items():
        held = []
        for scan in scans:
            front = scan if moves else replace(scan, world_T_sensor=scans[0].world_T_sensor)
            rear = replace(front, sensor="rear", world_T_sensor=front.world_T_sensor @ SE2(-1.0, 0.0, np.pi))
            held += [front, rear][:sensors]
        streams[name] = GridStream(HeldRecording(held, drive))
    return streams


def least_times_ms(runs: Mapping[str, Callable[[], Iterator[object]]], rounds: int) -> dict[str, NDArray[np.float64]]:
    """The least processor time (N,) of each of the N steps of every run; in each round the runs take turns."""
    times: dict[str, list[list[float]]] = {name: [] for name in runs}
    for _ in range(rounds + 1):
        stepping = {name: run() for name, run in runs.items()}
        for name in runs:
            times[name].append([])
        while stepping:
            for name, steps in tuple(stepping.items()):
                begun = time.thread_time_ns()
                done = next(steps, None) is None
                times[name][-1].append(1e-6 * (time.thread_time_ns() - begun))
                if done:
                    times[name][-1].pop()
                    del stepping[name]
    return {name: np.min(values[1:], axis=0) for name, values in times.items()}


def frame_times_ms(rounds: int) -> dict[str, float]:
    """The mean time of a frame of each of SENSORS."""
    runs = {name: lambda stream=stream: stream.observations() for name, stream in held_streams().items()}
    return {name: float(values.mean()) for name, values in least_times_ms(runs, rounds).items()}


def frames_in_windows(recording: Recording, grid: GridSpec, columns: Sequence[int]) -> list[GridFrame]:
    """A frame for each of `columns`, the place of its window in cells to the right of the recording's window."""
    frames = []
    for scan, column in zip(recording.scans(), columns, strict=False):
        right_m = column * grid.cell_m
        poses = {scan.sensor: SE2(scan.world_T_sensor.x - right_m, scan.world_T_sensor.y, scan.world_T_sensor.theta)}
        frames.append(frame_of(scan.stamp_ns, {scan.sensor: scan}, poses, SE2(right_m), grid, "centres"))
    return frames


def updates(tracker: Tracker, frames: Sequence[GridFrame]) -> Iterator[bool]:
    """The updates of a stream from its beginning."""
    tracker.reset(0)
    for frame in frames:
        tracker.update(frame)
        yield True


def update_times_ms(name: str, frames: int, rounds: int) -> tuple[float, float]:
    """The median time of an update in a fixed window, and the additional time in a moving one."""
    source = open_stream(JUNCTION / "test-101.tracks")
    there_and_back = SPAN - np.abs(np.arange(frames) % (2 * SPAN) - SPAN)
    runs = {}
    for window, columns in (("stays", np.zeros(frames, np.int64)), ("moves", there_and_back)):
        made = frames_in_windows(source.recording, source.grid, columns.tolist())
        tracker = shipped_tracker(name, source)
        runs[window] = lambda tracker=tracker, made=made: updates(tracker, made)
    found = least_times_ms(runs, rounds)
    return float(np.median(found["stays"])), float(np.median((found["moves"] - found["stays"])[1:]))


def measured(trackers: Sequence[str], frames: int, rounds: int) -> ResultSection:
    """The times, also as ratios to making a frame of one standing sensor."""
    makes = frame_times_ms(rounds)
    standing, both = (makes[name] for name in ("one standing sensor", "two moving sensors"))
    parts = [(name, f"{ms:.3f}", f"{ms / standing:.1f}") for name, ms in makes.items()]
    rows, more_of = [], {}
    for name in trackers:
        update, roll = update_times_ms(name, frames, rounds)
        more = more_of[name] = both - standing + roll
        rows.append((name, f"{update:.3f}", f"{round(roll, 3) + 0.0:.3f}", f"{more:.3f}", f"{more / standing:.1f}"))
    costliest = max(more_of, key=lambda name: more_of[name])
    tables = {
        "frames": measured_table(("making a frame of", "ms", "x one standing sensor"), parts),
        "trackers": measured_table(
            ("tracker", "update, ms", "roll, ms", "two moving sensors and roll, ms more", "x frame, one standing"), rows
        ),
    }
    values = {"costliest": costliest, "most, ms": f"{more_of[costliest]:.2f}"}
    return ResultSection(command="python -m benchmarks.moving_sensor", tables=tables, values=values)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/moving/cost.json")
    parser.add_argument("trackers", nargs="*", default=TRACKERS, help=f"default: {' '.join(TRACKERS)}")
    parser.add_argument("--frames", type=int, default=60, help="updates of each tracker")
    parser.add_argument("--rounds", type=int, default=10)
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    section = measured(given.trackers, given.frames, given.rounds)
    print(section.text(), f"aim: at most {AIM_MS} ms more", sep="\n\n")
    write_section(given.out, "cost", section)


if __name__ == "__main__":
    main()
