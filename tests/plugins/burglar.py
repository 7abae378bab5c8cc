"""A tracker that attacks the host and the recording when it starts, and reports the results on stderr."""

from __future__ import annotations

import ctypes
import fcntl
import json
import mmap
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Forecast, StreamSpec, Tracker

CLONE_NEWUSER = 0x10000000
ADD_KEY, KEYCTL = {"x86_64": (248, 250), "aarch64": (217, 219)}[os.uname().machine]
KEYCTL_UNLINK, KEYCTL_SEARCH = 9, 10
F_OFD_GETLK, IN_OPEN = 36, 0x20
BLOCK = 1 << 20


class Attacks(Settings):
    attacks: tuple[tuple[str, str], ...] = ()
    """Names of functions of this module with their targets: a path, a port or a process."""


class Burglar(Tracker):
    """Carries out its attacks, one after the other."""

    Options = Attacks

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        found = [globals()[name](target) for name, target in options.attacks]
        print("found:", json.dumps(found), file=sys.stderr, flush=True)

    def reset(self, seed: int) -> None: ...

    def update(self, frame: GridFrame) -> None: ...

    def predict(self, steps: int) -> Forecast:
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))


def reads(path: str) -> str:
    """The first bytes of a file."""
    try:
        with Path(path).open("rb") as file:
            return file.read(8).hex()
    except OSError:
        return ""


def rewrites(path: str) -> bool:
    """Whether a file could be overwritten."""
    try:
        return bool(Path(path).write_text("burglar"))
    except OSError:
        return False


def calls(port: str) -> bool:
    """Whether a server on this machine answers."""
    try:
        with socket.create_connection(("127.0.0.1", int(port)), timeout=2.0):
            return True
    except OSError:
        return False


def looks(_: str) -> list[str]:
    """The command lines of all processes in sight."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):  # it has ended
            if entry.name.isdigit():
                found.append((entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return found


def reads_memory(pid: str) -> bool:
    """Whether the memory of a process can be opened."""
    try:
        with Path(f"/proc/{pid}/mem").open("rb"):
            return True
    except OSError:
        return False


def kills(pid: str) -> bool:
    """Whether a process could be ended."""
    try:
        os.kill(int(pid), signal.SIGKILL)
    except OSError:
        return False
    return True


def kills_all(_: str) -> bool:
    """Whether any process in sight but itself could be ended."""
    try:
        os.kill(-1, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def outlives(seconds: str) -> None:
    """Leave a process in a session of its own, and end the supervisor."""
    subprocess.Popen(["sleep", seconds], start_new_session=True)
    os.kill(os.getppid(), signal.SIGKILL)


def writes(_: str) -> list[str]:
    """Every folder in which a file can be made."""
    found = []
    for folder, folders, _files in os.walk("/"):
        folders[:] = [name for name in folders if (folder, name) != ("/", "proc")]
        try:
            Path(folder, "burglar").write_text("")
        except OSError:
            continue
        Path(folder, "burglar").unlink()
        found.append(folder)
    return found


def fills(folder: str) -> int:
    """Write files until the memory is full; its size, MiB."""
    written = 0
    with suppress(OSError), Path(folder, "burglar").open("wb", buffering=0) as file:
        while True:
            written += file.write(bytes(BLOCK))
    time.sleep(0.3)  # the supervisor measures 20 times a second
    return written // BLOCK


def makes_a_namespace(_: str) -> bool:
    """Whether it could become the root of a user namespace of its own, where it could mount memory without a limit."""
    return ctypes.CDLL(None).unshare(CLONE_NEWUSER) == 0


def leaves_a_key(keyring: str) -> bool:
    """Whether it could leave a key in a keyring of the kernel, by its number: -3 of the session, -4 of the user."""
    return ctypes.CDLL(None).syscall(ADD_KEY, b"user", b"burglar", b"seen", 4, int(keyring)) > 0


def finds_a_key(keyring: str) -> bool:
    """Whether a key that it left before is there; it is removed."""
    key = ctypes.CDLL(None).syscall(KEYCTL, KEYCTL_SEARCH, int(keyring), b"user", b"burglar", 0)
    ctypes.CDLL(None).syscall(KEYCTL, KEYCTL_UNLINK, key, int(keyring))
    return key > 0


def leaves_pages(path: str) -> None:
    """Leave every second page of a file in the memory of the kernel."""
    file = os.open(path, os.O_RDONLY)
    for advice in (os.POSIX_FADV_DONTNEED, os.POSIX_FADV_RANDOM):
        with suppress(OSError):
            os.posix_fadvise(file, 0, 0, advice)
    for page in range(0, 16, 2):
        os.pread(file, 1, page * mmap.PAGESIZE)
    os.close(file)


def finds_pages(path: str) -> list[bool]:
    """Which pages of a file are in the memory of the kernel; none if it cannot be asked."""
    file, found = os.open(path, os.O_RDONLY), []
    for page in range(16):
        try:
            found.append(os.preadv(file, [bytearray(1)], page * mmap.PAGESIZE, os.RWF_NOWAIT) == 1)
        except BlockingIOError:
            found.append(False)
        except OSError:
            break
    os.close(file)
    return found


def senses_locks(path: str) -> list[str]:
    """The ways in which this process learns that another one has locked a file, or opens it."""
    question = struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    inotify = ctypes.CDLL(None).inotify_init1(os.O_NONBLOCK)
    found = ["inotify"] if ctypes.CDLL(None).inotify_add_watch(inotify, path.encode(), IN_OPEN) >= 0 else []
    with Path(path).open("rb") as file:
        for name, command in (("F_GETLK", fcntl.F_GETLK), ("F_OFD_GETLK", F_OFD_GETLK)):
            with suppress(OSError):
                answer = struct.unpack("hhqqi", fcntl.fcntl(file, command, question))
                found += [name] if answer[0] == fcntl.F_RDLCK else []
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            found.append("flock")
        except OSError:
            pass
        with suppress(OSError):
            fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)
            found.append("F_SETLEASE")
        inode = f":{os.fstat(file.fileno()).st_ino} "
    with suppress(OSError):
        found += ["/proc/locks"] * (inode in Path("/proc/locks").read_text())
    return found


def variables(_: str) -> dict[str, str]:
    """Its environment."""
    return dict(os.environ)
