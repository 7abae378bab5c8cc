"""The readers of untrusted input: for each a small valid input in a folder, its damage, and how it is read."""

from __future__ import annotations

import bz2
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from fuzz.containers import (
    damage_parquet,
    damage_sqlite,
    damaged_bag,
    damaged_mcap,
    damaged_message,
    damaged_safetensors,
)
from fuzz.damage import Choices, damaged_bytes, damaged_json, damaged_text, damaged_value, dumped, one_of
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.pose_quality import PoseQuality
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.comparison.recipe import read_recipe
from gridtrack.evaluation.regression.baseline import digest_of, read_baseline
from gridtrack.evaluation.regression.history import append_entry, read_history
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.results.recording import RecordingSummary
from gridtrack.evaluation.results.run_record import RunConfiguration, RunRecord, TrialIdentity, read_run_record
from gridtrack.evaluation.results.summary import RunSummary, TrackerSummary
from gridtrack.evaluation.results.trial_record import read_trial_record
from gridtrack.evaluation.results.trial_summary import TrialSummary
from gridtrack.evaluation.scoring.histograms import read_tally
from gridtrack.evaluation.scoring.samples import read_samples
from gridtrack.evaluation.scoring.score_store import read_label_free, read_losses
from gridtrack.evaluation.scoring.strata import STRATA
from gridtrack.evaluation.statistics.frame_counts import read_frame_counts
from gridtrack.recordings import RecordingInfo, import_recording, open_recording, write_native
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.stream import open_stream
from gridtrack.reports.run import read_runs
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.tracks import ONLY_LASER, Tracks, TracksInfo
from gridtrack.simulation.tracks_file import METADATA_KEY, write_tracks
from gridtrack.trackers import messages
from gridtrack.trackers.card import Card, CardThresholds, TrainingData
from gridtrack.trackers.contract import Forecast, StreamSpec, TrackedObject
from gridtrack.trackers.selection import read_trackers_toml
from gridtrack.trackers.weights import load_weights, save_weights
from gridtrack.trackers.wire import Message, encode, receive

from scenes.drawn_samples import write_samples
from scenes.drive_bag import FRONT, REAR, Ros, mounts, odometry_transforms, scans_of
from scenes.synthetic_run import description, identity, write_trial

SCANS, BEAMS, STEPS, FRAMES_READ = 6, 24, 2, 3
GRID = GridSpec(20, 0.5)
CLASSES = ("person", "wall")
BOX = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)


@dataclass(frozen=True)
class Reader:
    """A reader: `make` writes a valid input into an empty folder, `damage` changes it, `read` gives a few words."""

    make: Callable[[Path], object]
    damage: Callable[[Choices, Path], None]
    read: Callable[[Path], str]


def scans() -> Iterator[Scan]:
    """A few scans with everything that a native recording can hold."""
    for k in range(SCANS):
        ranges = np.random.default_rng(k).uniform(0.5, 4.5, BEAMS).astype(np.float32)
        scene = Scene((BOX,), 1, (SceneObject(7, 0, SE2(2.0, 0.1 * k), BOX),))
        yield Scan(
            1_000_000_000_000 + k * 100_000_000,
            ranges,
            -1.5,
            0.1,
            0.05,
            5.0,
            world_T_sensor=SE2(0.1 * k, 0.0, 0.01 * k),
            reference_T_sensor=SE2(0.1 * k, 0.01, 0.0),
            labels=np.full(BEAMS, k % 2, np.uint8),
            scene=scene,
            time_increment_s=1e-4,
            pose_quality=PoseQuality("matched", 0.9, 0.01),
        )


def native(folder: Path) -> Path:
    path = folder / "a.mcap"
    with path.open("wb") as file:
        info = RecordingInfo(site="here", classes=CLASSES, grid=str(GRID), rate_hz=10.0, stretches={"test": (0.0, 0.4)})
        write_native(file, info, scans())
    return path


def read_recording(path: Path) -> str:
    """Every scan, the overview, the first frames, and a native copy."""
    recording = open_recording(path)
    count = sum(1 for _ in recording.scans())
    told = [*recording.warnings, *str(open_recording(path).overview()).split("\n")]
    assert all(line.isprintable() for line in told), told
    frames = sum(1 for _ in islice(open_stream(path, grid=GRID), FRAMES_READ))
    import_recording(path, path.parent / "imported.mcap")
    return f"{count} scans, {frames} frames, {len(recording.warnings)} warnings"


def ros_bag(version: int, name: str, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Callable[[Path], object]:
    def make(folder: Path) -> Path:
        ros = Ros(version)
        body = ("base_footprint", "base_link", SE3())
        still = ros.transforms(0, body, *mounts(FRONT, REAR), topic="/tf_static")
        moving = list(odometry_transforms(ros, 300))
        return ros.write(folder / name, [still, *moving, *scans_of(ros, 300, FRONT, REAR)], storage)

    return make


def on_file(name: str, damaged: Callable[[Choices, bytes], bytes]) -> Callable[[Choices, Path], None]:
    """Damage of the only file of that name, or that matches it, in the folder."""

    def damage(choices: Choices, folder: Path) -> None:
        path = one_of(choices, sorted(folder.glob(name)))
        path.write_bytes(damaged(choices, path.read_bytes()))

    return damage


def damage_ros2(choices: Choices, folder: Path) -> None:
    if choices.below(4):
        damage_sqlite(choices, one_of(choices, list(folder.glob("bag/*.db3"))))
    else:
        on_file("bag/metadata.yaml", damaged_text)(choices, folder)


def carmen(name: str) -> Callable[[Path], object]:
    lines = ["# a log", "PARAM robot nohost 0"]
    for k in range(SCANS):
        lines.append(f"FLASER 4 1.5 2.5 3.5 81.83 {k} 1 0.5 9 9 9 {100 + k}.25 host {k}.0")
        lines.append(
            f"ROBOTLASER1 0 -0.3 0.6 0.2 30.0 0.01 0 4 1 2 3 4 1 7 1 {k} 0 9 9 9 0 0 0 0 1e6 {100 + k}.5 host {k}.0"
        )
    text = ("\n".join(lines) + "\n").encode()
    return lambda folder: (folder / name).write_bytes(bz2.compress(text) if name.endswith("bz2") else text)


def damaged_bz2(choices: Choices, content: bytes) -> bytes:
    if choices.below(4):
        return bz2.compress(damaged_text(choices, bz2.decompress(content)))
    return damaged_bytes(choices, content)


def tracks(folder: Path) -> None:
    laser = Laser(angle_min=-np.pi, angle_increment=np.radians(15.0), beams=BEAMS)
    info = TracksInfo(
        recording=RecordingInfo(site="yard", classes=CLASSES, grid=str(GRID), rate_hz=8.0),
        lasers={ONLY_LASER: laser},
        frames=SCANS,
        rate_hz=8.0,
        static=(((2.0, 2.0), (3.0, 2.0), (3.0, 3.0)),),
        static_class="wall",
    )
    zeros, frame = np.zeros(SCANS, np.int64), np.arange(SCANS)
    pose = np.column_stack([frame / 8.0, np.full(SCANS, 3.0), np.zeros(SCANS)])
    with (folder / "a.tracks").open("wb") as file:
        write_tracks(file, Tracks(info, frame, zeros, zeros, pose, np.full((SCANS, 2), 0.5)))


def labels(folder: Path) -> None:
    with (folder / "a.mcap").open("wb") as file:
        write_native(file, RecordingInfo(site="here"), (replace(scan, labels=None, scene=None) for scan in scans()))
    rows = [f"{scan.stamp_ns},{beam},person,scan" for scan in scans() for beam in (0, 5)]
    (folder / "labels.csv").write_text("\n".join(["stamp_ns,beam,class,sensor", *rows]) + "\n")


def read_labels(folder: Path) -> str:
    import_recording(folder / "a.mcap", folder / "labelled.mcap", labels=folder / "labels.csv")
    return "labelled"


def forecast_message(folder: Path) -> None:
    shape = (STEPS + 1, *GRID.shape)
    forecast = Forecast(
        np.full(shape, 0.2, np.float32),
        np.full((STEPS + 1, 2, *GRID.shape), 0.5, np.float32),
        np.zeros((STEPS + 1, 2, *GRID.shape), np.float32),
        (TrackedObject(1, np.zeros(5, np.float32), np.zeros(2, np.float32), np.eye(4, dtype=np.float32), "person"),),
        np.zeros((2, *shape), np.bool_),
    )
    fields, arrays = messages.forecast_fields(forecast)
    write_message(folder, Message("forecast", 3, fields | {"elapsed_ns": 5, "cpu_ns": 5}, arrays))


def write_message(folder: Path, message: Message) -> None:
    (folder / "message.bin").write_bytes(b"".join(encode(message)))


def received(folder: Path, max_body: int) -> Message:
    """The message in the folder; a file that ends in it counts as a process that ended, which the host survives."""
    file = (folder / "message.bin").open("rb")

    def fill(buffers: list[memoryview]) -> None:
        for buffer in buffers:
            if file.readinto(buffer) < buffer.nbytes:
                raise EOFError

    with file:
        return receive(fill, max_body)


def read_forecast(folder: Path) -> str:
    try:
        answer = received(folder, messages.forecast_limit(GRID, STEPS, 2))
    except EOFError:
        return "cut off"
    forecast = messages.forecast_from(answer, GRID, STEPS, 2)
    return f"{answer.value('elapsed_ns', int)} ns, {len(forecast.objects)} objects"


def started_message(folder: Path) -> None:
    lists = {"classes": list(CLASSES), "reference_for": ["classes"]}
    told = {"api": 1, "about": "a", "moving_sensor": True, "learns": False, "role": "tracker", "code_sha256": "a" * 64}
    write_message(folder, Message("started", 1, lists | told | {"options": {"a": 1.5}, "options_schema": {}}))


def read_started(folder: Path) -> str:
    from gridtrack.evaluation.processes.tracker_process import description_from

    try:
        described = description_from(received(folder, 0))
    except EOFError:
        return "cut off"
    assert all(name.isprintable() for name in described.classes)
    json.dumps(dict(described.options), allow_nan=False).encode()
    return f"{len(described.classes)} classes"


def start_message(folder: Path) -> None:
    stream = StreamSpec(GRID, 0.125, "here", CLASSES)
    write_message(folder, Message("start", 1, {"stream": messages.stream_fields(stream), "options": {}}))


def update_message(folder: Path) -> None:
    seen, points = np.ones(GRID.shape, np.bool_), np.zeros((3, 2), np.float32)
    frame = GridFrame(5, seen, seen, SE2(), np.zeros((1, 2), np.float32), points, np.zeros(3, np.uint8))
    write_message(folder, Message("update", 2, {}, messages.frame_arrays(frame)))


def read_request(folder: Path) -> str:
    try:
        request = received(folder, messages.update_limit(GRID))
    except EOFError:
        return "cut off"
    return str(messages.stream_from(request) if "stream" in request.fields else messages.frame_from(request))[:80]


def weights(folder: Path) -> None:
    card = Card(
        tracker="kalman",
        site="here",
        grid=str(GRID),
        period_s=0.125,
        seed=1,
        command="gridtrack train kalman a.mcap",
        train=(TrainingData(recording="a", sha256="0" * 64),),
        thresholds=CardThresholds(step_s=0.125, values={"visible": (0.5, 0.4)}),
        settings={"gate_m": 1.5},
        world_T_grid=(0.0, 0.0),
    )
    save_weights(folder / "a.toml", card, {"rate": np.zeros(GRID.shape, np.float32), "counts": np.arange(4)})


def damage_weights(choices: Choices, folder: Path) -> None:
    if choices.below(2):
        on_file("a.toml", damaged_text)(choices, folder)
        return
    path, card = folder / "a.safetensors", folder / "a.toml"
    known, content = hashlib.sha256(path.read_bytes()), damaged_safetensors(choices, path.read_bytes())
    path.write_bytes(content)
    card.write_text(card.read_text().replace(known.hexdigest(), hashlib.sha256(content).hexdigest()))


def read_weights(folder: Path) -> str:
    found = load_weights(StreamSpec(GRID, 0.125, "here", CLASSES, folder / "a.toml"), "kalman")
    assert found.card.thresholds is None or found.card.thresholds.at("visible", np.array([0.0, 1.0])).size == 2
    return f"{len(found.arrays)} arrays"


def run_folder(folder: Path) -> None:
    described = description(frames=2, steps=STEPS).model_copy(update={"rate_hz": 8.0})
    RunRecord(
        command=("gridtrack", "compare", "a.mcap"),
        configuration=RunConfiguration(
            recordings={"a": identity(described)}, trials={"kalman@a": TrialIdentity(tracker="kalman", options={})}
        ),
        versions={"gridtrack": "0.2.0"},
        status="complete",
    ).write(folder)
    write_trial(folder, "kalman", "a", 0.7, seed=1, frames=2, steps=STEPS)
    trial = TrialSummary(outcome="ok", frames_scored=2, frames_expected=2, strata={})
    summary = RunSummary(
        recordings={"a": RecordingSummary(**dict(described))},
        trackers={"kalman": TrackerSummary(tracker="kalman", recordings={"a": trial})},
    )
    summary.write(folder)


def damage_run(choices: Choices, folder: Path) -> None:
    path = one_of(choices, sorted(path for path in folder.rglob("*") if path.suffix in (".json", ".parquet")))
    if path.suffix == ".json":
        path.write_bytes(damaged_json(choices, path.read_bytes()))
    else:
        damage_parquet(choices, path)


def read_run(folder: Path) -> str:
    (run,) = read_runs([folder])
    read_run_record(folder)
    trial = folder / "kalman@a"
    record = read_trial_record(trial)
    read_losses(trial, STEPS, STRATA)
    read_label_free(trial, STEPS, STRATA)
    read_frame_counts(trial, STEPS, STRATA)
    read_tally(trial, STEPS)
    measure_run(folder)
    return f"{len(run.summary.trackers)} trackers, {record and record.outcome}"


def baseline(folder: Path) -> None:
    shutil.copyfile(Path(__file__).parents[1] / "baselines" / "own_trackers.json", folder / "baseline.json")


def damaged_baseline(choices: Choices, content: bytes) -> bytes:
    if not choices.below(4):
        return damaged_json(choices, content)
    found = json.loads(content)
    found["runs"] = damaged_value(choices, found["runs"])
    return dumped(found | {"digest": digest_of(found["runs"])})


def history(folder: Path) -> None:
    append_entry(folder / "history", [], folder / "none.json", ["nothing was measured"])


def damaged_entry(choices: Choices, content: bytes) -> bytes:
    found = json.loads(content)
    del found["digest"]
    found = damaged_value(choices, found)
    return dumped(found | {"digest": digest_of(found)} if isinstance(found, dict) else found)


def text_file(name: str, text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text(text)


TRACKERS_TOML = '[mine]\ncommand = "./mine --fast"\n\n[other]\npython = "env/bin/python"\ntracker = "kalman"\n'
RECIPE = 'tracker = "kalman"\nrecordings = ["a.mcap@0s-5s"]\nseed = 3\nrate_hz = 8.0\n[options]\ngate_m = 1.5\n'

READERS: dict[str, Reader] = {
    "native MCAP": Reader(native, on_file("a.mcap", damaged_mcap), lambda f: read_recording(f / "a.mcap")),
    "native MCAP, raw": Reader(native, on_file("a.mcap", damaged_bytes), lambda f: read_recording(f / "a.mcap")),
    "ROS MCAP": Reader(
        ros_bag(2, "bag", StoragePlugin.MCAP), on_file("bag/*.mcap", damaged_mcap), lambda f: read_recording(f / "bag")
    ),
    "ROS 1 bag": Reader(ros_bag(1, "a.bag"), on_file("a.bag", damaged_bag), lambda f: read_recording(f / "a.bag")),
    "ROS 2 bag": Reader(ros_bag(2, "bag"), damage_ros2, lambda f: read_recording(f / "bag")),
    "CARMEN log": Reader(carmen("a.clf"), on_file("a.clf", damaged_text), lambda f: read_recording(f / "a.clf")),
    "CARMEN log, bzip2": Reader(
        carmen("a.clf.bz2"), on_file("a.clf.bz2", damaged_bz2), lambda f: read_recording(f / "a.clf.bz2")
    ),
    "tracks": Reader(
        tracks,
        lambda choices, folder: damage_parquet(choices, folder / "a.tracks", METADATA_KEY),
        lambda f: read_recording(f / "a.tracks"),
    ),
    "labels": Reader(labels, on_file("labels.csv", damaged_text), read_labels),
    "wire, forecast": Reader(forecast_message, on_file("message.bin", damaged_message), read_forecast),
    "wire, started": Reader(started_message, on_file("message.bin", damaged_message), read_started),
    "wire, start": Reader(start_message, on_file("message.bin", damaged_message), read_request),
    "wire, update": Reader(update_message, on_file("message.bin", damaged_message), read_request),
    "weights": Reader(weights, damage_weights, read_weights),
    "run": Reader(run_folder, damage_run, read_run),
    "samples": Reader(
        lambda folder: write_samples(folder / "forecasts.mcap"),
        on_file("forecasts.mcap", damaged_mcap),
        lambda f: f"{sum(1 for _ in read_samples(f / 'forecasts.mcap'))} samples",
    ),
    "baseline": Reader(
        baseline, on_file("baseline.json", damaged_baseline), lambda f: str(read_baseline(f / "baseline.json"))[:40]
    ),
    "history": Reader(
        history, on_file("history/*.json", damaged_entry), lambda f: f"{len(read_history(f / 'history'))} entries"
    ),
    "trackers.toml": Reader(
        text_file("trackers.toml", TRACKERS_TOML),
        on_file("trackers.toml", damaged_text),
        lambda f: f"{len(read_trackers_toml(f / 'trackers.toml'))} trackers",
    ),
    "recipe": Reader(
        text_file("recipe.toml", RECIPE),
        on_file("recipe.toml", damaged_text),
        lambda f: read_recipe(f / "recipe.toml").command[:40],
    ),
}
