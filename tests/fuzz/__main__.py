"""Fuzz the readers for minutes: `make fuzz`, or `PYTHONPATH=tests python -m fuzz --minutes 10 --only "ROS 1 bag"`.

Each reader is fuzzed by hypothesis in processes of its own, with limits of memory and of processor time for each input.
A failure is printed, and its input kept in runs/fuzz.
"""

from __future__ import annotations

import argparse
import resource
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from fuzz.rule import READERS, Inputs

KEPT = Path("runs/fuzz")
MEMORY_BYTES, INPUT_S, EXAMPLES = 4 << 30, 10, 200


@dataclass(frozen=True)
class DrawnChoices:
    """Choices that hypothesis draws, and makes smaller where an input breaks the rule."""

    data: st.DataObject

    def below(self, count: int) -> int:
        """A number from 0 to count - 1."""
        return int(self.data.draw(st.integers(0, count - 1)))


class TooSlow(BaseException):
    """An input took more processor time than any may."""


def main() -> int:
    """Fuzz in turns until the time is over; the number of readers that broke the rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--only", choices=list(READERS), action="append", help="a reader; default: all")
    parser.add_argument("--seed", type=int, default=0, help="of the first turn")
    parser.add_argument("--turn", help=argparse.SUPPRESS)
    given_options = parser.parse_args()
    if given_options.turn:
        return turn(given_options.turn, given_options.seed)
    ends, number, broken = time.monotonic() + 60.0 * given_options.minutes, given_options.seed, set()
    while time.monotonic() < ends:
        for name in given_options.only or READERS:
            if time.monotonic() < ends:
                command = [sys.executable, "-m", "fuzz", "--turn", name, "--seed", str(number)]
                broken |= {name} if subprocess.run(command, check=False).returncode else set()
        number += 1
    print(
        f"{len(broken)} of {len(given_options.only or READERS)} readers broke the rule: {', '.join(broken) or 'none'}"
    )
    return len(broken)


def turn(name: str, number: int) -> int:
    """EXAMPLES damaged inputs of one reader; 1 where one of them breaks the rule."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    signal.signal(signal.SIGPROF, _too_slow)
    refused = [0, 0]
    with TemporaryDirectory() as folder:
        inputs = Inputs(Path(folder))

        @seed(number)
        @settings(
            max_examples=EXAMPLES,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate, Phase.shrink],
        )
        @given(st.data())
        def fuzzed(data: st.DataObject) -> None:
            signal.setitimer(signal.ITIMER_PROF, INPUT_S)
            found = inputs.check(name, DrawnChoices(data), KEPT / name.replace(" ", "-"))
            signal.setitimer(signal.ITIMER_PROF, 0)
            refused[found.refused] += 1

        try:
            fuzzed()
        except (Exception, TooSlow) as error:  # noqa: BLE001  whatever a reader raises is a finding
            signal.setitimer(signal.ITIMER_PROF, 0)
            print(f"{name}, seed {number}: {type(error).__name__}: {str(error)[:300]}; input in {KEPT}", flush=True)
            return 1
    print(f"{name}, seed {number}: {refused[0]} read, {refused[1]} refused", flush=True)
    return 0


def _too_slow(*_: object) -> None:
    raise TooSlow(f"more than {INPUT_S} s of processor time")


if __name__ == "__main__":
    sys.exit(main())
