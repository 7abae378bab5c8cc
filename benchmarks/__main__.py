"""All benchmarks that run with the packages of `make test`, one after the other (half an hour).

`python -m benchmarks`. The first lines of the others, `scale`, `side_by_side` and `stone_soup`, name their
requirements.
"""

from __future__ import annotations

import subprocess
import sys

BENCHMARKS = (
    "parts",
    "scoring",
    "harness",
    "recurrent",
    "inference",
    "peers",
    "dogma",
    "model_free",
    "hour",
)


def main() -> None:
    for name in BENCHMARKS:
        print(f"\n{name}", flush=True)
        subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=True)


if __name__ == "__main__":
    main()
