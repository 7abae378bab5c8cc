"""Sections of the pages that follow from definitions equal the output of the command."""

import pytest

from gridtrack.evaluation.hosting.contract_clauses import CLAUSES

from studies.defined_pages import DOCS, PAGES, filled


@pytest.mark.parametrize("page", PAGES)
def test_the_page_has_the_section_of_its_definitions(page):
    text = (DOCS / page).read_text("utf-8")
    assert filled(page, text) == text, "run python -m studies.defined_pages"


def test_a_clause_needs_only_clauses_before_it():
    for number, clause in enumerate(CLAUSES):
        assert set(clause.needs) <= {earlier.name for earlier in CLAUSES[:number]}
