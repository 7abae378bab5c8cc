"""A section of a results file is written by a command of the repository, or names the last version with it."""

import re
from pathlib import Path

import pytest

from studies.figures import RESULTS, ROOT
from studies.support.results_file import read_sections

SECTIONS = [
    pytest.param(path.relative_to(RESULTS).as_posix(), section, id=f"{path.name}-{name}")
    for path in sorted(RESULTS.rglob("*.json"))
    if path.name not in ("summary.json", "confusion.json")
    for name, section in read_sections(path).items()
]


def module_of(command):
    """The file of the module that a command runs. Raises AssertionError for a command that is none."""
    if target := re.fullmatch(r"make (\S+)", command):
        recipe = re.search(rf"^{target[1]}:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert recipe, f"the Makefile has no target {target[1]}"
        command = recipe[1]
    found = re.search(r"python -m ((?:studies|benchmarks)\.\w+)", command)
    assert found, command
    return ROOT / f"{found[1].replace('.', '/')}.py"


@pytest.mark.parametrize(("file", "section"), SECTIONS)
def test_a_command_of_the_repository_writes_the_section_or_it_names_a_version(file, section):
    module = module_of(section.command)
    assert module.exists() == (not section.version)
    if section.version:
        return
    assert Path(file).name in module.read_text("utf-8"), f"{module.name} does not say that it writes {file}"
