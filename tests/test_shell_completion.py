"""Completions of the shell, asked as bash asks: it ends a word at each of : = @ and replaces the rest."""

import os
import re
import subprocess
import sys
from typing import get_args

import pytest

from gridtrack.evaluation.runs.settings import EngineName

from scenes.command_line import gridtrack

OTHER_KINDS = ("beam-dropout", "sector-dropout", "range-noise", "frame-drop")
"""Kinds of degraded input beside the jitter of poses."""
PROGRAM = [sys.executable, "-c", "import sys; sys.argv = ['gridtrack']; from gridtrack.cli import main; main()"]


def asked_by_bash(*typed):
    """The environment in which bash asks; "" is a new word."""
    words = ["gridtrack"]
    for word in typed:
        words += re.findall(r"[:=@]+|[^:=@]+", word) or [""]
    return {"COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1), "_GRIDTRACK_COMPLETE": "complete_bash"}


@pytest.fixture
def completed_in_bash(monkeypatch):
    """`completed_in_bash(*words)`: the offers to bash for the end of the last word."""

    def completed(*typed):
        for name, value in asked_by_bash(*typed).items():
            monkeypatch.setenv(name, value)
        done = gridtrack()
        assert done.stderr == ""
        return done.stdout.split()

    return completed


@pytest.mark.usefixtures("trackers_here")
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        (["compare", "a.mcap", "--tracker", "ka"], ["kalman"]),
        (["compare", "a.mcap@30s-90s", "--tracker", "slow=fact"], ["factor-graph"]),
        (["compare", "a.mcap", "--out=runs/a", "--tracker=fact"], ["factor-graph"]),
        (["trackers", "show", "dil"], ["dilated-convgru"]),
        (["train", "one"], ["one-shot"]),
        (["compare", "--tracker", "kalman", "a.mc"], []),
        (["rec"], ["recording"]),
        (["compare", "a.mcap", "--engine", ""], list(get_args(EngineName))),
        (["report", "run", "--format", "la"], ["latex"]),
        (["simulate", "tracks", "a.txt", "--format", "s"], ["sdd"]),
        (["compare", "a.mcap", "--degrade", "b"], ["beam-dropout="]),
        (["compare", "a.mcap", "--degrade", "pose-jitter=0.1,"], [f"0.1,{kind}=" for kind in OTHER_KINDS]),
        (["recording", "import", "a.bag", "--cloud-slice", "low_m=0.2,hi"], ["0.2,high_m="]),
        (["compare", "a.mcap", "--tracker", "kalman:association="], ["hungarian", "jcbb"]),
        (["compare", "a.mcap", "--tracker", "static-map:prior_frames=9,"], ["9,points=", "9,card=", "9,weights="]),
        (["compare", "a.mcap", "--tracker", "kalmann:as"], []),
        (["train", "static-map:pr"], ["prior_frames="]),
    ],
)
def test_commands_trackers_and_their_options_are_completed(completed_in_bash, typed, completed):
    assert completed_in_bash(*typed) == completed


def test_nothing_is_fetched_for_a_completion():
    asked = asked_by_bash("compare", "https://127.0.0.1:9/a.mcap", "--tracker", "ka")
    done = subprocess.run(PROGRAM, env=os.environ | asked, capture_output=True, text=True, check=True)
    assert (done.stdout.split(), done.stderr) == (["kalman"], "")
