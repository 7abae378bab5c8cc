"""The pooled numbers of a comparison at the junction, for the pages: docs/results/junction/summary.json.

`python -m studies.junction_results [RUN]` (a second) keeps of RUN/summary.json what the pages show: the rows over all
recordings together, of several trainings the first, whose spread is in `trainings`; no pairs, and no single recording.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

SUMMARY = Path("docs/results/junction/summary.json")


def pooled_only(summary: dict[str, Any]) -> dict[str, Any]:
    """The summary without single recordings, pairs, and all but the first training of each tracker."""
    other_trainings = {label for row in summary["trainings"] for label in row["labels"][1:]}
    rows = {label: row for label, row in summary["trackers"].items() if label not in other_trainings}
    return {
        **summary,
        "trackers": {label: {**row, "recordings": {}} for label, row in rows.items()},
        "differences": [one for one in summary["differences"] if one["tracker"] not in other_trainings],
        "pairs": [],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path, nargs="?", default=Path("runs/results"))
    summary = json.loads((parser.parse_args().run / "summary.json").read_text("utf-8"))
    SUMMARY.write_text(json.dumps(pooled_only(summary)) + "\n", "utf-8")


if __name__ == "__main__":
    main()
