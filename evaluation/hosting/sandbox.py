"""The sandbox of an untrusted tracker: bubblewrap shows its program only its own code and its weights.

Linux namespaces without privileges, set up by `bwrap`: no network, no other processes, and no writable files outside
`/tmp` and `/dev/shm`, which are its own memory. A filter refuses system calls that could leave data in the kernel
after the end of the process. docs/wire.md describes its guarantees and its limits.
"""

from __future__ import annotations

import errno
import fcntl
import filecmp
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

from gridtrack.common.errors import ConfigurationError, one_line
from gridtrack.common.files import read_bounded
from gridtrack.common.untrusted import parse_json
from gridtrack.evaluation.hosting.supervisor import IN_MEMORY
from gridtrack.trackers.selection import Launch

BUBBLEWRAP = "bwrap"
PROBE_S = 30.0
MAX_LINK_BYTES = 1 << 16
KEPT_VARIABLES = ("PATH", "PYTHONPATH", "LANG", "LC_ALL", "TZ")
INSIDE = {"HOME": "/tmp", "TMPDIR": "/tmp", "USER": "tracker"}
NAMESPACES = ("user", "ipc", "pid", "net", "uts", "cgroup-try")
SYSTEM = (
    *("/usr", "/bin", "/lib", "/lib32", "/lib64", "/sbin"),
    *("/etc/alternatives", "/etc/ld.so.cache", "/etc/localtime"),
)
PROCESSORS = "/sys/devices/system/cpu"
"""Numerical libraries look here for the number of cores."""
GRIDTRACK = Path(__file__).parents[2]
GRIDTRACK_DATA = "data"
"""Recordings and weights of the package, which an ordinary installation has beside its code."""
GRIDTRACK_CODE = ("__init__.py", "common", "trackers")
"""The parts of gridtrack that a tracker imports. In an editable installation recordings and runs lie beside them."""
REFUSED_CALLS = (
    *("add_key", "request_key", "keyctl", "mincore", "preadv2", "fadvise64", "io_uring_setup"),
    *("flock", "inotify_init", "inotify_init1", "fanotify_init"),
)
"""System calls by which a program could store data for its next start, in the kernel's keyrings and in the choice of
the pages of a file that the kernel has in memory, or learn that another one has locked or opens a file."""
REFUSED_COMMANDS = (fcntl.F_GETLK, 36, fcntl.F_SETLEASE, fcntl.F_NOTIFY)
"""Commands of the system call `fcntl` that tell of the locks of others; 36 is F_OFD_GETLK."""
CACHESTAT = 451
"""The number of a system call of this kind that older versions of libseccomp do not know by name."""
LOCKS = "/proc/locks"
CACHES, CACHE_ROOM = "/run/caches", 1 << 20
COPY = f'n=0; while [ "$1" != -- ]; do cp {CACHES}/$n/* "$1"/; n=$((n+1)); shift; done; shift; exec "$@"'


@dataclass(frozen=True, slots=True)
class SandboxView:
    """What a sandboxed program sees beside the system's libraries: `folders` and `files`, without the `hidden` ones."""

    folders: tuple[Path, ...]
    hidden: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()
    """Visible even below a hidden folder."""
    compiled: tuple[Path, ...] = ()
    """Folders of compiled code (`__pycache__`), shown as copies: numba ignores those that it cannot write to."""

    def arguments(self) -> Iterator[str]:
        """The options of bwrap; an outer folder comes before its inner ones."""
        for folder in sorted({path for path in self.folders if path.exists()}):
            yield from ("--ro-bind", str(folder), str(folder))
        inside = {folder.resolve() for folder in self.folders}
        for path in sorted({path.resolve() for path in self.hidden if path.exists()}):
            if inside & set(path.parents):
                yield from ("--tmpfs", str(path)) if path.is_dir() else ("--ro-bind", "/dev/null", str(path))
        for path in self.files:
            yield from ("--ro-bind", str(path), str(path))
        for number, path in enumerate(self.compiled):
            size = str(CACHE_ROOM + _bytes_in(path))
            yield from ("--ro-bind", str(path), f"{CACHES}/{number}", "--size", size, "--tmpfs", str(path))

    def starting(self, argv: Iterable[str]) -> tuple[str, ...]:
        """The command inside the sandbox: `argv`, after a shell that copies the compiled code."""
        if not self.compiled:
            return tuple(argv)
        return ("/bin/sh", "-c", COPY, "sh", *map(str, self.compiled), "--", *argv)


def check_sandbox() -> None:
    """Raise ConfigurationError, with the remedy, if this machine cannot confine a program."""
    problem = _problem()
    if problem:
        raise ConfigurationError(f"--sandbox: {problem}")


@cache
def _problem() -> str:
    if sys.platform != "linux":
        return "it works on Linux only: run trackers in a container, without --sandbox"
    if shutil.which(BUBBLEWRAP) is None:
        return "bubblewrap is not installed: install the package `bubblewrap` of the system (`apt install bubblewrap`)"
    try:
        with system_call_filter() as number:
            command = confined(("true",), SandboxView(()), 16, None, number)
            tried = subprocess.run(command, capture_output=True, timeout=PROBE_S, check=False, pass_fds=(number,))
    except ImportError as error:
        return f"{error}: install `pyseccomp` and the library `libseccomp2` of the system"
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"bubblewrap cannot be started ({error})"
    if tried.returncode == 0:
        return ""
    problem = one_line(tried.stderr.decode(errors="replace"), 200)
    return (
        f"bubblewrap cannot confine a program here ({problem}): it needs version 0.8 or later, and a kernel and a"
        " container that let users make namespaces; without --sandbox, use a container that has no recordings"
    )


@contextmanager
def system_call_filter() -> Iterator[int]:
    """The descriptor of a filter for bwrap's option `--seccomp`: REFUSED_CALLS fail.

    Raises ImportError without libseccomp.
    """
    with tempfile.TemporaryFile() as file:
        file.write(_filter_program())
        file.seek(0)
        yield file.fileno()


@cache
def _filter_program() -> bytes:
    try:
        import pyseccomp
    except RuntimeError as error:  # raised where the library of the system is missing
        raise ImportError(str(error)) from None
    rules = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
    for call in (*REFUSED_CALLS, CACHESTAT):
        rules.add_rule(pyseccomp.ERRNO(errno.ENOSYS), call)
    for command in REFUSED_COMMANDS:
        rules.add_rule(pyseccomp.ERRNO(errno.ENOSYS), "fcntl", pyseccomp.Arg(1, pyseccomp.EQ, command))
    with tempfile.TemporaryFile() as file:
        rules.export_bpf(file)
        file.seek(0)
        return file.read()


def confine(
    launch: Launch,
    environment: Mapping[str, str],
    memory_mb: int,
    recordings: Iterable[Path],
    hidden: Iterable[Path],
    files: Iterable[Path],
    filter_number: int,
) -> tuple[tuple[str, ...], dict[str, str]]:
    """The command that starts a program in the sandbox, and its environment.

    It sees its own code and the `files`, but neither the `recordings`, their copies, nothing `hidden` and no data of
    gridtrack. `filter_number` is that of `system_call_filter`.
    """
    program = launch.argv[0]
    folders = code_folders(program, launch.cwd, environment)
    packaged = (folder / GRIDTRACK_DATA for folder in _packages(folders))
    out_of_sight = (*recordings, *copies_of(tuple(recordings), folders), *hidden, *packaged)
    view = SandboxView(folders, out_of_sight, tuple(files), compiled_folders(program))
    variables = {name: environment[name] for name in KEPT_VARIABLES if name in environment}
    return confined(launch.argv, view, memory_mb, launch.cwd, filter_number), variables


def _packages(folders: Iterable[Path]) -> set[Path]:
    """The folders of gridtrack in an environment that is shown whole, and that of this process."""
    installed = (path for folder in folders for path in folder.glob("lib*/python*/site-packages/gridtrack"))
    return {GRIDTRACK.resolve(), *installed}


@cache
def copies_of(recordings: tuple[Path, ...], folders: tuple[Path, ...]) -> tuple[Path, ...]:
    """The files in `folders` with the content of a file of the `recordings`; only files of equal size are read."""
    by_size: dict[int, list[str]] = {}
    for path, size in (file for recording in recordings for file in _files_of(recording)):
        by_size.setdefault(size, []).append(path)
    by_size.pop(0, None)
    if not by_size:
        return ()
    found = []
    for path, size in (file for folder in folders for file in _files_of(folder)):
        with suppress(OSError):  # another process may remove it
            if any(filecmp.cmp(path, one, shallow=False) for one in by_size.get(size, ())):
                found.append(Path(path))
    return tuple(found)


def _files_of(path: Path) -> Iterator[tuple[str, int]]:
    """The regular files at `path` or below with their sizes, B; no object for each: there may be 100,000 of them."""
    if path.is_file():
        yield str(path), path.stat().st_size
    folders = [str(path)]
    while folders:
        try:
            entries = list(os.scandir(folders.pop()))
        except OSError:
            continue
        for entry in entries:
            with suppress(OSError):  # a link in a circle, or a file that is gone: the others count
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                elif entry.is_file():
                    yield entry.path, entry.stat().st_size


def confined(
    argv: Iterable[str], view: SandboxView, memory_mb: int, cwd: Path | None, filter_number: int
) -> tuple[str, ...]:
    """The command that runs `argv` with `view` in the folder `cwd`; /tmp and /dev/shm have `memory_mb` MiB each.

    The process inherits the descriptor `filter_number`, as of `system_call_filter`.
    """
    size = str(memory_mb << 20)
    options = [f"--unshare-{name}" for name in NAMESPACES]
    options += ["--disable-userns", "--cap-drop", "ALL", "--die-with-parent", "--new-session"]
    options += ["--seccomp", str(filter_number)]
    for path in SYSTEM:
        options += ["--ro-bind-try", path, path]
    options += ["--ro-bind-try", PROCESSORS, PROCESSORS, "--proc", "/proc", "--dev", "/dev"]
    options += ["--ro-bind", "/dev/null", LOCKS]
    for path in IN_MEMORY:
        options += ["--size", size, "--tmpfs", path]
    options += view.arguments()
    for name, value in INSIDE.items():
        options += ["--setenv", name, value]
    options += ["--remount-ro", "/dev", "--remount-ro", "/", "--chdir", str(cwd or "/")]
    return (BUBBLEWRAP, *options, "--", *view.starting(argv))


def code_folders(program: str, cwd: Path | None, environment: Mapping[str, str]) -> tuple[Path, ...]:
    """The folders with the code of `program`: `cwd`, its Python environment, and those in PYTHONPATH."""
    found = shutil.which(program, path=environment.get("PATH"))
    path = Path(found or program).absolute()
    folders = [cwd] if cwd else []
    if program == sys.executable:
        folders += _code_of(GRIDTRACK.resolve())
    if path.name.startswith("python"):
        for prefix in _prefixes(path):
            folders += [prefix, *_editable_folders(prefix)]
    else:
        folders += [path, path.resolve()]
    folders += [Path(entry).absolute() for entry in environment.get("PYTHONPATH", "").split(":") if entry]
    return tuple(folder for folder in folders if not folder.is_relative_to("/usr"))


def compiled_folders(program: str) -> tuple[Path, ...]:
    """Folders of gridtrack in this environment in which numba has stored compiled code."""
    if program != sys.executable:
        return ()
    parts = _code_of(GRIDTRACK.resolve())
    return tuple(sorted({file.parent for part in parts for file in part.rglob("*.nbi")}))


def _code_of(gridtrack: Path) -> tuple[Path, ...]:
    """The files and folders of the package `gridtrack` that a tracker imports."""
    return tuple(gridtrack / part for part in GRIDTRACK_CODE)


def _bytes_in(folder: Path) -> int:
    """The size of the files in a folder; another process may replace some meanwhile."""
    total = 0
    for file in folder.iterdir():
        with suppress(FileNotFoundError):
            total += file.stat().st_size
    return total


def _prefixes(python: Path) -> tuple[Path, ...]:
    """Folders of an interpreter's environment and of the installation that it comes from."""
    base = python.resolve().parents[1]
    own = python.parents[1]
    return (own, base) if (own / "pyvenv.cfg").exists() else (base,)


def _editable_folders(prefix: Path) -> Iterator[Path]:
    """Folders of the distributions in an environment that were installed as editable (PEP 610)."""
    for link in sorted(prefix.glob("lib*/python*/site-packages/*.dist-info/direct_url.json")):
        try:
            origin = parse_json(read_bounded(link, MAX_LINK_BYTES, ConfigurationError))
            editable, url = origin["dir_info"]["editable"], urlsplit(origin["url"])
        except (OSError, ValueError, KeyError, TypeError):
            continue  # the distribution is not editable
        folder = Path(unquote(url.path))
        if editable and url.scheme == "file" and folder != Path("/"):
            own = link.parent.name.startswith("gridtrack-")
            yield from _code_of(folder) if own else (folder,)
