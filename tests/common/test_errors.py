"""An error is one printable line of bounded length, whatever untrusted text it quotes."""

from __future__ import annotations

import pytest

from gridtrack.common.config import Settings, validated
from gridtrack.common.errors import MAX_LINE_CHARS, ConfigurationError, GridtrackError, bounded_line, did_you_mean
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.regression.measurement import Unmeasured

HOSTILE = "\x1b[31m\u202e\u2066\ud800\r\nred"


def test_an_error_has_no_character_that_acts_on_a_terminal() -> None:
    shown = str(GridtrackError(f"file {HOSTILE}: make it again"))
    assert shown.isprintable()
    assert shown.startswith("file ")
    assert shown.endswith("red: make it again")


def test_of_a_long_error_the_place_and_the_remedy_stay() -> None:
    shown = str(ConfigurationError(f"a.toml: '{'x' * 900_000}' is too long: make it again"))
    assert len(shown) == MAX_LINE_CHARS
    assert shown.startswith("a.toml: 'xxx")
    assert shown.endswith("xxx' is too long: make it again")
    assert " ... " in shown
    assert bounded_line("short") == "short"


def test_reasons_that_are_kept_are_bounded_and_printable() -> None:
    kept = [TrialEnded("crashed", HOSTILE * 100_000).reason, *Unmeasured([HOSTILE * 100_000]).reasons]
    for reason in kept:
        assert len(reason) <= MAX_LINE_CHARS
        assert reason.isprintable()


def test_values_that_are_refused_are_quoted_in_part() -> None:
    with pytest.raises(ConfigurationError) as caught:
        validated(Settings, {f"key {n}": "v" * 100_000 for n in range(1000)} | {"k" * 100_000: 1}, "here")
    assert len(str(caught.value)) < MAX_LINE_CHARS
    assert str(caught.value).endswith("and 996 more")
    assert did_you_mean("gate" + "x" * 500_000, ["gate_m"]) == "known: gate_m"
