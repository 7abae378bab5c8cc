"""The pooled table of twenty recordings comes first, with intervals, and differences have verdicts."""

import copy
import io
import math
import re
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from gridtrack.common.notices import Notice
from gridtrack.evaluation.runs.summary import NO_ESTIMATE, PairFamily, PairTest
from gridtrack.reports import terminal
from gridtrack.reports.answer import answer_of
from gridtrack.reports.chosen_scores import exported_tables
from gridtrack.reports.differences import difference_table, groups_of
from gridtrack.reports.formats import pull_request_markdown
from gridtrack.reports.markdown import escaped
from gridtrack.reports.notices import notices_of
from gridtrack.reports.page import render_page
from gridtrack.reports.run import chosen_runs, read_runs
from gridtrack.reports.table import headline_markdown, headline_tables, main_tables

from scenes.edited_run import edited, put
from scenes.report_page import data_of
from scenes.synthetic_run import RECORDINGS

SKILLS = ("persistence", "good", "<b>even", "unlucky", "oracle")


@pytest.fixture
def changed(twenty, tmp_path):
    """`changed(change)` reads the run with another summary, which `change(summary)` changed."""

    def changed(change):
        return read_runs([edited(twenty, tmp_path, change)])

    return changed


@pytest.fixture(scope="module")
def pooled(twenty):
    (table,) = main_tables(headline_tables(read_runs([twenty])))
    return table


@pytest.fixture(scope="module")
def page(twenty_report):
    return twenty_report.read_text("utf-8")


def test_all_recordings_together_are_the_first_and_the_main_table(twenty, pooled):
    tables = headline_tables(read_runs([twenty]))
    assert [table.recording for table in tables] == ["all recordings", *RECORDINGS]
    assert pooled is not tables[1]
    assert {label.label: label.frames for label in pooled.rows}["good"] == "80"


def test_the_ceiling_is_a_group_of_its_own_and_never_marked_best(pooled):
    (oracle,) = pooled.rows_in("ceiling")
    assert oracle.cells[0].value > max(row.cells[0].value for row in pooled.rows_in("ranked"))
    assert not any(cell.best for cell in oracle.cells)
    assert [row.label for row in pooled.rows if row.cells[0].best] == ["good"]


def test_a_tracker_that_missed_a_recording_is_not_ranked_and_says_on_how_many(pooled, page):
    assert [row.label for row in pooled.rows_in("unranked")] == ["unlucky"]
    assert '<li class="serious">unlucky: crashed on 1 of 20 recordings; 76 of 80 frames scored, not ranked' in page


def test_a_tracker_that_failed_on_many_recordings_is_one_notice_wherever_notices_are(changed):
    """It crashed on 18 recordings for one reason and one other, and was out of time on one."""

    def fail(summary):
        unlucky = summary["trackers"]["unlucky"]
        failed = [("crashed", "no card")] * 18 + [("crashed", "killed"), ("timeout", "update: 5 s")]
        for trial, (outcome, reason) in zip(unlucky["recordings"].values(), failed, strict=True):
            trial |= {"outcome": outcome, "reason": reason, "frames_scored": 0}
        unlucky["pooled"] |= {"outcome": "partial", "frames_scored": 0, "recordings_complete": 0}

    runs = changed(fail)
    expected = (
        "unlucky: crashed on 19 of 20 recordings (no card and others); timeout on 1 of 20 recordings (update: 5 s);"
        " nothing scored"
    )
    notices = [notice.text for notice in notices_of(runs, headline_tables(runs)) if "unlucky" in notice.text]
    assert notices == [expected]
    (row,) = headline_tables(runs)[0].rows_in("unranked")
    assert row.outcome == "crashed, timeout"
    assert expected in pull_request_markdown(runs, exported_tables([*runs]))


def test_the_page_calls_better_only_a_significantly_better_tracker(page):
    differences = page.partition("Difference from persistence")[2].partition("</section>")[0]
    good, even = (differences.partition(name)[2].partition("</tr>")[0] for name in (">good<", "&lt;b&gt;even"))
    assert good.count(", better</small>") == 9
    assert even.count("no difference shown</small>") == 9
    assert "<b>even" not in page


def test_the_other_scores_stand_below_f1_with_uncorrected_p_and_no_verdict(twenty, page):
    (good,) = [one for one in read_runs([twenty])[0].summary.differences if one.tracker == "good"]
    differences = page.partition("Difference from persistence")[2].partition("</section>")[0]
    rows = differences.partition(">good<")[2].partition("unlucky")[0]
    assert "</span> <small>F1</small>" in differences, "the name and the score are words of their own"
    for name in ("Log loss, nats", "PR-AUC", "FSS, 5 cells"):
        row = rows.partition(f"<small>{name}</small>")[2].partition("</tr>")[0]
        assert row.count(", uncorrected</small>") == 9
        assert "better" not in row
    assert f"{good.at('in-motion', 'pr_auc', 'area', good.tests[0].step).value:+.3f}" in rows


def test_the_result_of_a_comparison_is_a_sentence_a_table_of_all_recordings_and_lines(twenty, capsys):
    terminal.print_result(twenty)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("good has the highest F1 on in-motion cells 1 s ahead, ")
    assert lines[2] == "all recordings"
    assert lines[4] == "| tracker | F1, in-motion 1 s | F1 less persistence | F1, dynamic | F1, visible | frames |"
    good, even = (next(line for line in lines if name in line and line.startswith("|")) for name in ("good", "even"))
    assert "°" not in good
    assert "°" in even
    assert any("| unlucky (partial) |" in line and "| not compared |" in line for line in lines)
    assert [line.partition(":")[0] for line in lines[-5:]] == [
        "Paired over 20 units, 80 frames. °", "Compared on", "Weights", "Keeps up with the sensor", "Not ranked",
    ]  # fmt: skip
    assert not any("seed-07" in line for line in lines)


@pytest.mark.parametrize("width", [80, 100, 200])
def test_every_name_and_interval_is_whole_on_a_terminal_of_any_width(twenty, width, monkeypatch):
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    monkeypatch.setattr(terminal, "Console", lambda **options: console)
    terminal.print_result(twenty)
    shown = console.file.getvalue()
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= width
    assert shown.count("tracker ") == 1, "one table, in no parts"
    table = shown.partition("tracker ")[2].partition("Paired over")[0]
    for name in SKILLS:
        assert len(re.findall(rf"^ {re.escape(name)} ", table, re.M)) == 1, "no name is cut or folded"
    assert len(re.findall(r"\[0\.\d{3}, 0\.\d{3}\]", table)) == 4, "the score that decides has its interval"
    assert len(re.findall(r"\[[+-]0\.\d{3}, [+-]0\.\d{3}\]", table)) == 2, "and so has the difference from the floor"


def test_markdown_has_the_interval_beside_the_number(pooled):
    (line,) = [line for line in headline_markdown(pooled).splitlines() if line.startswith("| good")]
    cell = pooled.rows_in("ranked")[0].cells[0]
    low, high = cell.interval
    assert low < cell.value < high
    assert f"**{cell.text}** [{low:.3f}, {high:.3f}]" in line


ALIKE, UNTESTED = "no difference shown", ""
NO_EVIDENCE = (
    "There is no evidence that it is better than {}: MORE of this kind would decide a difference as large as the"
)
NO_EVIDENCE += " one seen. The smallest difference between them that this run can show is 0.N."


def shortened(lead):
    """A lead without names and scores of rows, and with MORE in place of the missing data."""
    lead = re.sub(r", (persistence|<b>even) \(0\.\d{3}\)", "", lead)
    lead = re.sub(r"about \d+ more recordings?|more than ten times as much data", "MORE", lead)
    return re.sub(r"0\.\d{3}", "0.N", lead)


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [
        (
            {},
            "It is better than the floor, and than the next tracker. The smallest difference that this run can show is"
            " 0.N.",
        ),
        ({"persistence": ALIKE}, f"It is better than the next tracker. {NO_EVIDENCE.format('the floor')}"),
        ({"<b>even": ALIKE}, f"It is better than the floor. {NO_EVIDENCE.format('the next tracker')}"),
        (
            {"<b>even": UNTESTED},
            "It is better than the floor. The next tracker, was not tested against it. The smallest difference that"
            " this run can show is 0.N.",
        ),
        (
            {"persistence": UNTESTED, "<b>even": UNTESTED},
            "This run cannot decide whether it is better than the floor, or than the next tracker: these rows were not"
            " tested against each other.",
        ),
    ],
)
def test_the_lead_decides_between_the_best_tracker_the_floor_and_the_next_one(changed, verdicts, words):
    """`verdicts` between these rows and `good`; in the run itself all differ."""

    def judge(summary):
        for family in summary["pairs"]:
            for test in family["pairs"]:
                other = test["tracker"] if test["other"] == "good" else test["other"]
                test["verdict"] = verdicts.get(other, test["verdict"]) if "good" in test.values() else test["verdict"]
            family["pairs"] = [test for test in family["pairs"] if test["verdict"]]

    runs = changed(judge)
    (lead,) = answer_of(runs[0]).leads
    assert shortened(lead) == f"good has the highest F1 on in-motion cells 1 s ahead, 0.N. {words}"
    assert escaped(lead) in pull_request_markdown(runs, exported_tables(runs)[:1])


@pytest.mark.parametrize(("third", "is_named"), [(ALIKE, True), ("better", False)])
def test_the_lead_names_every_other_tracker_from_which_the_best_one_does_not_differ(changed, third, is_named):
    """`a third` is a little worse than the next tracker, and has its tests."""

    def add(summary):
        summary["trackers"]["a third"] = copy.deepcopy(summary["trackers"]["<b>even"])
        put(summary["trackers"]["<b>even"]["pooled"], "in-motion", "f1.f1", 0.75, steps=5)
        for family in summary["pairs"]:
            for test in list(family["pairs"]):
                if {"good", "<b>even"} == {test["tracker"], test["other"]}:
                    test["verdict"] = ALIKE
                    family["pairs"].append(test | {"other": "a third", "tracker": "good", "verdict": third})

    (lead,) = answer_of(changed(add)[0]).leads
    assert "There is no evidence that it is better than the next tracker, <b>even (0.750): " in lead
    assert (" Nor is there evidence that it is better than a third." in lead) is is_named


@pytest.mark.parametrize("reach", [0.1, 0.2])
def test_no_evidence_says_how_much_data_a_difference_as_large_as_the_one_seen_needs(changed, reach):
    """Two pairs are undecided, half of 5 % for each: t(0.975, 19) = 2.093, t(0.9875, 19) = 2.433, z(0.8) = 0.842."""

    def judge(summary):
        for test in (one for family in summary["pairs"] for one in family["pairs"]):
            if {"good", "<b>even"} == {test["tracker"], test["other"]}:
                test |= {"verdict": ALIKE, "difference": {"value": 0.1, "low": 0.1 - reach, "high": 0.1 + reach}}

    (found,) = re.findall("about ([0-9]+) more recordings", answer_of(changed(judge)[0]).leads[0])
    assert int(found) == math.ceil(20 * ((reach / 0.1 * (2.433 + 0.842) / 2.093) ** 2 - 1))


def test_the_floor_that_no_tracker_beats_is_better_or_not(changed):
    def of_two(summary):
        summary["trackers"] = {label: summary["trackers"][label] for label in ("persistence", "<b>even")}
        put(summary["trackers"]["persistence"]["pooled"], "in-motion", "f1.f1", 0.9, steps=5)

    (lead,) = answer_of(changed(of_two)[0]).leads
    assert lead.startswith("No tracker beats the floors: persistence has an F1 of 0.900 on in-motion cells 1 s ahead; ")
    assert "There is no evidence that it is better than the floor, persistence (0.900): " in lead


def with_notices(changed, *notices):
    listed = [notice.model_dump(mode="json") for notice in notices]
    return changed(lambda summary: summary.update(notices=listed))


def test_failures_stand_first_and_notices_of_a_kind_are_one_with_its_list(changed):
    card = "thresholds from the cards"
    everywhere = [Notice(text=f"{card}: {name} has no other", recording=name, kind=card) for name in RECORDINGS]
    kind = "{} % of the ranges are invalid"
    shares = zip(RECORDINGS[:10], range(22, 80, 6), strict=True)
    invalid = [Notice(text=f"{one}.0% invalid", recording=name, kind=kind, values=(one,)) for name, one in shares]
    runs = with_notices(changed, *everywhere, *invalid)
    found = [(one.text, one.members[:1], len(one.members)) for one in notices_of(runs, headline_tables(runs))]
    assert found == [
        ("unlucky: crashed on 1 of 20 recordings; 76 of 80 frames scored, not ranked", (), 0),
        (f"all 20 recordings: {card}", (f"seed-00: {card}: seed-00 has no other",), 20),
        ("10 of 20 recordings: 22 to 76 % of the ranges are invalid", ("seed-00: 22.0% invalid",), 10),
    ]
    assert "- 10 of 20 recordings: 22 to 76 % of the ranges are invalid\n" in pull_request_markdown(
        runs, exported_tables(runs)[:1]
    )
    page = render_page(runs)
    assert "<details><summary>10 of 20 recordings: 22 to 76 % of the ranges are invalid</summary><ul>" in page
    assert "<li>seed-09: 76.0% invalid</li>" in page


def test_a_notice_of_a_recording_that_is_not_chosen_is_not_shown(changed):
    notices = [Notice(text="is short", recording=name) for name in (*RECORDINGS[:2], "another file")]
    runs = chosen_runs(with_notices(changed, *notices), RECORDINGS[1])
    texts = [notice.text for notice in notices_of(runs, headline_tables(runs))]
    assert "seed-01 and another file: is short" in texts


def test_the_answer_says_why_a_row_failed_in_few_words_and_how_far_forecasts_reach(changed):
    def change(summary):
        summary["trackers"]["unlucky"]["recordings"]["seed-00"]["reason"] = f"<b>{'long ' * 100}"
        unlike = summary["recordings"]["seed-01"]
        unlike["horizons_s"] = [1.04 * horizon_s for horizon_s in unlike["horizons_s"]]

    runs = changed(change)
    facts = {fact.name: fact.value for fact in answer_of(runs[0]).facts}
    assert facts["Compared on"].endswith(", the longest forecast 2.5 to 2.6 s ahead")
    assert facts["Not ranked"].startswith("unlucky: crashed on 1 of 20 recordings (<b>long long ")
    assert facts["Not ranked"].endswith("long l…)")
    assert len(facts["Not ranked"].partition(" (")[2].removesuffix(")")) <= 300
    (notice,) = [one.text for one in notices_of(runs, headline_tables(runs)) if one.text.startswith("unlucky")]
    assert notice.startswith("unlucky: crashed on 1 of 20 recordings (<b>long")


def test_a_difference_names_a_row_with_general_weights_as_the_table_does(changed):
    def generalise(summary):
        for label, card in {"good": "general", "persistence": "general", "unlucky": "site"}.items():
            row = summary["trackers"][label]
            for scores in (row["pooled"], *row["recordings"].values()):
                scores["card"] = card

    (found,) = changed(generalise)
    differences = difference_table(found, "all recordings")
    assert differences.reference == "persistence", "a floor"
    assert {row.name for row in differences.rows if row.tracker == "good"} == {"good (general)"}
    reported = pull_request_markdown([found], exported_tables([found]))
    assert "| good (general), F1 |" in reported
    assert "Scores less persistence" in reported


def family(labels, different):
    pairs = tuple(
        PairTest(
            tracker=one,
            other=other,
            difference=NO_ESTIMATE,
            verdict="better" if (one, other) in different else "no difference shown",
        )
        for one, other in combinations(labels, 2)
    )
    return PairFamily(
        recordings="r", score="f1", output="f1", stratum="in-motion", horizon_s=1.0, step=8, units=20, pairs=pairs
    )


def test_a_row_that_differs_from_all_is_in_no_group():
    assert groups_of(family("abc", {("a", "b"), ("a", "c")})) == (("b", "c"),)


@given(st.sets(st.sampled_from(list(combinations("abcdef", 2)))))
def test_two_rows_share_a_group_exactly_if_they_do_not_differ(different):
    groups = groups_of(family("abcdef", different))
    for pair in combinations("abcdef", 2):
        assert any(set(pair) <= set(group) for group in groups) == (pair not in different)


def test_the_groups_have_rows_that_do_not_differ_significantly(twenty, page):
    groups = data_of(page)["recordings"][0]["groups"]["f1.f1/in-motion/2"]
    tested = ["persistence", "good", "<b>even"]
    assert groups == {"pairs": 3, "units": 20, "tested": tested, "groups": [["persistence", "<b>even"]]}
