"""Following a recording for two hours: memory, open files, disk and missed frames while a robot records.

`python -m benchmarks.follow [TRACKER...] [--folder FOLDER] [--out FILE]` (default: persistence and kalman; two hours,
and the time to score them). The demo recording is written repeatedly in real time, with increasing stamps, and
`gridtrack compare --follow` reads it. A line is added to FOLDER/samples.csv every ten seconds: resident memory of
`compare` and of its trackers, open files, size of the recording, disk usage of the run's folder with its unnamed file,
and missed frames. `--table` makes the table of docs/follow.md from earlier samples.
"""

from __future__ import annotations

import csv
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

import psutil

from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording, write_native

from benchmarks.harness import looped
from studies.support.results_file import ResultTable, measured_table, study_parser, write_table
from studies.support.shipped import DEMO

SAMPLE_EVERY_S, ROW_EVERY_S, BLOCK_BYTES, MIB = 10.0, 600.0, 512, 2.0**20
REPEATS = 10_000
SAMPLED = ("time_s", "processes", "host_mib", "trackers_mib", "open_files", "recording_mib", "disk_mib", "missed")
COLUMNS = ("minute", "compare, MiB", "trackers, MiB", "open files", "folder of the run, MiB", "missed frames")


class Recorder(threading.Thread):
    """Writes the demo recording to `path` in real time, repeated for `minutes`."""

    def __init__(self, path: Path, minutes: float) -> None:
        super().__init__(name="recorder", daemon=True)
        self._path, self._length_s = path, 60.0 * minutes

    def run(self) -> None:
        """Write up to the end, and close the file."""
        info = open_recording(DEMO).info.model_copy(update={"stretches": {}, "source": "", "source_sha256": ""})
        with self._path.open("wb", buffering=0) as file:
            write_native(file, info, self._in_real_time())

    def _in_real_time(self) -> Iterator[Scan]:
        began_s, first_ns = time.monotonic(), open_recording(DEMO).survey.first_ns
        for scan in looped(REPEATS):
            at_s = (scan.stamp_ns - first_ns) / 1e9
            if at_s > self._length_s:
                return
            time.sleep(max(0.0, began_s + at_s - time.monotonic()))
            yield scan


def disk_mib(folder: Path, processes: Sequence[psutil.Process]) -> float:
    """Disk usage of the files in `folder`, and of deleted files there that `processes` hold open."""
    found = {(status.st_dev, status.st_ino): status.st_blocks for status in map(Path.stat, folder.rglob("*"))}
    for process in processes:
        for link in Path(f"/proc/{process.pid}/fd").iterdir():
            if str(link.readlink()).startswith(str(folder)):
                status = link.stat()
                found[status.st_dev, status.st_ino] = status.st_blocks
    return sum(found.values()) * BLOCK_BYTES / MIB


def sample(process: psutil.Process, recording: Path, folder: Path, line: str) -> list[str]:
    """The columns after the time; `line` is the newest line of the live table."""
    trackers = process.children(recursive=True)
    resident = [one.memory_info().rss / MIB for one in (process, *trackers)]
    open_files = sum(one.num_fds() for one in (process, *trackers))
    sizes = recording.stat().st_size / MIB, disk_mib(folder, (process, *trackers))
    memory = f"{resident[0]:.1f}", f"{sum(resident[1:]):.1f}"
    missed = " ".join(re.findall(r"(\d+) missed", line))
    return [str(len(resident)), *memory, str(open_files), *(f"{size:.1f}" for size in sizes), missed]


def watch(command: subprocess.Popen[bytes], log: Path, recording: Path, folder: Path, out: TextIO) -> None:
    """Write a line every ten seconds until the command ends."""
    table, began_s = csv.writer(out), time.monotonic()
    table.writerow(SAMPLED)
    while command.poll() is None:
        line = (log.read_text().splitlines() or [""])[-1]
        try:
            sampled = sample(psutil.Process(command.pid), recording, folder, line)
        except (psutil.Error, OSError):
            sampled = []  # a process or one of its files ended meanwhile
        if sampled:
            table.writerow([f"{time.monotonic() - began_s:.0f}", *sampled])
            out.flush()
        time.sleep(SAMPLE_EVERY_S)


def table_of(samples: Path) -> ResultTable:
    """A row for each ten minutes of following, one for its end, and the largest values while it was scored."""
    with samples.open(newline="") as file:
        rows = list(csv.DictReader(file))
    followed = [row for row in rows if row["missed"]]
    scored = rows[rows.index(followed[-1]) + 1 :]
    ends = [index * ROW_EVERY_S for index in range(1, int(float(followed[-1]["time_s"]) // ROW_EVERY_S) + 1)]
    chosen = [next(row for row in followed if float(row["time_s"]) >= end_s) for end_s in ends]
    by_minute = {f"{float(row['time_s']) / 60:.0f}": row for row in (followed[0], *chosen, followed[-1])}
    table = [_row(minute, [row]) for minute, row in by_minute.items()]
    return measured_table(COLUMNS, [*table, *([_row("scoring, at most", scored)] if scored else [])])


def _row(name: str, samples: Sequence[dict[str, str]]) -> list[str]:
    columns = ("host_mib", "trackers_mib", "open_files", "disk_mib")
    most = (max(float(one[column]) for one in samples) for column in columns)
    return [name, *(f"{value:.0f}" for value in most), samples[-1]["missed"].replace(" ", ", ")]


def follow(trackers: Sequence[str], minutes: float, folder: Path) -> int:
    """Record and follow in `folder`, with samples.csv and the output of the command; returns the exit code."""
    recording, run, log = folder / "growing.mcap", folder / "run", folder / "compare.log"
    Recorder(recording, minutes).start()
    while not recording.exists():
        time.sleep(1.0)
    words = ["compare", "--no-floors", "--follow", str(recording), "--out", str(run)]
    words += [word for tracker in trackers for word in ("--tracker", tracker)]
    gridtrack = str(Path(sys.executable).with_name("gridtrack"))
    with log.open("wb") as written, (folder / "samples.csv").open("w") as samples:
        command = subprocess.Popen([gridtrack, *words], stdout=written, stderr=subprocess.STDOUT)
        watch(command, log, recording, run, samples)
    return command.returncode


def main(arguments: Sequence[str] | None = None) -> None:
    parser = study_parser(__doc__, "docs/results/follow.json")
    parser.add_argument("trackers", nargs="*", default=["persistence", "kalman"])
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--folder", type=Path, help="of the recording, the run and the samples")
    parser.add_argument("--table", action="store_true", help="only make the table from the samples in the folder")
    given = parser.parse_args(arguments)
    folder = (given.folder or Path(tempfile.mkdtemp(prefix="gridtrack-follow-"))).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    if not given.table:
        print(f"exit code {follow(given.trackers, given.minutes, folder)}; {folder}")
    table = table_of(folder / "samples.csv")
    print(table.markdown())
    write_table(given.out, "following", table, f"python -m benchmarks.follow {' '.join(given.trackers)}")


if __name__ == "__main__":
    main()
