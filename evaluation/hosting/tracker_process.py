"""The referee's side of a tracker process: start, updates, forecasts, timing, and a guaranteed end."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, PluginError
from gridtrack.common.files import LABEL_RULE, is_label
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.hosting.dialogue import Dialogue, Request
from gridtrack.evaluation.hosting.host import shielded_environment
from gridtrack.evaluation.hosting.limits import SCRATCH, Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.sandbox import check_sandbox, confine, system_call_filter
from gridtrack.evaluation.hosting.supervised import SupervisedProgram
from gridtrack.evaluation.hosting.timing import Call, Timings, clock_that_counts
from gridtrack.trackers import messages
from gridtrack.trackers.contract import ComparedPart, Forecast, Role, StreamSpec
from gridtrack.trackers.registry import api_breach
from gridtrack.trackers.selection import Launch
from gridtrack.trackers.training.weights import ARRAYS_SUFFIX
from gridtrack.trackers.wire import Message, TooLargeError, WireError

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
    "TBB_NUM_THREADS",
)


@dataclass(frozen=True, slots=True)
class TrackerDescription:
    """A tracker's description of itself: its classes, capabilities, and options with all defaults."""

    classes: tuple[str, ...]
    moving_sensor: bool
    learns: bool
    options: Mapping[str, Any]
    options_schema: Mapping[str, Any]
    """JSON schema of its options; empty if it has none."""
    about: str
    role: Role = "tracker"
    reference_for: frozenset[ComparedPart] = frozenset()
    """The comparisons in which the other rows are compared with this tracker by default."""
    code_sha256: str = ""
    """Hash of the code that runs; empty if it is not known, as without a stream."""
    device: str = ""
    """The name of the device on which it computes; empty for the processor."""


class HeldForecasts:
    """Counts the bytes of a tracker's forecasts in this process until the last reference to their arrays is gone."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.held_bytes = 0

    @property
    def left_bytes(self) -> int:
        """The limit of the next forecast, bytes."""
        return max(0, self.max_bytes - self.held_bytes)

    def add(self, forecast: Forecast) -> None:
        """Count the arrays of `forecast`; arrays that share their memory count once."""
        planes = (forecast.occupancy, forecast.semantics, forecast.velocity, forecast.futures)
        owners = {id(owner): owner for owner in map(_owner, filter(lambda plane: plane is not None, planes))}
        for owner in owners.values():
            self.held_bytes += owner.nbytes
            weakref.finalize(owner, self._release, owner.nbytes)

    def _release(self, count: int) -> None:
        self.held_bytes -= count


def _owner(array: Any) -> NDArray[Any]:
    """The array that owns the memory of `array`."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return np.asarray(array)


class TrackerProcess:
    """A context manager: entering starts the tracker on `stream`, leaving ends it and all its processes.

    Every method raises TrialEnded when the trial cannot continue; the process has then been ended. An instance is for
    one thread; only `kill` may be called from any thread.
    """

    def __init__(
        self,
        launch: Launch,
        stream: StreamSpec,
        options: Mapping[str, Any],
        limits: Limits,
        stderr_path: Path,
        recordings: Iterable[Path] = (),
        files: Iterable[Path] = (),
        *,
        classes_used: bool = True,
    ) -> None:
        """`recordings`: the source of the frames; the process gets no environment variable that names one. `files`: its
        inputs beside its weights, which it sees in a sandbox too.

        Without `classes_used` class probabilities are checked and not kept. The caller may hold forecasts of
        `limits.memory_mb` in total.
        """
        self.launch = launch
        self.stream = stream
        self.options = dict(options)
        self.limits = limits
        self.stderr_path = stderr_path
        self._recordings, self._files = tuple(recordings), tuple(files)
        self.timings = Timings()
        self.last_call: Call | None = None
        self._recoveries = [0]
        self.peak_rss_mb = 0.0
        """Peak resident memory of all its processes together, MiB, sampled 20 times a second; set at its end."""
        self.description: TrackerDescription
        self._classes_used = classes_used
        self._held = HeldForecasts(limits.memory_mb << 20)
        self._frames = 0
        self._killed = False
        self._has_futures: bool | None = None
        self._dialogue: Dialogue | None = None

    def __enter__(self) -> TrackerProcess:
        card = self.stream.weights and self.stream.weights.absolute()
        files = (*self._files, card, card.with_suffix(ARRAYS_SUFFIX)) if card else self._files
        self._dialogue = _dialogue(self.launch, self.limits, self.stderr_path, self._recordings, files)
        request = Request("start", "started", {"stream": messages.stream_fields(self.stream), "options": self.options})
        with self._ending_on_error():
            if self._killed:
                self._dialogue.process.kill()
            described = description_from(self._dialogue.ask(request, self.limits.start_s))
            code = described.code_sha256 or self.launch.code_sha256()
            self.description = replace(described, code_sha256=code)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close(orderly=kind is None)

    def reset(self, seed: int) -> None:
        """A new stream begins."""
        self._frames = 0
        self._recoveries.append(0)
        with self._ending_on_error():
            self._wire.ask(Request("reset", "done", {"seed": seed}), self.limits.start_s)

    def update(self, frame: GridFrame) -> None:
        """Send frame x_t."""
        self._frames += 1
        what = f"update with frame {self._frames}"
        request = Request("update", "done", arrays=messages.frame_arrays(frame), what=what)
        with self._ending_on_error():
            answer = self._wire.ask(request, self.limits.update_s)
            self.timings.updates.append(self._call(answer))
            self._recoveries[-1] = _recoveries(answer)

    def predict(self, steps: int) -> Forecast:
        """The forecast of steps 0..steps, validated: shapes, types, finite, in [0, 1], semantics sum to 1."""
        classes, grid = len(self.description.classes), self.stream.grid
        largest, left = messages.forecast_limit(grid, steps, classes), self._held.left_bytes
        what = f"predict after frame {self._frames}"
        request = Request("predict", "forecast", {"steps": steps}, limit=min(largest, left), what=what)
        with self._ending_on_error():
            try:
                answer = self._wire.ask(request, self.limits.predict_s)
            except TooLargeError as error:
                if left >= largest:
                    raise
                reason = (
                    f"its forecasts that wait for their frames take more than {self.limits.memory_mb} MB in the host:"
                    " forecast fewer classes or futures, or raise --memory"
                )
                raise TrialEnded("out-of-memory", f"{what}: {reason}") from error
            self.timings.forecasts.append(self._call(answer))
            gaps = self.description.role == "recorded"
            forecast = messages.forecast_from(answer, grid, steps, classes, gaps=gaps)
            self._refuse_other_parts(forecast)
            if forecast.semantics is not None and not self._classes_used:
                forecast = messages.without_semantics(forecast)
            self._held.add(forecast)
            return forecast

    def export(self, folder: Path) -> str:
        """Let the tracker write its export into the empty `folder`; returns its line about the files."""
        request = Request("export", "exported", {"folder": str(folder.absolute())})
        with self._ending_on_error():
            answer = self._wire.ask(request, self.limits.start_s)
            return answer.value("about", str)

    def _refuse_other_parts(self, forecast: Forecast) -> None:
        """Raises WireError if some forecasts have sampled futures and others have none."""
        has_futures = forecast.futures is not None
        if self._has_futures not in (None, has_futures):
            found = "futures" if has_futures else "no futures"
            raise WireError(
                f"{found} in this forecast, unlike in the first one: a tracker gives futures in all of its"
                " forecasts or in none"
            )
        self._has_futures = has_futures

    def kill(self) -> None:
        """End the tracker from any thread: the current or next call raises TrialEnded."""
        self._killed = True
        if self._dialogue is not None:
            self._dialogue.process.kill()

    @property
    def recoveries(self) -> int:
        """Number of failures that the tracker recovered from, by its own count, over all streams."""
        return sum(self._recoveries)

    @property
    def last_ms(self) -> float:
        """Duration of the last update or forecast, ms, by the clock that counts for it alone."""
        assert self.last_call is not None
        call = self.last_call
        clock = clock_that_counts(call.own_ms, call.round_trip_ms)
        return call.own_ms if clock == "tracker" else call.round_trip_ms

    @property
    def _wire(self) -> Dialogue:
        assert self._dialogue is not None, "a TrackerProcess is used in a with statement"
        return self._dialogue

    def _call(self, answer: Message) -> Call:
        elapsed_ns, _ = (_nanoseconds(answer, name) for name in ("elapsed_ns", "cpu_ns"))
        round_trip_ms = self._wire.round_trip_ms
        self.last_call = Call(min(elapsed_ns / 1e6, round_trip_ms), round_trip_ms)
        return self.last_call

    @contextmanager
    def _ending_on_error(self) -> Iterator[None]:
        """An error in the block ends the process; an invalid answer ends the trial."""
        try:
            yield
        except WireError as error:
            self._close(orderly=False)
            raise TrialEnded("invalid-output", f"{self._wire.what}: {error}") from None
        except BaseException:
            self._close(orderly=False)
            raise

    def _close(self, orderly: bool) -> None:
        self.peak_rss_mb = self._wire.process.close(orderly).peak_kb / 1024


def describe(launch: Launch, options: Mapping[str, Any], limits: Limits) -> TrackerDescription:
    """The tracker's description of itself with `options`, without a stream.

    Raises ConfigurationError for options that it refuses, PluginError where it cannot be loaded.
    """
    request = Request("describe", "described", {"options": dict(options)})
    with TemporaryDirectory() as folder, _dialogue(launch, limits, Path(folder, "stderr.log")) as dialogue:
        try:
            return description_from(dialogue.ask(request, limits.start_s))
        except WireError as error:
            raise PluginError(f"tracker '{launch.name}': describe: {error}") from None
        except TrialEnded as ended:
            if ended.outcome == "not-applicable":
                raise ConfigurationError(ended.reason) from None
            raise PluginError(ended.reason) from None


def _dialogue(
    launch: Launch, limits: Limits, log: Path, recordings: tuple[Path, ...] = (), files: tuple[Path, ...] = ()
) -> Dialogue:
    """Start the program. In the sandbox it sees the `files`, but neither `recordings` nor the run with the `log`."""
    argv, env = launch.argv, shielded_environment(recordings)
    threads = dict.fromkeys(THREAD_VARIABLES, str(limits.threads))
    how: dict[str, Any] = {"log": log, "memory_mb": limits.memory_mb, "cwd": launch.cwd}
    if not limits.sandbox:
        # threads of libraries do not survive a fork
        how["from_nursery"] = launch.in_this_python and limits.threads == 1
        return Dialogue(SupervisedProgram(argv, env | threads, **how), log, limits.memory_mb)
    check_sandbox()
    with system_call_filter() as number:
        run = _folders_of_run(log.absolute())
        argv, env = confine(launch, env, limits.memory_mb, recordings, run, files, number)
        program = SupervisedProgram(argv, env | threads, inherited=(number,), **how)
    return Dialogue(program, log, limits.memory_mb)


def _folders_of_run(log: Path) -> tuple[Path, ...]:
    """The folders of a trial, with its tracker's `log`, and of its run; on a cluster the run's folder is further up."""
    scratch = next((folder for folder in log.parents[2:] if folder.name == SCRATCH), None)
    return (*log.parents[:2], scratch.parent) if scratch else tuple(log.parents[:2])


def _nanoseconds(answer: Message, name: str) -> int:
    """A duration by the tracker's own clock, ns. Raises WireError if it is negative or too large."""
    span = answer.value(name, int)
    if not 0 <= span < 1 << 63:
        raise WireError(f"'{name}' is no duration; expected nanoseconds from 0 to 2^63 - 1")
    return span


def _recoveries(answer: Message) -> int:
    """Number of failures since the start of the stream that the tracker recovered from; 0 if the field is missing.

    Raises WireError.
    """
    count = answer.value("recoveries", int) if "recoveries" in answer.fields else 0
    if not 0 <= count < 1 << 31:
        raise WireError(f"'recoveries' is {count}; expected a count from 0 to 2^31 - 1")
    return count


def description_from(answer: Message) -> TrackerDescription:
    """The content of the answers `started` and `described`. Raises WireError."""
    classes = answer.value("classes", list)
    if len(classes) > messages.MAX_CLASSES:
        raise WireError(f"{len(classes)} classes; at most {messages.MAX_CLASSES}")
    if not all(isinstance(name, str) and is_label(name) for name in classes) or len(set(classes)) != len(classes):
        raise WireError(f"classes {classes!r:.80} are not distinct names: {LABEL_RULE}")
    if problem := api_breach(answer.value("api", int), fits=False):
        raise WireError(problem)
    return TrackerDescription(
        tuple(classes),
        answer.value("moving_sensor", bool),
        answer.value("learns", bool),
        answer.value("options", dict),
        answer.value("options_schema", dict),
        answer.value("about", str),
        messages.role_from(answer),
        messages.reference_for_from(answer),
        messages.code_sha256_from(answer),
        messages.device_from(answer),
    )
