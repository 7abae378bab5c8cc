"""Damage to bytes, text and JSON, decided by a source of choices: hypothesis, or a seeded generator for the corpus."""

from __future__ import annotations

import copy
import json
import random
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

Item = TypeVar("Item")

NUMBERS = [
    *(
        struct.pack(code, value)
        for code in ("<q", "<i", "<h")
        for value in (-1, 0, 1, 2 ** (8 * struct.calcsize(code) - 1) - 1)
    ),
    *(struct.pack(code, value) for code in ("<d", "<f") for value in (float("nan"), float("inf"), -0.0, 1e-30, 3e38)),
    *(struct.pack("<d", value) for value in (1e308, -1e308, 1e-300, 5e-324)),
]
WORDS = [
    *("1e308", "-1e308", "1e-300", "1e999", "nan", "-inf", "0", "-1", "1", "4294967296", "9" * 30, "9" * 5000),
    *("", '"', "'", "[", "]" * 3, "{" * 200, "[" * 3000, "a." * 500, "#", "=", "\x00", "\x1b[31m\u202e", "x" * 20_000),
]
VALUES: list[Any] = [
    *(None, True, 0, -1, 2**31, 2**63, 2**64, 10**400, 1e308, -1e308, 1e-300, float("nan"), float("inf")),
    *("", "\ud800", "\x1b[31m\u202e", "x" * 20_000, "../../etc", "1e308", [], {}, [[]], {"": {}}, [0] * 2000),
]

NAMES = ["", "\ud800", "../a", "x" * 300, "\u202e"]


class Choices(Protocol):
    """Where the decisions come from."""

    def below(self, count: int) -> int:
        """A number from 0 to count - 1."""


class SeededChoices:
    """Choices that a seed decides."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)

    def below(self, count: int) -> int:
        """A number from 0 to count - 1."""
        return self._random.randrange(count)


def one_of(choices: Choices, items: Sequence[Item]) -> Item:
    """One of `items`."""
    return items[choices.below(len(items))]


def damaged_bytes(choices: Choices, content: bytes) -> bytes:
    """`content` with a number written over it, a part cut out, repeated or added, or its end cut off."""
    at = choices.below(len(content) + 1)
    end = min(len(content), at + 1 + choices.below(64))
    edits: list[Callable[[], bytes]] = [
        lambda: (number := one_of(choices, NUMBERS)) and content[:at] + number + content[at + len(number) :],
        lambda: content[:at] + content[end:],
        lambda: content[:end] + content[at:],
        lambda: content[:at] + one_of(choices, WORDS).encode() + content[at:],
        lambda: content[:at],
    ]
    return one_of(choices, edits)()


def damaged_text(choices: Choices, content: bytes) -> bytes:
    """Text with a word replaced, or a line left out, repeated or moved to the end."""
    if choices.below(2):
        words = list(re.finditer(rb"[\w.+-]+", content))
        if words:
            word = one_of(choices, words)
            return content[: word.start()] + one_of(choices, WORDS).encode() + content[word.end() :]
    lines = content.splitlines(keepends=True) or [b""]
    at = choices.below(len(lines))
    edits = [lines[:at] + lines[at + 1 :], lines[: at + 1] + lines[at:], lines[:at] + lines[at + 1 :] + [lines[at]]]
    return b"".join(one_of(choices, edits))


def damaged_value(choices: Choices, value: Any) -> Any:
    """A JSON value with one of its parts replaced, left out, nested, or also put under another key."""
    root: dict[Any, Any] = {"root": copy.deepcopy(value)}
    holder, key = _part(choices, root)
    kind = choices.below(6)
    if kind == 0 and holder is not root:
        del holder[key]
    elif kind == 1 and holder is not root and isinstance(holder, dict):
        holder[one_of(choices, NAMES)] = holder[key]
    elif kind == 2:
        for _ in range(60):
            holder[key] = [holder[key]]
    else:
        holder[key] = copy.deepcopy(one_of(choices, VALUES))
    return root["root"]


def _part(choices: Choices, root: dict[Any, Any]) -> tuple[Any, Any]:
    """A list or object inside `root`, and an index or key of it."""
    holder, key = root, "root"
    while isinstance(holder[key], dict | list) and holder[key] and choices.below(8):
        holder = holder[key]
        key = one_of(choices, list(holder) if isinstance(holder, dict) else range(len(holder)))
    return holder, key


def damaged_json(choices: Choices, content: bytes) -> bytes:
    """JSON with a damaged value, or as damaged text."""
    if not choices.below(4):
        return damaged_text(choices, content)
    return dumped(damaged_value(choices, json.loads(content)))


def dumped(value: Any) -> bytes:
    """A value as JSON, also with values that JSON does not have: NaN and halves of surrogate pairs."""
    return json.dumps(value).encode()
