"""Every installed tracker is found by name; a broken one has an error message and does not affect the others."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gridtrack.common.errors import PluginError
from gridtrack.trackers import registry
from gridtrack.trackers.contract import Tracker
from gridtrack.trackers.registry import code_sha256
from gridtrack.trackers.selection import Launch

Install = Callable[..., Path]

SOURCE = """
from gridtrack.common.config import Settings
from gridtrack.trackers.contract import Forecast, Tracker
import numpy as np

class Fine(Tracker):
    def reset(self, seed): pass
    def update(self, frame): pass
    def predict(self, steps): return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))

class OtherNames(Fine):
    def predict(self, n, /, *rest): return super().predict(n)

class OtherApi(Fine):
    api = 3

class WithoutFit(Fine):
    api = 1

class OldFit(Fine):
    learns = True
    @classmethod
    def fit(cls, train, validation, score, out, options): pass

class OldFitOfItsApi(OldFit):
    api = 1

class LooseOptions(Fine):
    Options = dict

class NoUpdate(Tracker):
    def reset(self, seed): pass
    def predict(self, steps): pass

class ShortSignature(Fine):
    def update(self): pass

class LongConstructor(Fine):
    def __init__(self, stream, options, device): pass

class CannotLearn(Fine):
    learns = True

class Ceiling(Fine):
    role = "ceiling"

class ReferenceForAll(Fine):
    reference_for = "occupancy"

class ReferenceForSpeed(Fine):
    reference_for = frozenset({"speed"})

class OddFlag(Fine):
    moving_sensor = "yes"

a_function = lambda: None
"""


@pytest.fixture
def one(install: Install) -> Callable[[str], str]:
    """Installs one tracker `mine` and returns its name."""

    def one(value: str, source: str = SOURCE) -> str:
        module = value.partition(":")[0]
        install("my-trackers", {"mine": value}, {f"{module}.py": source})
        return "mine"

    return one


@pytest.mark.parametrize("attribute", ["Fine", "OtherNames", "WithoutFit"])
def test_a_tracker_that_keeps_the_contract_loads(one: Callable[..., str], attribute: str) -> None:
    assert issubclass(registry.load(one(f"mine_{attribute}:{attribute}")), Tracker)


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        ("OtherApi", "made for contract 3; this gridtrack has contract 2"),
        ("OldFit", r"fit\(train, validation, .*\) cannot be called as fit\(task\): .* contract 2 on it takes one Fit"),
        ("OldFitOfItsApi", r"contract 1, and fit has changed: write fit\(cls, task: FitTask\) and set api = 2"),
        ("LooseOptions", "Options is not a subclass of gridtrack.common.config.Settings"),
        ("NoUpdate", "it lacks update"),
        ("ShortSignature", r"update\(self\) cannot be called as update\(frame\)"),
        ("LongConstructor", r"__init__\(self, stream, options, device\) cannot be called"),
        ("CannotLearn", "it learns, but has no fit"),
        ("Ceiling", "role is 'ceiling'; expected one of tracker, floor"),
        ("ReferenceForAll", "reference_for is 'occupancy'; expected a frozenset of occupancy, classes"),
        ("ReferenceForSpeed", r"reference_for is frozenset\({'speed'}\); expected a frozenset of occupancy, classes"),
        ("OddFlag", "moving_sensor is 'yes'; expected True or False"),
        ("a_function", "is not a subclass of gridtrack.trackers.contract.Tracker"),
        ("Missing", "cannot be imported: AttributeError: .*Missing"),
    ],
)
def test_a_breach_of_the_contract_names_plugin_and_distribution(
    one: Callable[..., str], attribute: str, message: str
) -> None:
    name = one(f"breach_{attribute}:{attribute}")
    with pytest.raises(PluginError, match=rf"tracker 'mine' \(breach_{attribute}:{attribute}\) of my-trackers 1.0.*"):
        registry.load(name)
    with pytest.raises(PluginError, match=message):
        registry.load(name)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import nobody_has_this", "No module named 'nobody_has_this'"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("import sys; sys.exit('bye')", "SystemExit: bye"),
        ("def", "SyntaxError"),
    ],
)
def test_a_plugin_that_fails_to_import_is_a_plugin_error(one: Callable[..., str], source: str, message: str) -> None:
    name = one(f"fails_{len(source)}:X", source)
    assert name in registry.entries()
    with pytest.raises(PluginError, match=f"cannot be imported: .*{message}"):
        registry.load(name)


def test_a_missing_extra_is_named(install: Install) -> None:
    requires = 'Requires-Dist: Nobody-Has-That>=2; extra == "deep"\nProvides-Extra: deep\n'
    install("my-trackers", {"mine": "needs_extra:X"}, {"needs_extra.py": "import nobody_has_that.core"}, requires)
    with pytest.raises(PluginError, match=r"; pip install 'my-trackers\[deep\]'$"):
        registry.load("mine")


def test_a_missing_module_of_another_name_lists_the_extras(install: Install) -> None:
    requires = 'Requires-Dist: scikit-nothing; extra == "deep"\nRequires-Dist: other; extra == "view"\n'
    install("my-trackers", {"mine": "needs_other:X"}, {"needs_other.py": "import sknothing"}, requires)
    with pytest.raises(PluginError, match="it may belong to an extra of my-trackers: deep, view"):
        registry.load("mine")


def test_a_broken_tracker_hides_no_other(install: Install) -> None:
    site = install("damaged", {"x": "y:z"})
    (site / "damaged-1.0.dist-info" / "entry_points.txt").write_text("[gridtrack.trackers]\nno equals sign\n")
    install("hostile", {"../../etc": "os:system", "Big": "a:b", "fine-one": "fine:Fine"})
    found = registry.entries()
    assert {"persistence", "static-map", "blank", "fine-one"} <= set(found)
    assert "is not a valid name" in found["../../etc"].problem
    assert "is not a valid name" in found["Big"].problem
    assert "entry_points.txt cannot be read" in found["(damaged 1.0)"].problem
    assert found["fine-one"].problem == ""


def test_a_name_registered_twice_is_refused_naming_both(install: Install) -> None:
    install("first", {"mine": "a:B"})
    install("second", {"mine": "c:D"})
    with pytest.raises(PluginError, match=r"first 1\.0 and second 1\.0|second 1\.0 and first 1\.0"):
        registry.find("mine")
    assert registry.find("blank").problem == ""


def test_a_class_knows_its_registered_name_and_so_does_one_that_inherits_from_it() -> None:
    static_map = registry.load("static-map")
    assert (
        registry.registered_name(static_map)
        == registry.registered_name(type("Variant", (static_map,), {}))
        == "static-map"
    )
    with pytest.raises(PluginError, match=r"contract\.Tracker is not registered as a tracker"):
        registry.registered_name(Tracker)


def test_files_are_read_again_only_after_a_change_of_the_path(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("one", {"first": "a:b"})
    assert "first" in registry.entries()
    with monkeypatch.context() as unread:
        unread.setattr("importlib.metadata.PathDistribution.read_text", None)
        assert registry.entries()["first"].distribution == "one 1.0"
    install("two", {"second": "a:b"})
    assert {"first", "second"} <= set(registry.entries())


def test_an_unknown_name_gets_a_suggestion() -> None:
    with pytest.raises(PluginError, match="there is no tracker 'persistance'; did you mean 'persistence'"):
        registry.load("persistance")


LISTING = "from gridtrack.trackers import registry; assert 'mine' in registry.entries()"
SETTINGS = "import gridtrack.trackers.recurrent.settings"
PROCESS = "import gridtrack.trackers.serve, gridtrack.trackers.baselines"


@pytest.mark.parametrize(
    ("code", "others"),
    [
        (LISTING, {"torch", "gtsam", "numba", "explodes", "gridtrack.trackers.baselines"}),
        (SETTINGS, {"torch", "lightning", "numba"}),
        (PROCESS, {"torch", "gtsam", "numba", "polars", "typer", "rich", "plotly", "mcap"}),
    ],
    ids=["a list of trackers", "settings of networks", "the process of a tracker"],
)
def test_only_the_libraries_that_are_needed_are_imported(install: Install, code: str, others: set[str]) -> None:
    install("my-trackers", {"mine": "explodes:X"}, {"explodes.py": "raise SystemExit(9)"})
    program = f"{code}; import sys; print(sorted({others!r} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "[]\n"


def test_the_baselines_are_floors_persistence_the_reference_and_one_shot_that_for_classes() -> None:
    pytest.importorskip("torch")
    found = [registry.load(name) for name in ("persistence", "static-map", "blank", "one-shot")]
    assert [one.role for one in found] == ["floor", "floor", "floor", "tracker"]
    assert [one.reference_for for one in found] == [{"occupancy"}, set(), set(), {"classes"}]


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A tracker's module with a helper beside it, and a library installed below."""
    library = tmp_path / "env" / "site-packages"
    library.mkdir(parents=True)
    (tmp_path / "own_tracker.py").write_text("import own_helper, own_library\nclass Own: pass\n")
    (tmp_path / "own_helper.py").write_text("GATE = 1\n")
    (library / "own_library.py").write_text("VERSION = 1\n")
    for folder in (tmp_path, library):
        monkeypatch.syspath_prepend(str(folder))
    yield tmp_path
    for name in ("own_tracker", "own_helper", "own_library"):
        sys.modules.pop(name, None)


def test_an_edit_of_the_tracker_or_of_a_file_beside_it_changes_the_hash(own: Path) -> None:
    kind = importlib.import_module("own_tracker").Own
    first = code_sha256(kind)
    assert len(first) == 64
    assert code_sha256(kind) == first
    (own / "env" / "site-packages" / "own_library.py").write_text("VERSION = 2\n")
    assert code_sha256(kind) == first
    (own / "own_helper.py").write_text("GATE = 2\n")
    second = code_sha256(kind)
    (own / "own_tracker.py").write_text("class Own: gate = 2\n")
    assert len({first, second, code_sha256(kind)}) == 3


def test_a_program_is_hashed_by_the_files_that_its_command_names(tmp_path: Path) -> None:
    (tmp_path / "tracker").write_text("one")
    first = Launch("own", ("./tracker", "--fast"), tmp_path).code_sha256()
    assert first == Launch("own", ("./tracker", "--slow"), tmp_path).code_sha256()
    (tmp_path / "tracker").write_text("two")
    assert first != Launch("own", ("./tracker", "--fast"), tmp_path).code_sha256()
    assert Launch("own", ("nowhere",), tmp_path).code_sha256() == ""
