"""Untrusted JSON and TOML: nested, long and unwritable content is refused in a few words, before it costs much."""

from __future__ import annotations

import json
import tomllib
import tracemalloc

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.common.untrusted import MAX_INTEGER, MAX_KEY_PARTS, MAX_NESTING, parse_json, parse_toml

NUMBERS = st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.recursive(
    NUMBERS | st.booleans() | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=20,
)
TABLES = st.dictionaries(st.text(st.characters(exclude_categories=["Cs"]), max_size=8), VALUES, max_size=5)


@settings(max_examples=40)
@given(VALUES, st.booleans())
def test_json_is_read_as_by_the_standard_library(value: object, ascii_only: bool) -> None:
    assert parse_json(json.dumps(value, ensure_ascii=ascii_only).encode("utf-8", "surrogatepass")) == value


@settings(max_examples=40)
@given(TABLES)
def test_toml_is_read_as_by_the_standard_library(tables: dict[str, object]) -> None:
    text = tomli_w.dumps(tables, multiline_strings=True)
    assert parse_toml(text.encode()) == tomllib.loads(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * (MAX_NESTING + 1) + "]" * (MAX_NESTING + 1), "nested more than 64 deep"),
        ("[" * 300_000, "nested more than 64 deep"),
        ('{"a":' * 100_000, "nested more than 64 deep"),
        ("9" * 5000, "an integer of 5000 digits"),
        (f"[{MAX_INTEGER}]", "an integer of 20 digits"),
        ("1e999", "1e999 is not a finite number"),
        ('["1e5", 2E+999]', r"2E\+999 is not a finite number"),
        (f"{'9' * 400}.5", "9{20} is not a finite number"),
        ("[NaN]", "NaN is not a finite number"),
        ('{"a": ["\\ud800"]}', "half of a surrogate pair"),
        ('{"\\udfff": 1}', "half of a surrogate pair"),
        ('"\\', "Unterminated string"),
    ],
)
def test_unusable_json_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_json(text.encode())


def test_numbers_that_are_not_finite_may_be_undefined() -> None:
    assert parse_json(b"[NaN, -Infinity, 1e999, 1.5]", undefined=True) == [None, None, None, 1.5]


def test_json_at_the_limits_is_read() -> None:
    deepest = "[" * MAX_NESTING + "]" * MAX_NESTING
    assert parse_json(deepest.encode()) == json.loads(deepest)
    assert parse_json(b'["[[[[\\"", "\\ud83d\\ude00", -18446744073709551615]') == [
        '[[[["',
        "\U0001f600",
        1 - MAX_INTEGER,
    ]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a." * 20_000 + "a = 1", "a key of more than 16 parts"),
        ("[" + "a . " * 20_000 + "a]", "a key of more than 16 parts"),
        ("x = {" + "'b'." * 20_000 + "a = 1}", "a key of more than 16 parts"),
        ('"b"."c".' * 20_000 + "a = 1", "a key of more than 16 parts"),
        ("x = " + "[" * 100_000, "nested more than 64 deep"),
        ("x = " + "{a = " * 100_000, "nested more than 64 deep"),
        (f"x = [1, {MAX_INTEGER}]", "an integer beyond 64 bits"),
        ("x = inf", "inf is not a finite number"),
        ('x = "', "Unterminated string|Illegal character|Unexpected"),
    ],
)
def test_unusable_toml_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parse_toml(text.encode())


def test_dots_and_brackets_in_strings_and_comments_are_no_nesting() -> None:
    dotted, opened = "a." * 100 + "a", "[" * 100
    text = f'# {dotted} {opened}\nx = "{dotted} {opened}"\ny = """\n{dotted} "" {opened}"""\nz = \'{dotted}\'\n'
    text += f"w = '''{opened}\n{dotted}'''\n"
    assert parse_toml(text.encode()) == tomllib.loads(text)
    longest = ".".join("k" * MAX_KEY_PARTS)
    assert parse_toml(f"{longest} = 1".encode()) == tomllib.loads(f"{longest} = 1")


@pytest.mark.parametrize(
    "text",
    [
        b'"' * 50_000,
        b'\\"' * 125_000,
        b'"\\"' * 25_000,
        b"a" * 250_000,
        b"a " * 125_000,
        b"a.a " * 62_500,
        b"'" * 249_999,
    ],
)
def test_the_cost_of_the_limits_is_linear(text: bytes) -> None:
    """Text that is hostile to regular expressions for strings or keys: quadratic time would be hours."""
    tracemalloc.start()
    for parse in (parse_json, parse_toml):
        with pytest.raises(ValueError, match=r"."):
            parse(text)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100 * len(text)
