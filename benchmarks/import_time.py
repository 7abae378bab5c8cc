"""How long `import gridtrack` and the command line's --help take, whole processes, medians of 9 runs."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time


def median_s(*arguments: str) -> float:
    times = []
    for _ in range(9):
        start = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return statistics.median(times)


if __name__ == "__main__":
    bare = median_s("-c", "pass")
    for what, arguments in (
        ("import gridtrack", ("-c", "import gridtrack")),
        ("a plugin's imports", ("-c", "from gridtrack import Tracker, Forecast, GridFrame")),
        ("gridtrack --help", ("-m", "gridtrack.cli", "--help")),
    ):
        print(f"{what}: {median_s(*arguments):.3f} s (an empty Python: {bare:.3f} s)")
