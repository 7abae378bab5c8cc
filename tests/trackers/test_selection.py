"""Trackers are selected as `[LABEL=]NAME[:key=value,...]`; they are registered, in another environment, or programs."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gridtrack.common.errors import ConfigurationError, PluginError
from gridtrack.trackers.selection import (
    Launch,
    Selection,
    launch,
    parse_selection,
    parse_selections,
    read_trackers_toml,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kalman", Selection("kalman", "kalman")),
        ("Slow one=kalman", Selection("Slow one", "kalman")),
        ("kalman:gate=2.5,coast-s=3", Selection("kalman", "kalman", {"gate": 2.5, "coast_s": 3})),
        ("a=kalman:mode=x=y", Selection("a", "kalman", {"mode": "x=y"})),
        ("kalman:gates=[1, 2],on=true", Selection("kalman", "kalman", {"gates": [1, 2], "on": True})),
        (
            'kalman:noise={"x": [1, 2], "y": "a,b]"},n=1',
            Selection("kalman", "kalman", {"noise": {"x": [1, 2], "y": "a,b]"}, "n": 1}),
        ),
        ("kalman:gate=NaN,far=-Infinity", Selection("kalman", "kalman", {"gate": "NaN", "far": "-Infinity"})),
        ("kalman:points=raw,gate=1", Selection("kalman", "kalman", {"gate": 1}, "raw")),
        ("kalman:weights=runs/a,gate=1", Selection("kalman", "kalman", {"gate": 1}, weights=Path("runs/a"))),
        ("x=kalman:file=C:/a b", Selection("x", "kalman", {"file": "C:/a b"})),
    ],
)
def test_a_selection_is_parsed(text: str, expected: Selection) -> None:
    assert parse_selection(text) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not a valid name of a tracker"),
        ("../kalman", "is not a valid name of a tracker"),
        ("Kalman", "is not a valid name of a tracker"),
        ("..=kalman", "label '..' must be"),
        ("a/b=kalman", "label 'a/b' must be"),
        (f"{'x' * 65}=kalman", "label 'x+' must be"),
        ("=kalman", "label '' must be"),
        ("kalman:gate", "'gate' is not of the form key=value"),
        ("kalman:gate=1,gate=2", "'gate' is given twice"),
        ("kalman:points=all", "points=all; expected centres or raw"),
        ("kalman:weights=", "weights=; expected a folder"),
        ("kalman:weights=3", "weights=3; expected a folder"),
        ("kalman:points=[1]", r"points=\[1\]; expected centres or raw"),
    ],
)
def test_an_invalid_selection_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        parse_selection(text)


def test_labels_must_differ_in_more_than_case() -> None:
    with pytest.raises(ConfigurationError, match="two trackers are labelled 'a': give one another label"):
        parse_selections(["A=blank", "a=kalman"])
    assert [s.label for s in parse_selections(["blank", "b=blank"])] == ["blank", "b"]


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    return tmp_path / "trackers.toml"


def test_a_trackers_toml_names_other_environments_and_programs(toml: Path) -> None:
    toml.write_text(
        '[elsewhere]\npython = "env/bin/python"\ntracker = "blank"\n'
        "[mine]\ncommand = \"./my_tracker --fast 'two words' $HOME;ls\"\n"
        '[found]\ncommand = "tracker-on-path"\n'
    )
    folder = toml.parent
    assert read_trackers_toml(toml) == {
        "elsewhere": Launch(
            "elsewhere", (f"{folder}/env/bin/python", "-P", "-m", "gridtrack.trackers.serve", "blank"), folder
        ),
        "mine": Launch("mine", (f"{folder}/my_tracker", "--fast", "two words", "$HOME;ls"), folder),
        "found": Launch("found", ("tracker-on-path",), folder),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[a]\npython = "p"\ncommand = "c"', "give either python or command"),
        ("[a]\n", "give either python or command"),
        ('[a]\ncommand = "c"\ntracker = "t"', "tracker is an option of python"),
        ('[a]\ncomand = "c"', "there is no option 'comand'; did you mean 'command'"),
        ('[a]\ncommand = " "', "command is empty"),
        ('[a]\ncommand = "x \'"', "command: No closing quotation"),
        ('[a]\npython = "p"\ntracker = "../x"', "is not a valid name of a tracker"),
        ('["A/b"]\ncommand = "c"', "expected a table named"),
        ("a = 3", "expected a table named"),
        ('[blank]\ncommand = "c"', "gridtrack .* has a tracker of this name"),
        ("[a", "not TOML"),
    ],
)
def test_a_mistake_in_trackers_toml_is_one_clear_line(toml: Path, text: str, message: str) -> None:
    toml.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as error:
        read_trackers_toml(toml)
    assert str(toml) in str(error.value)


def test_a_missing_trackers_toml_is_refused(toml: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_trackers_toml(toml)


def test_an_external_tracker_and_a_registered_one_are_launched_by_name() -> None:
    external = {"mine": Launch("mine", ("x",))}
    assert launch("mine", external) is external["mine"]
    assert launch("blank").argv == (sys.executable, "-P", "-m", "gridtrack.trackers.serve", "blank")
    with pytest.raises(PluginError, match="there is no tracker 'mime'; did you mean 'mine'"):
        launch("mime", external)
