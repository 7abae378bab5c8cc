"""The package: import cost, public names, the contents of the wheel, and its use without the repository."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections import defaultdict
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("common", "recordings", "simulation", "trackers", "evaluation", "reports", "cli")
CONVENTIONAL = ("app", "main", "INFERENCE", "TRAINING")
"""Names that several modules may define: the application and entry point of a command, the kernels of a network."""
HEAVY = (
    "torch", "lightning", "gtsam", "kiss_icp", "ray", "submitit", "sklearn", "optuna", "filterpy", "numba", "rosbags",
    "scipy", "polars", "pyarrow", "numpy", "pydantic", "rerun",
)  # fmt: skip


def python(*arguments, **environment):
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        cwd=environment.get("cwd"),
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


HELP = """
import atexit, sys
from gridtrack.cli import main
sys.argv = ["gridtrack", "--help"]
atexit.register(lambda: print(*sorted(sys.modules)))
main()
"""


@pytest.mark.parametrize("code", ["import gridtrack, sys; print(*sorted(sys.modules))", HELP], ids=["import", "help"])
def test_it_loads_nothing_heavy(code):
    loaded = python("-c", code).splitlines()[-1].split()
    assert "gridtrack" in loaded
    assert not [name for name in HEAVY if name in loaded]


def test_the_front_door_gives_a_plugin_author_every_name_it_promises():
    import gridtrack

    for name in gridtrack.__all__:
        assert getattr(gridtrack, name).__name__ == name
    assert gridtrack.__version__ == metadata.version("gridtrack")
    assert {*gridtrack.__all__} <= {*dir(gridtrack)}, "a notebook completes them"
    with pytest.raises(AttributeError, match="no attribute 'Trakcer'"):
        _ = gridtrack.Trakcer


def names_of(node):
    """The names of the classes, functions and variables that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    names = [part for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
    return [name.id for name in names if isinstance(name.ctx, ast.Store)]


def test_a_public_name_is_defined_in_one_module():
    modules = defaultdict(set)
    for path in [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]:
        for name in {name for node in ast.parse(path.read_text("utf-8")).body for name in names_of(node)}:
            modules[name].add(path)
    public = {name for name in modules if not name.startswith("_")}.difference(CONVENTIONAL)
    assert {name: modules[name] for name in public if len(modules[name]) > 1} == {}


def test_every_package_is_in_the_distribution():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = [path.parent for name in (*PACKAGES, "data") for path in (ROOT / name).rglob("__init__.py")]
    assert sorted(declared) == sorted(
        ["gridtrack", *(".".join(("gridtrack", *p.relative_to(ROOT).parts)) for p in found)]
    )


def test_no_other_package_may_import_a_concrete_tracker():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = project["tool"]["importlinter"]["contracts"]
    (forbidden,) = [one["forbidden_modules"] for one in contracts if "concrete tracker" in one["name"]]
    groups = (
        project["project"]["entry-points"][f"gridtrack.{name}"].values() for name in ("trackers", "floors", "recorded")
    )
    assert set(forbidden) == {".".join(re.split("[.:]", value)[:3]) for values in groups for value in values}


WHEEL_BYTES = 14_000_000
REPOSITORY_ONLY = re.compile(r"drives/|weights/[^/]*/junction\.")


def take_kernels(package):
    """Give an installed `package` the compiled kernels of the modules here: Numba takes half a minute to make them."""
    for module in package.rglob("*.py"):
        here = ROOT / module.relative_to(package)
        for kernel in (here.parent / "__pycache__").glob(f"{here.stem}.*.nb?"):
            (module.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy2(kernel, module.parent / "__pycache__")
        shutil.copystat(here, module)  # Numba compares the time of the source


def test_the_built_wheel_compares_its_own_demo_recording_without_the_repository(tmp_path):
    source, site = tmp_path / "source", tmp_path / "site"
    built = shutil.ignore_patterns(".[!g]*", ".git", "build", "*.egg-info", "__pycache__")
    other = {"runs", "tests", "studies", "benchmarks"}
    shutil.copytree(
        ROOT, source, ignore=lambda folder, names: built(folder, names) | (other if Path(folder) == ROOT else set())
    )
    python(
        "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path), str(source)
    )
    (wheel,) = tmp_path.glob("gridtrack-*.whl")
    assert wheel.stat().st_size < WHEEL_BYTES
    with zipfile.ZipFile(wheel) as packed:
        data = [name.removeprefix("gridtrack/data/") for name in packed.namelist()]
        packed.extractall(site)
    take_kernels(site / "gridtrack")
    assert not [name for name in data if REPOSITORY_ONLY.match(name)]
    assert "weights/kalman/general.toml" in data
    assert "weights/stationary/general.safetensors" in data  # a floor of every comparison
    elsewhere = {"PYTHONPATH": str(site), "cwd": str(tmp_path)}
    code = "import gridtrack; print(gridtrack.__file__); print(gridtrack.packaged_recording('leg_tracker'))"
    where, demo = python("-c", code, **elsewhere).splitlines()
    assert where.startswith(str(site))
    given = ("--tracker", "static-map", "--every", "0.1s", "--horizon", "0.5s", "--out", "run", "--json")
    arguments = ["compare", "--no-floors", f"{demo}@114s-118s", "--validation", f"{demo}@75s-78s", *given]
    summary = json.loads(python("-m", "gridtrack.cli", *arguments, **elsewhere))
    (trial,) = summary["trackers"]["static-map"]["recordings"].values()
    assert trial["outcome"] == "ok"
    assert trial["frames_scored"] == trial["frames_expected"] > 5
    assert (tmp_path / "run" / "report" / "index.html").stat().st_size > 10_000
    assert "3D!input" in json.loads(python("-m", "gridtrack.cli", "recording", "layout", **elsewhere))["configById"]
    python("-m", "gridtrack.cli", "trackers", "new", "my-tracker", **elsewhere)
    assert (tmp_path / "my-tracker" / ".github" / "workflows" / "test.yml").is_file()
    assert (tmp_path / "my-tracker" / "tests" / "my_tracker.json").is_file()
    python("-m", "gridtrack.cli", "trackers", "new", "my-network", "--learned", **elsewhere)
    assert (tmp_path / "my-network" / ".github" / "workflows" / "test.yml").is_file()
