"""Configuration refuses unknown keys, in one line that suggests the nearest known one."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.errors import ConfigurationError, GridtrackError, RecordingError, did_you_mean


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


def test_valid_values_are_returned() -> None:
    assert validated(Filter, {"gate_m": 2}, "kalman") == Filter(gate_m=2.0)


def test_every_error_has_one_root() -> None:
    assert issubclass(ConfigurationError, GridtrackError)
    assert issubclass(RecordingError, GridtrackError)


def test_suggestions() -> None:
    assert did_you_mean("kalmn", ["kalman", "blank"]) == "did you mean 'kalman'?"
    assert did_you_mean("zzz", ["kalman", "blank"]) == "known: blank, kalman"
    assert did_you_mean("zzz", [f"a{n:03}" for n in range(500)]).endswith("a018, a019 and 480 more")
    assert did_you_mean("zzz", []) == "there are none"
