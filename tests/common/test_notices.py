"""Notices of one kind are one line, with the numbers of their recordings and rows and the range of their values."""

import pytest

from gridtrack.common.notices import Notice, by_kind

FOUR = ["a", "b", "c", "d"]


def only(notices, recordings=FOUR):
    (kind,) = by_kind(notices, recordings)
    return kind.text, kind.members


def test_a_notice_alone_has_its_own_words():
    one = Notice(text="5.1% are invalid: import it again", recording="a", kind="{} % are invalid", values=(5,))
    assert only([one, one]) == ("a: 5.1% are invalid: import it again", ())


@pytest.mark.parametrize(
    ("recordings", "words"),
    [
        (FOUR[:2], "a and b: is short"),
        (FOUR, "all 4 recordings: is short"),
        (["a", "b", "c", "e"], "4 recordings: is short"),
    ],
)
def test_few_recordings_are_named_and_many_are_counted_among_those_of_the_run(recordings, words):
    text, members = only([Notice(text="is short", recording=name) for name in recordings])
    assert text == words
    assert members == (() if len(recordings) == 2 else tuple(recordings))


def test_some_of_the_recordings_of_the_run():
    text, _ = only([Notice(text="is short", recording=name) for name in FOUR], [*FOUR, "e"])
    assert text == "4 of 5 recordings: is short"


def test_values_are_a_range_and_each_notice_is_in_the_list():
    found = [
        Notice(text=f"{n} gaps, the longest 0.5 s: {name}", recording=name, kind="{} gaps of {} s", values=(n, 0.5))
        for name, n in (("a", 3), ("b", 12))
    ]
    assert only(found) == (
        "a and b: 3 to 12 gaps of 0.5 s",
        ("a: 3 gaps, the longest 0.5 s: a", "b: 12 gaps, the longest 0.5 s: b"),
    )


def test_rows_and_recordings_are_counted_together():
    found = [Notice(text=f"lost {row}", row=row, recording=name, kind="lost") for row in "xy" for name in FOUR]
    text, members = only(found)
    assert text == "x and y on all 4 recordings: lost"
    assert (members[0], len(members)) == ("x on a: lost x", 8)


def test_several_notices_of_one_recording_name_it_once():
    found = [Notice(text=f"order differs: {words}", recording="a", kind="order differs") for words in ("this", "that")]
    assert only(found) == ("a: order differs", ("a: order differs: this", "a: order differs: that"))


def test_kinds_keep_the_order_of_their_first_notices():
    found = [Notice(text="one", recording="a"), Notice(text="other"), Notice(text="one", recording="b")]
    assert [kind.text for kind in by_kind(found, FOUR)] == ["a and b: one", "other"]


def test_an_unprintable_text_becomes_one_printable_line():
    assert str(Notice(text="a\x1bb\nc", recording="x\ty")) == "x y: a b c"
