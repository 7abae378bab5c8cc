"""What a map of the site and the cells' centres change for `kalman`: without the map, and with the laser's returns.

`python -m studies.map_and_returns` (ten minutes) runs studies/recipes/map-and-returns.toml in runs/returns.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

from studies.support.comparison import compare_at_junction

RECIPE = Path("studies/recipes/map-and-returns.toml")


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    rows = tomllib.loads(RECIPE.read_text())
    compare_at_junction(rows["trackers"], rows["reference"], Path(rows["out"]))


if __name__ == "__main__":
    main()
