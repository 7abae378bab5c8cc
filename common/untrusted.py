"""Untrusted JSON and TOML, with limits on nesting and numbers.

Without limits a file of 40 kB takes 1.6 GB (dotted keys of TOML), or fails later: content nested too deeply to be
written again, or numbers beyond any float or array.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from itertools import accumulate
from typing import Any, NoReturn

MAX_NESTING = 64
"""Limit of nested lists and objects; the deepest file of gridtrack has 12."""
MAX_KEY_PARTS = 16
"""Limit of the parts of a dotted key in TOML: nested tables take time quadratic in their number."""
MAX_INTEGER = 1 << 64
"""Limit of the size of an integer."""

_JSON_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
_TOML_STRING = re.compile(
    r"""
    \#[^\n]*+
    | "{3}[^"\\]*+(?:(?:\\.|"(?!""))[^"\\]*+)*+"{0,5}+
    | '{3}.*?(?:'{3,5}+|\Z)
    | "[^"\\\n]*+(?:\\.[^"\\\n]*+)*+"?
    | '[^'\n]*+'?
    """,
    re.DOTALL | re.VERBOSE,
)
"""A string or a comment; an unterminated one reaches to the end of its line, or of the text."""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}")
_NESTING = {ord(char): step for chars, step in (("[{", 1), ("]}", -1)) for char in chars}
_NO_BRACKETS = bytes(set(range(256)) - set(_NESTING))
_MAYBE_INFINITE = re.compile(rb"[eE]\+?\d|\d{300}")
"""In a text without strings: a number with a positive exponent, or a long one."""
_ESCAPED_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


def parse_json(text: bytes | bytearray, *, undefined: bool = False) -> Any:
    """The JSON value in `text`, UTF-8. Raises ValueError, with a short reason, for anything else.

    Also refused are nesting beyond MAX_NESTING, integers from MAX_INTEGER on, strings with a lone surrogate (UTF-8
    cannot encode it), and numbers that are not finite; with `undefined` these are None instead.
    """
    bare = _JSON_STRING.sub(b"", text)
    _refuse_deep(bare)
    finite, constant = (_finite_or_none, _none) if undefined else (_finite, _not_json)
    # a call for each of a million numbers takes longer than the rest
    checked = finite if _MAYBE_INFINITE.search(bare) else None
    value = json.loads(text.decode(), parse_int=_integer, parse_float=checked, parse_constant=constant)
    if _ESCAPED_SURROGATE.search(text):
        _refuse_surrogates(value)
    return value


def parse_toml(text: bytes) -> dict[str, Any]:
    """The tables in `text`, UTF-8. Raises ValueError for anything else, and as `parse_json`.

    Also for a key with more than MAX_KEY_PARTS parts.
    """
    decoded = text.decode()
    bare = _TOML_STRING.sub("s", decoded)
    if _LONG_KEY.search(bare):
        raise ValueError(f"a key of more than {MAX_KEY_PARTS} parts")
    _refuse_deep(bare.encode())
    tables = tomllib.loads(decoded, parse_float=_finite)
    _refuse_large_integers(tables)
    return tables


def _refuse_deep(text: bytes) -> None:
    """Raise ValueError if the brackets of `text`, which has no strings, are nested too deeply."""
    brackets = text.translate(None, _NO_BRACKETS)
    if max(accumulate(map(_NESTING.__getitem__, brackets)), default=0) > MAX_NESTING:
        raise ValueError(f"nested more than {MAX_NESTING} deep")


def _integer(text: str) -> int:
    if len(text) > 21 or abs(value := int(text)) >= MAX_INTEGER:
        raise ValueError(f"an integer of {len(text)} digits; at most 64 bits are read")
    return value


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _not_json(text)


def _finite_or_none(text: str) -> float | None:
    value = float(text)
    return value if math.isfinite(value) else None


def _none(_: str) -> None:
    return None


def _not_json(text: str) -> NoReturn:
    """Python reads NaN, Infinity and 1e999; JSON has no such numbers."""
    raise ValueError(f"{text[:20]} is not a finite number")


def _refuse_surrogates(value: Any) -> None:
    if isinstance(value, str):
        if any("\ud800" <= char <= "\udfff" for char in value):
            raise ValueError("a string with half of a surrogate pair")
    elif isinstance(value, dict):
        for key, item in value.items():
            _refuse_surrogates(key)
            _refuse_surrogates(item)
    elif isinstance(value, list):
        for item in value:
            _refuse_surrogates(item)


def _refuse_large_integers(value: Any) -> None:
    if isinstance(value, int):
        if abs(value) >= MAX_INTEGER:
            raise ValueError("an integer beyond 64 bits")
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            _refuse_large_integers(item)
