"""All benchmarks that need no more than what `make test` installs, one after the other (half an hour).

`python -m benchmarks`. The others, `follow`, `junction`, `report_size`, `scale` and `stone_soup`, name what they need
in their first lines.
"""

from __future__ import annotations

import subprocess
import sys

BENCHMARKS = (
    "import_time",
    "raycast",
    "moving_sensor",
    "ego_motion",
    "scoring",
    "statistics",
    "harness",
    "recurrent",
    "inference",
    "dogma",
    "model_free",
    "estimators",
    "hour",
)


def main() -> None:
    for name in BENCHMARKS:
        print(f"\n{name}", flush=True)
        subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=True)


if __name__ == "__main__":
    main()
