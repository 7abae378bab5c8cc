"""Notices: facts to know before a comparison; those of one kind together are one line and a list."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict

from gridtrack.common.errors import bounded_line

Line = Annotated[str, AfterValidator(bounded_line)]
"""A sentence for people, which may quote untrusted input: one printable line of bounded length."""
MOST_NAMED = 3
"""A line names so many recordings or rows; of more it gives their number."""
PLACE = "{}"
"""The place of a value in the kind of a notice."""


class Notice(BaseModel):
    """A fact about a row, a recording, a row on a recording, or about the run if it names neither."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    text: Line
    """Without its row and its recording."""
    row: Line = ""
    """The label of the row."""
    recording: Line = ""
    kind: Line = ""
    """The same for every notice of its kind, with `{}` for each of the `values`; empty: `text`."""
    values: tuple[float, ...] = ()
    """Numbers in which notices of one kind differ, in the units of `kind`."""

    @property
    def subject(self) -> str:
        """`row on recording`, one of them, or an empty text."""
        return " on ".join(filter(None, (self.row, self.recording)))

    def __str__(self) -> str:
        return f"{self.subject}: {self.text}" if self.subject else self.text


@dataclass(frozen=True, slots=True)
class NoticesOfAKind:
    """The notices of one kind: `text` for all, and a line for each in `members` if there are several."""

    text: str
    members: tuple[str, ...] = ()


def by_kind(notices: Iterable[Notice], recordings: Collection[str]) -> list[NoticesOfAKind]:
    """The notices of each kind together, in the order of their first ones; `recordings`: all those of the run."""
    alike: dict[tuple[object, ...], list[Notice]] = defaultdict(list)
    for notice in dict.fromkeys(notices):
        alike[notice.kind or notice.text, bool(notice.row), bool(notice.recording)].append(notice)
    return [_together(found, recordings) for found in alike.values()]


def _together(found: Sequence[Notice], recordings: Collection[str]) -> NoticesOfAKind:
    if len(found) == 1:
        return NoticesOfAKind(str(found[0]))
    rows = list(dict.fromkeys(one.row for one in found if one.row))
    names = list(dict.fromkeys(one.recording for one in found if one.recording))
    where = " on ".join(filter(None, (counted(rows, "rows"), counted(names, "recordings", recordings))))
    is_one_text = len({one.text for one in found}) == 1
    is_complete = is_one_text and len(found) == max(len(rows), len(names)) <= MOST_NAMED
    text = found[0].text if is_complete else _with_ranges(found)
    members = () if is_complete else tuple(one.subject if is_one_text else str(one) for one in found)
    return NoticesOfAKind(f"{where}: {text}" if where else text, members)


def _with_ranges(found: Sequence[Notice]) -> str:
    """The kind of the notices with the range of each of their values."""
    text = found[0].kind or found[0].text
    for values in zip(*(one.values for one in found), strict=False):
        low, high = f"{min(values):g}", f"{max(values):g}"
        text = text.replace(PLACE, low if low == high else f"{low} to {high}", 1)
    return text


def counted(names: Sequence[str], noun: str, every: Collection[str] = ()) -> str:
    """The names if they are few, else their number; of the number of `every` name, if they are among these."""
    if len(names) <= MOST_NAMED:
        return joined_names(names)
    if not set(names) <= set(every):
        return f"{len(names)} {noun}"
    return f"all {len(names)} {noun}" if len(names) == len(every) else f"{len(names)} of {len(every)} {noun}"


def joined_names(names: Sequence[str]) -> str:
    """`A`, `A and B` or `A, B and C`; empty without names."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
