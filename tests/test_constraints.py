"""The lock of the dependencies fits pyproject.toml and constraints.txt, and has a hash for every version."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REMEDY = "run `make lock`"


def entries(name):
    """The requirements of a file, each with the text up to the next one."""
    text = re.sub(r"^#.*\n", "", (ROOT / name).read_text(), flags=re.MULTILINE)
    for entry in re.split(r"\n(?=\S)", text.strip()):
        requirement, *hashes = entry.replace("\\\n", "").split(" --hash=")
        yield Requirement(requirement), hashes


def pins(name):
    """The specifiers of each package in a file."""
    found = {}
    for requirement, _ in entries(name):
        found.setdefault(canonicalize_name(requirement.name), set()).add(str(requirement.specifier))
    return found


@pytest.mark.parametrize("extra", [None, *PROJECT["optional-dependencies"]])
def test_the_lock_has_a_version_for_each_requirement(extra):
    locked = pins("constraints.lock")
    required = PROJECT["dependencies"] if extra is None else PROJECT["optional-dependencies"][extra]
    for requirement in map(Requirement, required):
        if requirement.name == PROJECT["name"]:
            continue
        versions = {one.removeprefix("==") for one in locked.get(canonicalize_name(requirement.name), ())}
        assert versions, f"{requirement.name}: {REMEDY}"
        assert all(requirement.specifier.contains(version) for version in versions), f"{requirement}: {REMEDY}"


def test_the_lock_has_the_versions_of_the_constraints():
    constraints, locked = pins("constraints.txt"), pins("constraints.lock")
    assert {name: locked.get(name) for name in constraints} == constraints, REMEDY


def test_every_version_of_the_lock_has_hashes():
    for requirement, hashes in entries("constraints.lock"):
        assert re.fullmatch(r"==[^*,]+", str(requirement.specifier))
        assert hashes, f"{requirement}: {REMEDY}"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one.strip()) for one in hashes)
