"""Time of `import gridtrack` and of the command line's --help: whole processes, medians of nine runs.

`python -m benchmarks.import_time` (ten seconds).
"""

from __future__ import annotations

import argparse
import subprocess
import sys

from benchmarks.timing import median_ms

CASES = {
    "import gridtrack": ("-c", "import gridtrack"),
    "a plugin's imports": ("-c", "from gridtrack import Tracker, Forecast, GridFrame"),
    "gridtrack --help": ("-m", "gridtrack.cli", "--help"),
}
RUNS = 9


def process_ms(*arguments: str) -> float:
    """The median time of one Python process."""
    return median_ms(lambda: subprocess.run([sys.executable, *arguments], check=True, capture_output=True), RUNS)


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    empty = process_ms("-c", "pass")
    for name, arguments in CASES.items():
        print(f"{name}: {process_ms(*arguments):.0f} ms (an empty Python process: {empty:.0f} ms)")


if __name__ == "__main__":
    main()
