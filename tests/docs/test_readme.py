"""The Python on the pages runs, and the README's tracker keeps the contract."""

import pytest

from docs.pages import PAGES, ROOT, blocks, name_of
from scenes.command_line import gridtrack

BLOCKS = [(page, block) for page in PAGES for block in blocks(page, "python")]


@pytest.mark.usefixtures("trackers_here")
@pytest.mark.parametrize(("page", "block"), BLOCKS, ids=[name_of(page) for page, _ in BLOCKS])
def test_a_python_block_runs(page, block, tmp_path, monkeypatch):
    (tmp_path / "data").symlink_to(ROOT / "data")  # a block may write into runs
    monkeypatch.chdir(tmp_path)
    block = block.replace("    horizon_s=1.0,", "    horizon_s=1.0, no_floors=True,")
    exec(compile(block, str(page), "exec"), {"__name__": "page"})


@pytest.mark.usefixtures("trackers_here")
def test_the_readmes_tracker_keeps_the_contract(install):
    (block,) = blocks(ROOT / "README.md", "python")
    install("my-package", {"my-tracker": "my_package:MyTracker"}, {"my_package.py": block})
    gridtrack("trackers", "check", "my-tracker")
