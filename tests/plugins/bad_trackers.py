"""Trackers that violate the contract on purpose, at the call of the option `at` or as the name says."""

from __future__ import annotations

import ctypes
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker

Stage = Literal["start", "reset", "update", "predict", "every"]


class At(Settings):
    at: Stage = "update"


class Good(Tracker):
    """The correct base class: forecasts free cells."""

    Options = At

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self._maybe("start")

    def reset(self, seed: int) -> None:
        self._maybe("reset")

    def update(self, frame: GridFrame) -> None:
        self._maybe("update")

    def predict(self, steps: int) -> Forecast:
        self._maybe("predict")
        return Forecast(self.occupancy(steps))

    def occupancy(self, steps: int) -> Any:
        return np.zeros((steps + 1, *self.stream.grid.shape), np.float32)

    def _maybe(self, stage: str) -> None:
        if self.options.at in (stage, "every"):
            self.misbehave()

    def misbehave(self) -> None:
        """The violation of the subclass."""


class Raises(Good):
    def misbehave(self) -> None:
        raise ValueError("the gate is\nnegative")


class Hangs(Good):
    def misbehave(self) -> None:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        while True:
            time.sleep(3600)


class KillsItself(Good):
    def misbehave(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Segfaults(Good):
    def misbehave(self) -> None:
        ctypes.string_at(0)


class Leaves(Good):
    def misbehave(self) -> None:
        os._exit(0)


class Exits(Good):
    def misbehave(self) -> None:
        sys.exit("no licence for this machine")


class Hogs(Good):
    def misbehave(self) -> None:
        self.hoard = [np.ones(1 << 22, np.uint8) for _ in range(256)]  # 1 GiB in steps of 4 MiB
        time.sleep(3600)


class HogsInAChild(Good):
    def misbehave(self) -> None:
        code = "import time; hoard = [bytearray(b'x' * (1 << 22)) for _ in range(256)]; time.sleep(3600)"
        subprocess.run([sys.executable, "-S", "-c", code], check=True)


class OutOfMemory(Good):
    def misbehave(self) -> None:
        raise MemoryError


class WrongShape(Good):
    def occupancy(self, steps: int) -> Any:
        return np.zeros((steps, *self.stream.grid.shape), np.float32)


class HugeShape(Good):
    def occupancy(self, steps: int) -> Any:
        return np.zeros((4096 * (steps + 1), *self.stream.grid.shape), np.float32)


class WrongType(Good):
    def occupancy(self, steps: int) -> Any:
        return np.zeros((steps + 1, *self.stream.grid.shape), np.float64)


class NotAnArray(Good):
    def occupancy(self, steps: int) -> Any:
        return [[0.0]]


class StopsTheClock(Good):
    """Takes 15 ms for each call, and none by the clock of its process."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        time.perf_counter_ns = lambda: 0

    def update(self, frame: GridFrame) -> None:
        time.sleep(0.015)

    def predict(self, steps: int) -> Forecast:
        time.sleep(0.015)
        return super().predict(steps)


class HasValue(Good):
    """Puts `value` into one cell."""

    class Options(Settings):
        value: str
        at: str = ""

    def occupancy(self, steps: int) -> Any:
        occupancy = np.zeros((steps + 1, *self.stream.grid.shape), np.float32)
        occupancy[-1, -1, -1] = float(self.options.value)
        return occupancy


class PredictsNone(Good):
    def predict(self, steps: int) -> Any:
        return None


class OtherObjects(Good):
    """Objects that are numbers, or that are not a sequence."""

    class Options(Settings):
        objects: Any = (1, 2)
        at: str = ""

    def predict(self, steps: int) -> Forecast:
        return Forecast(self.occupancy(steps), objects=self.options.objects)


class LopsidedClasses(Good):
    """Class probabilities that sum to 0.8."""

    classes = ("car", "person")

    def predict(self, steps: int) -> Forecast:
        occupancy = self.occupancy(steps)
        return Forecast(occupancy, np.full((steps + 1, 2, *self.stream.grid.shape), 0.4, np.float32))


class ObjectArray(Good):
    def occupancy(self, steps: int) -> Any:
        return np.full((steps + 1, *self.stream.grid.shape), None)


class ClassesAsAWord(Good):
    classes = "car"  # type: ignore[assignment]


class PrintsEverywhere(Good):
    """Writes to stdout from Python, from C and from a subprocess, and reads from stdin."""

    def misbehave(self) -> None:
        print("from python")
        ctypes.CDLL(None).puts(b"from C")
        ctypes.CDLL(None).fflush(None)
        os.write(1, b"to descriptor 1\n")
        subprocess.run(["echo", "from a subprocess"], check=True)
        assert sys.stdin.read() == ""


class SpamsStderr(Good):
    def misbehave(self) -> None:
        print("the beginning", file=sys.stderr)
        for _ in range(200):
            print("spam " * 10_000, file=sys.stderr)
        print("the end", file=sys.stderr)


class ClosesItsPipe(Good):
    def misbehave(self) -> None:
        os.closerange(3, 64)
        time.sleep(3600)


class Forks(Good):
    """Leaves a child process behind: in this session, or (`how=setsid`) detached like a daemon."""

    class Options(At):
        how: Literal["fork", "setsid"] = "fork"
        pid_file: str = ""
        die: bool = False

    def misbehave(self) -> None:
        if os.fork() == 0:
            if self.options.how == "setsid":
                os.setsid()
                if os.fork():
                    os._exit(0)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            partial = Path(self.options.pid_file + ".partial")
            partial.write_text(str(os.getpid()))
            partial.rename(self.options.pid_file)
            time.sleep(3600)
        while not Path(self.options.pid_file).exists():
            time.sleep(0.001)
        if self.options.die:
            os._exit(3)


class NeedsWeights(Good):
    def misbehave(self) -> None:
        raise WeightsError("weights of another grid" if self.stream.weights else "needs-weights: no weights")


class NeedsMissingModule(Good):
    def misbehave(self) -> None:
        import a_module_nobody_has  # noqa: F401


class CountsPredictions(Good):
    """Its state changes in predict."""

    calls = 0

    def predict(self, steps: int) -> Forecast:
        self.calls += 1
        return Forecast(np.full((steps + 1, *self.stream.grid.shape), 1.0 / self.calls, np.float32))

    def reset(self, seed: int) -> None:
        self.calls = 0


class Recovers(Good):
    """Reports a recovered failure in the third frame of a stream."""

    class Options(At):
        count: int = 1

    frames = 0

    def reset(self, seed: int) -> None:
        self.frames = 0

    def update(self, frame: GridFrame) -> None:
        self.frames += 1

    @property
    def recoveries(self) -> int:
        return self.options.count if self.frames >= 3 else 0


class NeverForgets(Good):
    """Reset does not clear the state of the last stream."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.seen = np.zeros(stream.grid.shape, np.float32)

    def update(self, frame: GridFrame) -> None:
        self.seen = 0.9 * self.seen + 0.1 * frame.occupied

    def occupancy(self, steps: int) -> Any:
        return np.tile(self.seen.astype(np.float32), (steps + 1, 1, 1))


class RollsDice(Good):
    """Ignores its seed."""

    def occupancy(self, steps: int) -> Any:
        return np.random.default_rng().random((steps + 1, *self.stream.grid.shape), np.float32)


class DrawsOtherFutures(Good):
    """Its sampled futures ignore its seed."""

    def predict(self, steps: int) -> Forecast:
        occupancy = self.occupancy(steps)
        return Forecast(occupancy, futures=np.random.default_rng().random((4, *occupancy.shape)) < 0.5)


class FailsOnEmptyInput(NeverForgets):
    def reset(self, seed: int) -> None:
        self.seen[:] = 0.0

    def update(self, frame: GridFrame) -> None:
        self.seen = np.float32(frame.occupied.sum(axis=0) / int(frame.visible.sum())) * np.ones_like(self.seen)


class KeepsToOneGrid(Good):
    """Assumes 40 cells a side."""

    def occupancy(self, steps: int) -> Any:
        return np.zeros((steps + 1, 40, 40), np.float32)


class RecognisesTheStream(Good):
    """Keeps the last stream, and forecasts its frames in the next one while that begins alike."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.last: list[Any] = []
        self.now: list[Any] = []

    def reset(self, seed: int) -> None:
        self.last, self.now = self.now, []

    def update(self, frame: GridFrame) -> None:
        self.now.append(frame.occupied)

    def occupancy(self, steps: int) -> Any:
        known = self.known()
        indices = np.minimum(len(self.now) - 1 + np.arange(steps + 1), len(known) - 1)
        return np.stack([known[index] for index in indices]).astype(np.float32)

    def known(self) -> list[Any]:
        alike = len(self.last) > len(self.now) and np.array_equal(self.last[: len(self.now)], self.now)
        return self.last if alike else self.now


class RemembersTheFuture(RecognisesTheStream):
    """Forecasts the frames of the last stream however the next one begins."""

    def known(self) -> list[Any]:
        return self.last or self.now


class KeptIn(At):
    file: str = ".npy"


class KeepsAFile(RecognisesTheStream):
    """Forecasts the frames of an earlier process, which left them in a file."""

    Options = KeptIn

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.file = Path(options.file)
        self.kept = list(np.load(self.file)) if self.file.is_file() else []

    def known(self) -> list[Any]:
        if not self.kept:
            np.save(self.file, np.array(self.now))
        return self.kept or self.now


class StaysBehind(NeverForgets):
    """Keeps observations at their place in the window, not in the world."""

    moving_sensor = True

    def reset(self, seed: int) -> None:
        self.seen[:] = 0.0


class KeepsToOnePeriod(Good):
    """Assumes 8 Hz."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.rate = 1 // int(stream.period_s == 0.125)


class SharesPages(Good):
    """Thirty forks that share 60 MB with it: resident memory adds up to 2 GB."""

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self._pages = np.ones(60 << 17)
        for _ in range(30):
            if os.fork() == 0:
                time.sleep(3600)

    def update(self, frame: GridFrame) -> None:
        time.sleep(0.3)


class HidesInAMemfd(Good):
    """Writes a gigabyte to a file in memory that has no name and that it does not map."""

    def update(self, frame: GridFrame) -> None:
        hidden = os.memfd_create("hidden")
        for _ in range(256):
            os.write(hidden, bytes(1 << 22))
        time.sleep(3600)


class LeavesFiles(Good):
    """Leaves files in its temporary folder and in shared memory, where one of them is mapped and closed."""

    def update(self, frame: GridFrame) -> None:
        Path(tempfile.mkdtemp(), "left").write_bytes(bytes(1000))
        names = [f"/dev/shm/gridtrack-test-{os.getpid()}-{kind}" for kind in ("open", "mapped")]
        self._left = [open(name, "w+b") for name in names]  # noqa: SIM115, PTH123  left open on purpose
        for file in self._left:
            file.write(bytes(5000))
            file.flush()
        self._mapped = mmap.mmap(self._left[1].fileno(), 0)
        self._left.pop().close()
        print(tempfile.gettempdir(), *names, file=sys.stderr, flush=True)
        time.sleep(0.3)  # the supervisor looks 20 times a second


class NotATracker(dict):  # type: ignore[type-arg]
    """No subclass of Tracker."""


class TakesAnyOption(Good):
    class Options(At, extra="allow"):
        pass


class KeepsToOneHorizon(Good):
    """Forecasts five steps, whatever it is asked for."""

    def occupancy(self, steps: int) -> Any:
        return super().occupancy(5)


class NamesClassesAlone(Good):
    """Names classes, and gives no probabilities of them."""

    classes = ("car", "person")


class NeedsEveryFrame(Good):
    """Refuses a frame that does not follow the last one by a period."""

    last_ns = -1

    def reset(self, seed: int) -> None:
        self.last_ns = -1

    def update(self, frame: GridFrame) -> None:
        if self.last_ns >= 0 and frame.stamp_ns > self.last_ns + 1.5e9 * self.stream.period_s:
            raise ValueError("a frame is missing")
        self.last_ns = frame.stamp_ns
