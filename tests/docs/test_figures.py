"""Numbers of the results pages come from committed results, by the command `python -m studies.figures`."""

import pytest

from docs.pages import name_of
from studies.figures import filled, marked_pages, results_pages, unmarked_decimals

PAGES = results_pages()


@pytest.mark.parametrize("page", marked_pages(), ids=name_of)
def test_a_page_has_the_output_of_the_command(page):
    text = page.read_text("utf-8")
    assert filled(text) == text, "run make figures"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_results_page_has_no_number_copied_by_hand(page):
    assert list(unmarked_decimals(page.read_text("utf-8"))) == []


def test_a_value_and_a_table_are_filled_between_their_markers():
    page = "F1 <!-- value: junction: oracle: f1 occluded 1 s -->0.1<!-- /value -->, at once."
    assert filled(page) == "F1 <!-- value: junction: oracle: f1 occluded 1 s -->1.000<!-- /value -->, at once."
    table = filled("<!-- table: junction: F1: oracle: f1 occluded 1 s -->\n<!-- /table -->")
    assert "| F1 | occluded 1 s |\n|---|---|\n| oracle | 1.000 |\n<!-- /table -->" in table


def test_a_marker_chooses_the_rows_of_a_table():
    table = "moving/drives.json: scores: F1"
    page = filled(f"<!-- table: {table}: rows [ok]* -->\n<!-- /table -->")
    assert [line.split()[1] for line in page.splitlines()[3:-1]] == ["oracle", "kalman"]
    with pytest.raises(KeyError, match="no rows 'absent'"):
        filled(f"<!-- table: {table}: rows absent --><!-- /table -->")


def test_a_page_names_results_that_are_not_measured_yet():
    value, table = (f"<!-- {kind}: worlds/none.json: a: b -->" for kind in ("value", "table"))
    assert filled(f"{value}0.7<!-- /value -->") == f"{value}not measured yet<!-- /value -->"
    assert filled(f"{table}<!-- /table -->") == f"{table}\n*not measured yet*\n<!-- /table -->"


@pytest.mark.parametrize("address", ["value: junction: kalman: f2 dynamic 1 s", "table: nowhere"])
def test_an_unknown_address_is_an_error(address):
    kind = address.partition(":")[0]
    with pytest.raises(KeyError, match="no "):
        filled(f"<!-- {address} --><!-- /{kind} -->")


def test_a_decimal_is_found_outside_markers_code_and_constants():
    marked = "<!-- value: a -->0.3<!-- /value --> `0.4` [x](0.5) 1.9.1 v2\n\n    --rate 0.6\n"
    assert list(unmarked_decimals(marked)) == []
    assert list(unmarked_decimals("one\nF1 is 0.693 after 0.5 s\n<!-- constants: 0.5 -->")) == ["line 2: 0.693"]
