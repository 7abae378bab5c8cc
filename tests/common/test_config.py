"""Configuration refuses unknown keys with a suggestion; an error is one printable line of bounded length."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.errors import MAX_LINE_CHARS, ConfigurationError, GridtrackError, bounded_line, did_you_mean
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.regression.measurement import Unmeasured

HOSTILE = "\x1b[31m\u202e\u2066\ud800\r\nred"


class Filter(Settings):
    gate_m: float = 1.0
    robust: bool = False


def test_settings_are_frozen_and_refuse_unknown_keys_and_infinities() -> None:
    with pytest.raises(ValidationError):
        Filter().gate_m = 2.0  # type: ignore[misc]
    with pytest.raises(ValidationError):
        Filter.model_validate({"gate": 1.0})
    with pytest.raises(ValidationError):
        Filter(gate_m=float("inf"))


def test_values_of_pairs_are_json_where_they_parse_as_json() -> None:
    assert parse_pairs("gate-m=1.5, robust=true,name=cauchy,empty=", "kalman") == {
        "gate_m": 1.5,
        "robust": True,
        "name": "cauchy",
        "empty": "",
    }
    assert parse_pairs("", "kalman") == {}


@pytest.mark.parametrize(("text", "message"), [("gate", "key=value"), ("=1", "key=value"), ("a=1,a=2", "given twice")])
def test_pairs_that_cannot_be_read_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=f"kalman: .*{message}"):
        parse_pairs(text, "kalman")


def test_an_unknown_option_is_refused_with_a_suggestion_in_one_line() -> None:
    with pytest.raises(ConfigurationError) as caught:
        validated(Filter, {"gate": 1.0, "robust": "perhaps"}, "kalman")
    message = str(caught.value)
    assert "did you mean 'gate_m'?" in message
    assert "'robust' = 'perhaps'" in message
    assert "\n" not in message
    assert validated(Filter, {"gate_m": 2}, "kalman") == Filter(gate_m=2.0)


def test_suggestions() -> None:
    assert did_you_mean("kalmn", ["kalman", "blank"]) == "did you mean 'kalman'?"
    assert did_you_mean("zzz", ["kalman", "blank"]) == "known: blank, kalman"
    assert did_you_mean("zzz", [f"a{n:03}" for n in range(500)]).endswith("a018, a019 and 480 more")
    assert did_you_mean("zzz", []) == "there are none"


def test_an_error_has_no_character_that_acts_on_a_terminal() -> None:
    shown = str(GridtrackError(f"file {HOSTILE}: make it again"))
    assert shown.isprintable()
    assert shown.startswith("file ")
    assert shown.endswith("red: make it again")


def test_a_long_error_keeps_its_beginning_and_end() -> None:
    shown = str(ConfigurationError(f"a.toml: '{'x' * 900_000}' is too long: make it again"))
    assert len(shown) == MAX_LINE_CHARS
    assert shown.startswith("a.toml: 'xxx")
    assert shown.endswith("xxx' is too long: make it again")
    assert " ... " in shown
    assert bounded_line("short") == "short"


def test_stored_reasons_are_bounded_and_printable() -> None:
    reasons = [TrialEnded("crashed", HOSTILE * 100_000).reason, *Unmeasured([HOSTILE * 100_000]).reasons]
    for reason in reasons:
        assert len(reason) <= MAX_LINE_CHARS
        assert reason.isprintable()


def test_refused_values_are_quoted_in_part() -> None:
    with pytest.raises(ConfigurationError) as caught:
        validated(Settings, {f"key {n}": "v" * 100_000 for n in range(1000)} | {"k" * 100_000: 1}, "here")
    assert len(str(caught.value)) < MAX_LINE_CHARS
    assert str(caught.value).endswith("and 996 more")
    assert did_you_mean("gate" + "x" * 500_000, ["gate_m"]) == "known: gate_m"
