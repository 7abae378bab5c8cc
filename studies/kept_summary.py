"""What the pages show of a comparison: docs/results/PLACE/summary.json.

`python -m studies.kept_summary RUN PLACE` (a second; `runs/results junction` after `make results`, `runs/demo
leg_tracker` after `make demo`) keeps the pooled scores of RUN/summary.json, of a run of one recording its scores; no
pairs; and of several trainings the first, whose spread is in `trainings`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

RESULTS = Path("docs/results")


def kept(summary: dict[str, Any]) -> dict[str, Any]:
    """The summary without pairs, single recordings of several, and all but the first training of each tracker."""
    other_trainings = {label for row in summary["trainings"] for label in row["labels"][1:]}
    rows = {label: row for label, row in summary["trackers"].items() if label not in other_trainings}
    return {
        **summary,
        "trackers": {
            label: {**row, "recordings": {} if row["pooled"] else row["recordings"]} for label, row in rows.items()
        },
        "differences": [one for one in summary["differences"] if one["tracker"] not in other_trainings],
        "pairs": [],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path, help="folder of a comparison, such as runs/results")
    parser.add_argument("place", help="junction or leg_tracker")
    given = parser.parse_args()
    summary = json.loads((given.run / "summary.json").read_text("utf-8"))
    out = RESULTS / given.place / "summary.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(kept(summary)) + "\n", "utf-8")


if __name__ == "__main__":
    main()
