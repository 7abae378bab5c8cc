"""The page on the contract has every clause, with its reason, as the contract suite defines it."""

from __future__ import annotations

import re

from gridtrack.evaluation.hosting.contract_clauses import CLAUSES

from studies.contract_page import PAGE, filled


def test_the_page_has_what_the_command_writes() -> None:
    text = PAGE.read_text("utf-8")
    assert filled(text) == text, "run python -m studies.contract_page"


def test_each_clause_has_a_section_with_its_reason() -> None:
    sections = re.split(r"^### ", PAGE.read_text("utf-8"), flags=re.MULTILINE)[1:]
    assert [section.partition("\n")[0] for section in sections] == [clause.name for clause in CLAUSES]
    for section, clause in zip(sections, CLAUSES, strict=True):
        words = " ".join(section.split())
        assert clause.requirement in words
        assert f"*Reason:* {clause.reason}" in words


def test_a_clause_needs_only_clauses_before_it() -> None:
    for number, clause in enumerate(CLAUSES):
        assert set(clause.needs) <= {earlier.name for earlier in CLAUSES[:number]}
