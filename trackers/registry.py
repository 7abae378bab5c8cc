"""The registry: every installed tracker by its entry point, listed without importing it, loaded and checked by name."""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError
from pathlib import Path
from typing import Any, get_args

from gridtrack.common.config import Settings
from gridtrack.common.entry_points import Registration, registrations
from gridtrack.common.errors import PluginError, did_you_mean
from gridtrack.common.files import sha256_of
from gridtrack.trackers.contract import API, API_WITHOUT_FIT, ComparedPart, Role, Tracker

TRACKER_GROUP = "gridtrack.trackers"
FLOOR_GROUP = "gridtrack.floors"
"""The entry points of the trackers that are added to every comparison; their role is "floor"."""
RECORDED_GROUP = "gridtrack.recorded"
"""The entry points of the trackers that read forecasts from a file, named by their option `file`; they run only by
name, and their role is "recorded"."""
ROLES = {FLOOR_GROUP: "floor", RECORDED_GROUP: "recorded"}
"""The role of the trackers in a group of entry points."""
INSTALLED = ("site-packages", "dist-packages")
"""Names of folders of installed libraries."""
OPTIONAL_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+).*\bextra\s*==\s*['\"]([^'\"]+)")
"""A distribution, and the extra that needs it."""


def entries() -> dict[str, Registration]:
    """Every registered tracker by name, in order, none of them imported; broken ones carry their `problem`."""
    return dict(sorted((registrations(TRACKER_GROUP) | floors() | recorded()).items()))


def floors() -> dict[str, Registration]:
    """The registered trackers that are added to every comparison, by name, as in `entries`."""
    return registrations(FLOOR_GROUP)


def recorded() -> dict[str, Registration]:
    """The registered trackers that read forecasts from a file, by name, as in `entries`."""
    return registrations(RECORDED_GROUP)


def missing_extra(entry: Registration) -> str:
    """The extra with the name of a tracker if its distribution has one that is not installed, as text; else ""."""
    for requirement in Distribution.from_name(entry.distribution_name).requires or ():
        needed = OPTIONAL_REQUIREMENT.match(requirement)
        if needed and needed[2] == entry.name and not _is_installed(needed[1]):
            return f"it needs pip install '{entry.distribution_name}[{entry.name}]'"
    return ""


def _is_installed(distribution: str) -> bool:
    try:
        Distribution.from_name(distribution)
    except PackageNotFoundError:
        return False
    return True


def find(name: str) -> Registration:
    """The entry of the tracker `name`, not imported. Raises PluginError if it is unknown or broken."""
    known = entries()
    entry = known.get(name)
    if entry is None:
        raise PluginError(f"there is no tracker '{name}'; {did_you_mean(name, known)}")
    if entry.problem:
        raise PluginError(f"tracker '{name}' of {entry.distribution}: {entry.problem}")
    return entry


def load(name: str) -> type[Tracker]:
    """Import the tracker `name` and check that it keeps the contract.

    Raises PluginError, which names the plugin, its distribution and the problem. Call it in the tracker's own
    process: importing a plugin runs its code.
    """
    entry = find(name)
    where = f"tracker '{name}' ({entry.value}) of {entry.distribution}"
    try:
        found = EntryPoint(name, entry.value, TRACKER_GROUP).load()
    except ImportError as error:
        raise PluginError(f"{where} cannot be imported: {error}{install_hint(name, error)}") from error
    except (Exception, SystemExit) as error:
        raise PluginError(f"{where} cannot be imported: {type(error).__name__}: {error}") from error
    problem = contract_breach(found)
    if problem:
        raise PluginError(f"{where}: {problem}")
    tracker: type[Tracker] = found
    for group, role in ROLES.items():
        if name in registrations(group) and tracker.role != role:
            raise PluginError(f'{where}: registered in {group}, and its role is {tracker.role!r}: set role = "{role}"')
    return tracker


@cache
def registered_name(tracker: type[Tracker]) -> str:
    """The registered name of a tracker's class, or of the nearest class that it inherits from. Raises PluginError."""
    for kind in tracker.__mro__:
        for entry in entries().values():
            module, _, attribute = entry.value.partition(":")
            if attribute == kind.__qualname__ and f"{kind.__module__}.".startswith(f"{module}."):
                return entry.name
    raise PluginError(f"{tracker.__module__}.{tracker.__qualname__} is not registered as a tracker")


def install_hint(name: str, error: ImportError) -> str:
    """How to install the module that the tracker `name` lacks, as the end of an error line; "" if none is missing."""
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return ""
    module = error.name.partition(".")[0]
    distribution = find(name).distribution_name
    extras = []
    for requirement in Distribution.from_name(distribution).requires or ():
        match = OPTIONAL_REQUIREMENT.match(requirement)
        if match and match[1].lower().replace("-", "_") == module.lower():
            return f"; pip install '{distribution}[{match[2]}]'"
        if match and match[2] not in extras:
            extras.append(match[2])
    return f"; it may belong to an extra of {distribution}: {', '.join(extras)}" if extras else ""


def contract_breach(found: Any) -> str:
    """The reason why `found` is not a tracker of this contract, in one line; "" if it is."""
    if not (isinstance(found, type) and issubclass(found, Tracker)):
        return f"{found!r} is not a subclass of gridtrack.trackers.contract.Tracker"
    if problem := api_breach(found.api, fits=_has_fit(found)):
        return problem
    options: Any = found.Options
    if not (isinstance(options, type) and issubclass(options, Settings)):
        return "Options is not a subclass of gridtrack.common.config.Settings"
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        return f"it lacks {', '.join(missing)}"
    return _signature_breach(found) or _attribute_breach(found)


def api_breach(api: object, *, fits: bool) -> str:
    """The reason why a tracker of contract `api` cannot be used here, "" if it can; `fits`: it has a `fit`."""
    if api == API or (api == API_WITHOUT_FIT and not fits):
        return ""
    if api == API_WITHOUT_FIT:
        return f"made for contract {api}, and fit has changed: write fit(cls, task: FitTask) and set api = {API}"
    return f"made for contract {api}; this gridtrack has contract {API}"


def _has_fit(found: type[Tracker]) -> bool:
    return found.fit.__func__ is not Tracker.fit.__func__  # type: ignore[attr-defined]


def _signature_breach(found: type[Tracker]) -> str:
    calls = {
        "__init__": ("stream", "options"),
        "reset": ("seed",),
        "update": ("frame",),
        "predict": ("steps",),
        "export": ("folder",),
    }
    for method, arguments in calls.items():
        signature = inspect.signature(getattr(found, method))
        try:
            signature.bind("self", *arguments)
        except TypeError:
            return f"{method}{signature} cannot be called as {method}({', '.join(arguments)})"
    fit = inspect.signature(found.fit)
    try:
        fit.bind("task")
    except TypeError:
        return f"fit{fit} cannot be called as fit(task): from contract {API} on it takes one FitTask"
    return ""


def _attribute_breach(found: type[Tracker]) -> str:
    for flag in ("moving_sensor", "learns", "learns_general"):
        if not isinstance(getattr(found, flag), bool):
            return f"{flag} is {getattr(found, flag)!r}; expected True or False"
    if found.role not in get_args(Role):
        return f"role is {found.role!r}; expected one of {', '.join(get_args(Role))}"
    if not isinstance(found.reference_for, frozenset) or not found.reference_for <= set(get_args(ComparedPart)):
        return f"reference_for is {found.reference_for!r}; expected a frozenset of {', '.join(get_args(ComparedPart))}"
    if found.learns and not _has_fit(found):
        return "it learns, but has no fit"
    return ""


def code_sha256(tracker: type[Tracker]) -> str:
    """The hash of the code of a tracker, which shows whether it was edited between two runs.

    It covers the loaded source files of its package, and files below the folder of its module except installed
    libraries. "" for a class without a file, as in a notebook.
    """
    files = dict(sorted(_source_files(tracker.__module__.partition(".")[0])))
    digest = hashlib.sha256()
    for name, path in files.items():
        digest.update(f"{name}:{sha256_of(path)}\n".encode())
    return digest.hexdigest() if files else ""


def _source_files(package: str) -> Iterator[tuple[str, Path]]:
    """The name and the file of each loaded module that belongs to `package` or lies beside it."""
    top = getattr(sys.modules.get(package), "__file__", None)
    root = Path(top).parent if top else None
    below = f"{root}{os.sep}" if root is not None and root.name not in INSTALLED else None
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None) or ""
        if name.partition(".")[0] == package or (below is not None and _is_own(file, below)):
            path = Path(file)
            if path.is_file():
                yield name, path


def _is_own(file: str, below: str) -> bool:
    """Whether a file lies below a folder, and not in a library that is installed there."""
    return file.startswith(below) and not set(INSTALLED) & set(Path(file.removeprefix(below)).parts)
