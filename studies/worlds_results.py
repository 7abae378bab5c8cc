"""Trackers with general weights on the twenty test worlds: places that they have not learned.

`python -m studies.worlds_results` compares every tracker with general weights on the worlds of data/worlds/test, and
writes the numbers and the chart of docs/results/worlds. The worlds whose poses come from the wheels of a robot are
compared once more with refined poses (`recording import --ego-motion refined`, which knows the scans and the odometry
alone), the networks with the weights of an equal budget (studies/recipes/equal-budget), and sogmp with the others on
fewer forecasts, since each of its own takes seconds. Forecasts are always scored by the true poses, at the thresholds
of the cards, which were chosen on the validation worlds. An interrupted comparison resumes with the same rows; `--out`
takes another folder for others. On one idle core a network needs a minute per world, sogmp two, the pipeline half, the
floors seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from gridtrack.recordings import open_recording

from studies.support.comparison import gridtrack
from studies.support.results_file import ResultSection, ResultTable, measured_table
from studies.support.unseen_places import (
    CONTACTS,
    CONTACTS_FORESEEN,
    FAMILIES,
    REFERENCE,
    STRATA,
    PlaceScores,
    compare_places,
    compare_rows,
    general_rows,
    not_measured,
    place_parser,
    point_text,
    rows_of,
    worlds_called,
    write_places,
)

RESULTS = Path("docs/results/worlds/worlds.json")
COMMAND = "python -m studies.worlds_results"
FEWEST_POOLED = 2
"""Fewer worlds are not pooled."""
STANDS, DRIVES, ODOMETRY = "stands", "drives", "drives, odometry"
"""The laser stands; it drives and its poses are exact; it drives with the poses of the wheels."""
AIM_TRACKERS, AIM_HORIZONS_S, AIM_F1 = ("dilated-convgru", "kalman"), (0.5, 1.0), 0.10
"""The aim: on dynamic cells at these horizons these trackers exceed the reference by AIM_F1, significantly."""

CONTENDERS = ("kalman", "factor-graph", "dogma", "dilated-convgru", "pool")
"""The trackers that forecast motion and have similar scores, for comparisons in pairs."""
NETWORKS = (*FAMILIES["networks of 2016"], *FAMILIES["learned peers"])
FLOOR = "stationary"
EQUAL_BUDGET = Path("studies/trainings/equal-budget")
"""The weights that had the same hour of a core."""
QUARTER, QUARTER_EVERY = Path("studies/trainings/quarter"), "4s"
"""The weights of sogmp, and the time between two of its forecasts."""


def aim_met(difference: float | None, low: float | None) -> str:
    """Whether a difference meets the aim: at least AIM_F1, with the whole interval above 0."""
    if difference is None or low is None:
        return "no interval"
    return "met" if difference >= AIM_F1 and low > 0 else "not met"


def aim_table(scores: PlaceScores) -> ResultTable:
    """The difference and the verdict by tracker and horizon."""
    rows = []
    for tracker in AIM_TRACKERS:
        for horizon_s in AIM_HORIZONS_S:
            name = f"{tracker} less {REFERENCE}, {horizon_s:g} s"
            if tracker not in scores.differences:
                rows.append([name, "", "not measured"])
                continue
            found = scores.difference(tracker, "dynamic", horizon_s)
            text = "" if found.value is None else point_text(found, signed=True)
            rows.append([name, text, aim_met(found.value, found.low)])
    return measured_table(("F1, dynamic", "difference", "at least 0.10"), rows)


def floor_table(scores: PlaceScores, corner: str, score: str) -> ResultTable:
    """The differences of a contender and a floor on dynamic cells, in the order of the rows of the run."""
    floors = (REFERENCE, *FAMILIES["floors"])
    pairs = scores.pair_table(corner, score, (*floors, *CONTENDERS))
    rows = tuple(row for row in pairs.rows if len({*row[0].split(" less ")} & {*floors}) == 1)
    return pairs.model_copy(update={"rows": rows})


def network_section(scores: PlaceScores) -> ResultSection:
    """The rows of `scores` in a few columns, and the differences between each two networks."""
    columns = [
        *((f"contacts, {h:g} s", "dynamic", CONTACTS, h) for h in AIM_HORIZONS_S),
        ("contacts in motion, 1 s", "in-motion", CONTACTS, 1.0),
        ("PR-AUC in motion, 1 s", "in-motion", "pr_auc", 1.0),
        ("log loss, 1 s", "visible", "log_loss", 1.0),
    ]
    tables = {
        "scores": scores.table("", columns),
        "pairs": scores.pair_table(CONTACTS_FORESEEN, CONTACTS, NETWORKS),
    }
    return ResultSection(command=COMMAND, tables=tables)


def futures_section(scores: PlaceScores) -> ResultSection:
    """The rows of the comparison with sogmp: scores of forecasts, and those that only sampled futures have."""
    columns = [
        *((f"contacts, {h:g} s", "dynamic", CONTACTS, h) for h in AIM_HORIZONS_S),
        ("PR-AUC in motion, 1 s", "in-motion", "pr_auc", 1.0),
        ("log loss, 1 s", "visible", "log_loss", 1.0),
        ("log loss of contacts, from futures, 1 s", "dynamic", f"{CONTACTS}.sampled_log_loss", 1.0),
        ("energy score, 1 s", "visible", "energy", 1.0),
        ("spread of futures, 1 s", "visible", "energy.spread", 1.0),
    ]
    pairs = scores.pair_table(CONTACTS_FORESEEN, CONTACTS, (FLOOR, *NETWORKS))
    values = {"forecasts": str(sum(scores.forecasts.values()))}
    return ResultSection(command=COMMAND, tables={"scores": scores.table("", columns), "pairs": pairs}, values=values)


def sections_of(scores: PlaceScores) -> dict[str, ResultSection]:
    """The sections of the results file."""
    contacts = [(f"{h:g} s", "dynamic", CONTACTS, h) for h in AIM_HORIZONS_S]
    return {
        "scores": ResultSection(
            command=COMMAND,
            tables={
                "contacts": scores.table(
                    CONTACTS_FORESEEN, [*contacts, ("in motion, 1 s", "in-motion", CONTACTS, 1.0)]
                ),
                **{name: scores.over_horizons(f"F1, {name}", stratum, "f1") for stratum, name in STRATA.items()},
                "PR-AUC": scores.over_horizons("PR-AUC, dynamic", "dynamic", "pr_auc"),
            },
            values={
                "forecasts": str(sum(scores.forecasts.values())),
                "not measured": not_measured(scores.labels),
            },
        ),
        "shipped weights": network_section(scores),
        "differences": ResultSection(command=COMMAND, tables={"aim": aim_table(scores)}),
        "pairs": ResultSection(
            command=COMMAND,
            tables={
                "contacts": scores.pair_table("contacts, dynamic", CONTACTS, CONTENDERS),
                "contacts and floors": floor_table(scores, CONTACTS_FORESEEN, CONTACTS),
                "F1 and floors": floor_table(scores, "F1, dynamic", "f1"),
            },
        ),
    }


def laser_of(world: Path) -> str:
    """STANDS, DRIVES or ODOMETRY; in the last case the poses to score by differ from the recorded ones."""
    recording = open_recording(world)
    if next(recording.scans()).reference_T_sensor is not None:
        return ODOMETRY
    (sensor,) = recording.overview().sensors.values()
    return DRIVES if sensor.moves else STANDS


def refined_world(world: Path, folder: Path) -> Path:
    """The world with refined poses, in `folder`; an existing file is kept."""
    path = folder / f"{world.stem}.mcap"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        gridtrack("recording", "import", world, "--out", path, "--ego-motion", "refined")
    return path


def by_laser(groups: Mapping[str, PlaceScores]) -> ResultTable:
    """Contacts foreseen by the motion of the laser; too few worlds each for intervals."""
    rows = [
        [label, *(scores.text(label, "dynamic", CONTACTS, h) for scores in groups.values() for h in AIM_HORIZONS_S)]
        for label in next(iter(groups.values())).labels
    ]
    columns = (f"{name}, {h:g} s" for name in groups for h in AIM_HORIZONS_S)
    return measured_table((CONTACTS_FORESEEN, *columns), rows)


def poses_section(recorded: PlaceScores, refined: PlaceScores, lasers: Mapping[str, str]) -> ResultSection:
    """The cost of wheel odometry: `recorded` are the scores on all worlds, `refined` on worlds with odometry."""
    names = {kind: [name for name, laser in lasers.items() if laser == kind] for kind in (STANDS, DRIVES, ODOMETRY)}
    groups = {kind: recorded.of(found) for kind, found in names.items() if len(found) >= FEWEST_POOLED}
    counted = {f"{kind} ({len(names[kind])})": scores for kind, scores in groups.items()}
    tables = {
        "contacts by laser": by_laser({**counted, "drives, refined": refined}),
        "aim": aim_table(recorded.replaced_by(refined)),
    }
    return ResultSection(command=COMMAND, tables=tables)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = place_parser(__doc__, Path("runs/worlds-results"), RESULTS)
    parser.add_argument("--world", action="append", help="such as indoors-room-1008; default: all twenty")
    given = parser.parse_args(arguments)
    worlds = {path.stem: path for path in worlds_called(given.world)}
    lasers = {name: laser_of(path) for name, path in worlds.items()}
    drivers = {name: worlds[name] for name, laser in lasers.items() if laser == ODOMETRY}
    folders, refined = {"recorded": list(worlds.values())}, {}
    if len(drivers) >= FEWEST_POOLED:
        refined = {name: refined_world(path, given.out / "refined-recordings") for name, path in drivers.items()}
        folders["refined"] = list(refined.values())
    budget_rows, slow_rows = rows_of(EQUAL_BUDGET), rows_of(QUARTER)
    if not given.collect:
        for name, recordings in folders.items():
            compare_places(given, recordings, given.out / name)
        if budget_rows:
            compare_rows(given, list(worlds.values()), list(budget_rows.values()), given.out / EQUAL_BUDGET.name)
        if slow_rows:
            beside = [row for name, row in general_rows(given.weights).items() if name in (REFERENCE, FLOOR, *NETWORKS)]
            rows = [*beside, *slow_rows.values()]
            compare_rows(given, list(worlds.values()), rows, given.out / QUARTER.name, every=QUARTER_EVERY)
    scores = {name: PlaceScores.read(given.out / name) for name in folders}
    sections = sections_of(scores["recorded"])
    if budget_rows:
        equal = PlaceScores.read(given.out / EQUAL_BUDGET.name)
        sections[EQUAL_BUDGET.name] = network_section(
            scores["recorded"].replaced_by(equal).of(labels=(REFERENCE, FLOOR, *NETWORKS))
        )
    if slow_rows:
        sections["sampled futures"] = futures_section(PlaceScores.read(given.out / QUARTER.name))
    if refined:
        sections["poses"] = poses_section(scores["recorded"], scores["refined"], lasers)
    write_places(given.results, sections, scores["recorded"])


if __name__ == "__main__":
    main()
