"""`gridtrack report --format`: the same rows and columns in every format; names are hostile."""

import csv
import io
import re
import shutil
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from gridtrack.cli import app
from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.reports.chosen_scores import parse_score_choices
from gridtrack.reports.formats import FORMATS, latex_text, render_as
from gridtrack.reports.run import read_runs

from scenes.edited_run import edited, put, trial_of, value_of

HOSTILE = "=_[*]<script>alert(1)</script>--> \\input{/etc/passwd} $x$ %&#~^{}|`\"'!?,,--\x1b\n@all"
COLUMNS = "f1 in-motion 1s, log_loss visible 0.5s,f1.recall dynamic, calibration dynamic"


@pytest.fixture(scope="module")
def hostile_run(run_folder, tmp_path_factory):
    """The run with a tracker and a notice of a hostile name."""

    def poison(summary):
        summary["trackers"][HOSTILE.replace("/", "∕")] = summary["trackers"].pop("good")  # no label has a slash
        summary["notices"] = [{"text": HOSTILE}]

    return edited(run_folder, tmp_path_factory.mktemp("hostile") / "run", poison)


@pytest.fixture(scope="module")
def label():
    return HOSTILE.replace("/", "∕").replace("\x1b", " ").replace("\n", " ")


def report(run, *options):
    return CliRunner().invoke(app, ["report", str(run), *options], catch_exceptions=False)


def text_of(name, run, **choice):
    return render_as(name, [run], **choice).decode()


def plain_latex(text):
    """The text that TeX prints: latex_text undone. Another command, or a lone special sign, is an error."""
    names = {"textbackslash": "\\", "textasciitilde": "~", "textasciicircum": "^", "textless": "<", "textgreater": ">"}
    names |= {"textbar": "|", "textquotedbl": '"', "textasciigrave": "`", "textquotesingle": "'"}
    token = re.compile(r"\\(?P<name>[a-z]+)\{\}|\\(?P<sign>[{}$&#%_])|(?P<plain>[^\\{}$&#%_~^])|(?P<empty>\{\})")
    out, at = "", 0
    while at < len(text):
        found = token.match(text, at)
        assert found, text[at:]
        out += names[found["name"]] if found["name"] else found["sign"] or found["plain"] or ""
        at = found.end()
    return out


def test_csv_has_the_values_of_the_summary_with_their_intervals(run_folder, summary_of):
    rows = list(csv.DictReader(io.StringIO(text_of("csv", run_folder, columns=COLUMNS))))
    entry = summary_of(run_folder)
    step = entry["recordings"]["crossing"]["horizons_s"].index(1.0)
    assert {row["tracker"] for row in rows} == set(entry["trackers"])
    for row in rows:
        trial = trial_of(entry, row["tracker"])
        assert float(row["f1 in-motion 1 s"]) == value_of(trial, "in-motion", "f1.f1", step)
        assert float(row["log_loss visible 0.5 s"]) == value_of(trial, "visible", "log_loss.mean", step // 2)
        assert float(row["f1.recall dynamic 1 s"]) == value_of(trial, "dynamic", "f1.recall", step)
        assert float(row["calibration dynamic 1 s"]) == value_of(trial, "dynamic", "calibration.error", step)


def test_rows_of_two_runs_name_their_run_in_csv(run_folder, tmp_path):
    other = shutil.copytree(run_folder, tmp_path / "other")
    rows = csv.DictReader(io.StringIO(render_as("csv", [run_folder, other]).decode()))
    assert {row["run"] for row in rows} == {"demo", "other"}


def test_rows_are_chosen_by_patterns_and_the_best_is_the_best_of_them(run_folder):
    page = text_of("markdown", run_folder, rows="fair,bl*", columns="f1 in-motion 1s")
    rows = [line for line in page.splitlines() if line.startswith(("| fair", "| blank", "| good", "| persistence"))]
    assert [line.split(" |")[0] for line in rows] == ["| fair", "| blank"]
    assert "**" in rows[0]


def test_an_undefined_score_is_empty_in_csv_and_a_dash_in_the_others(run_folder, tmp_path):
    run = edited(
        run_folder, tmp_path / "run", lambda summary: put(trial_of(summary, "fair"), "in-motion", "f1.f1", None)
    )
    choice = {"rows": "fair", "columns": "f1 in-motion 1s"}
    assert next(csv.DictReader(io.StringIO(text_of("csv", run, **choice))))["f1 in-motion 1 s"] == ""
    assert "| fair | – |" in text_of("markdown", run, **choice)
    assert "{fair} & -- \\\\" in text_of("latex", run, **choice)


def test_a_hostile_name_is_text_in_markdown(hostile_run):
    page = text_of("markdown", hostile_run)
    assert "<script>" not in page
    assert "\x1b" not in page
    assert "\\@all" in page
    tables = [block.splitlines() for block in page.split("\n\n") if block.startswith("| tracker")]
    for lines in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
    assert tables


def test_a_hostile_name_is_text_in_latex(hostile_run, label):
    page = text_of("latex", hostile_run)
    known = r"begin end centering caption toprule midrule bottomrule cmidrule multicolumn textbf scriptsize usepackage"
    known += " textbackslash textasciitilde textasciicircum textless textgreater textbar textquotedbl"
    known += " textasciigrave textquotesingle"
    assert set(re.findall(r"\\([a-zA-Z]+)", page)) <= set(known.split())
    (line,) = [line for line in page.splitlines() if line.lstrip().startswith("{=")]
    name = line.strip().partition("} & ")[0].removeprefix("{")
    assert plain_latex(name) == label


def test_every_special_sign_is_itself_in_latex():
    signs = "".join(map(chr, range(0x20, 0x7F)))
    assert plain_latex(latex_text(signs)) == signs
    assert not re.search(r"--|,,|\?`|!`|<<|>>|''|``", latex_text("-- ,, ?` !` << >> '' ``"))
    assert latex_text("dilated-convgru, new") == "dilated-convgru, new"


def test_each_line_of_a_latex_table_has_as_many_columns_as_it_declares(run_folder):
    page = text_of("latex", run_folder)
    declared = len(re.search(r"\\begin\{tabular\}\{(\w+)\}", page)[1])
    lines = [line for line in page.splitlines() if line.endswith("\\\\")]
    widths = [
        1 + len(re.findall(r"(?<!\\)&", line)) + sum(int(n) - 1 for n in re.findall(r"multicolumn\{(\d+)\}", line))
        for line in lines
    ]
    assert set(widths) == {declared}
    assert page.count("{") == page.count("}")


def test_a_hostile_name_is_no_formula_in_csv(hostile_run, label):
    rows = list(csv.DictReader(io.StringIO(text_of("csv", hostile_run))))
    assert f"'{label}" in {row["tracker"] for row in rows}
    assert not any(value.startswith(("=", "+", "@")) for row in rows for value in row.values())


def test_a_trial_that_is_not_ranked_is_a_failure_in_junit(hostile_run, label):
    suite = ElementTree.fromstring(text_of("junit", hostile_run))
    assert (suite.get("tests"), suite.get("failures")) == ("5", "1")
    failed = [case for case in suite.iter("testcase") if case.find("failure") is not None]
    assert [case.get("classname") for case in failed] == ["gridtrack report.unlucky"]
    assert "lost my way" in failed[0].find("failure").get("message")
    assert f"gridtrack report.{label}" in {case.get("classname") for case in suite.iter("testcase")}


def test_a_hostile_name_is_text_in_svg(hostile_run, label):
    pytest.importorskip("matplotlib", reason="needs the extra `figures`")
    drawn = render_as("svg", [hostile_run])
    root = ElementTree.fromstring(drawn)
    assert not [node for node in root.iter() if node.tag.endswith("script")]
    assert label.split() == next(text.split() for text in root.itertext() if "alert" in text)
    assert drawn == render_as("svg", [hostile_run])


@pytest.fixture(scope="module")
def every_stratum(run_folder, tmp_path_factory):
    """A run with each possible stratum, and the strata of a class of two words."""

    def add(summary):
        for stratum in (*STRATA_WITH_TRUTH, "dynamic traffic light"):
            put(trial_of(summary, "good"), stratum, "f1.f1", 0.5)

    return read_runs([edited(run_folder, tmp_path_factory.mktemp("strata") / "run", add)])


def test_every_stratum_can_be_a_column(every_stratum):
    """Some names end as a horizon does: `occluded to 0.5 s`."""
    for stratum in (*STRATA_WITH_TRUTH, "dynamic traffic light"):
        for text, ahead_s in (("", 1.0), (" 1s", 1.0), (" 0.5 s", 0.5)):
            (choice,) = parse_score_choices(f"f1 {stratum}{text}", every_stratum)
            assert (choice.score.name, choice.output.name) == ("f1", "f1")
            assert (choice.stratum, choice.horizon_s) == (stratum, ahead_s)


def test_a_score_below_zero_is_drawn(run_folder, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra `figures`")
    share = "f1.oracle_share"
    run = edited(run_folder, tmp_path / "run", lambda summary: put(trial_of(summary, "fair"), "visible", share, -0.25))
    root = ElementTree.fromstring(render_as("svg", [run], rows="fair", columns=f"{share} visible"))
    assert any(text.strip() == "−0.2" for text in root.itertext()), "a tick of the axis"


def test_a_figure_draws_each_chosen_score_over_the_horizon(run_folder):
    pytest.importorskip("matplotlib", reason="needs the extra `figures`")
    root = ElementTree.fromstring(render_as("svg", [run_folder], rows="good,fair", columns=COLUMNS))
    words = [text.strip() for text in root.itertext()]
    assert {"F1, in-motion", "Log loss, nats, visible", "Recall, dynamic", "good", "fair"} <= set(words)
    assert "persistence" not in words
    assert len([node for node in root.iter() if node.get("id", "").startswith("axes_")]) == 4


def test_a_pdf_is_a_pdf_with_embedded_outlines(hostile_run, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra `figures`")
    done = report(hostile_run, "--format", "pdf", "--out", str(tmp_path / "figure.pdf"))
    assert done.exit_code == 0
    content = (tmp_path / "figure.pdf").read_bytes()
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    assert b"/Type3" not in content


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "pdf"])
def test_the_command_prints_each_rendered_file(run_folder, name):
    if name == "svg":
        pytest.importorskip("matplotlib", reason="needs the extra `figures`")
    assert report(run_folder, "--format", name).stdout_bytes == render_as(name, [run_folder])


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--format", "latx"], "did you mean 'latex'?"),
        (["--format", "csv", "--rows", "goood"], "--rows 'goood': no such row: did you mean 'good'?"),
        (["--format", "csv", "--columns", "f1"], "expected SCORE STRATUM HORIZON"),
        (["--format", "csv", "--columns", "f9 visible"], "no score 'f9'"),
        (["--format", "csv", "--columns", "f1.recoll visible"], "no output 'recoll': did you mean 'recall'?"),
        (["--format", "csv", "--columns", "f1 visibel"], "did you mean 'visible'?"),
        (["--format", "csv", "--columns", "f1 visible 60s"], "60 s is beyond the horizon of 2.5 s"),
        (["--rows", "good"], "the page shows every row"),
    ],
)
def test_a_wrong_choice_is_one_line(run_folder, options, problem):
    with pytest.raises(ConfigurationError, match=re.escape(problem)):
        report(run_folder, *options)


def test_a_horizon_between_two_steps_is_taken_at_the_nearest_and_named_by_its_time(run_folder, tmp_path):
    def slow_down(summary):
        described = summary["recordings"]["crossing"]
        described["horizons_s"] = [round(step / 7, 6) for step in range(len(described["horizons_s"]))]

    at_7_hz = edited(run_folder, tmp_path / "run", slow_down)
    columns = "f1 visible 0.5s, f1 visible 1.3s, f1 visible 1.5s"  # 3.5, 9.1 and 10.5 steps
    headings = "| F1, visible 0.571 s | F1, visible 1.29 s | F1, visible 1.43 s |"
    assert headings in text_of("markdown", at_7_hz, columns=columns)
    (row, *_) = csv.DictReader(io.StringIO(text_of("csv", at_7_hz, columns=columns)))
    assert [name for name in row if name.startswith("f1")] == [
        f"f1 visible {time} s" for time in ("0.571429", "1.28571", "1.42857")
    ]
