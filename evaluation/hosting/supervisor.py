"""The supervisor of one program, a tracker or a training: limits its memory and its log, and ends all its processes.

A separate program that uses the standard library only, so that it starts in a few hundredths of a second:

    python -I -S supervisor.py CONTROL_FD MEMORY_MB LOG FOLDER PROGRAM [ARGUMENT...]

The nursery has loaded what every tracker in Python needs. For each request on a socket it forks a supervisor, which
forks the tracker, in a few thousandths of a second:

    python -P supervisor.py REQUESTS_FD

Descriptors 0 and 1 are the program's wire. Descriptor 2 is its log, of bounded size where LOG is 1.
With MEMORY_MB 0 its memory is neither limited nor measured. On CONTROL_FD, a socket to the host, each byte asks for an
interrupt (SIGINT) of the program, and the end of the stream for its end: the host closed it or died. When the program
has ended, the supervisor kills every process that the program started, removes FOLDER, which holds its temporary files,
and its files in shared memory, sends one line of JSON, and exits. As a separate process it does not depend on the
host's threads, and it is the only process that adopts orphans of the program.

/proc is read here and not through psutil: psutil finds descendants by reading every process of the machine, 9 ms
against 0.1 ms, 20 times a second for each tracker, and reports neither peak nor shared memory.
"""

from __future__ import annotations

import collections
import ctypes
import gc
import json
import math
import os
import pathlib
import resource
import select
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable

MEMORY_PERIOD_S = 0.05
GIVE_UP_S = 5.0
IDLE_S = 60.0
"""The nursery ends after as long without a request."""
FORK, LENGTH_BYTES = b"fork", 4
LOG_BYTES = 1 << 20
SHARED_MEMORY, MEMFD = "/dev/shm/", "/memfd:"
IN_MEMORY = ("/tmp", "/dev/shm")
ARG_START, ARG_END = 45, 46
"""Positions in /proc/self/stat, after the name in parentheses, of the command line's addresses (proc(5), 48 and 49)."""
PR_SET_PDEATHSIG, PR_SET_DUMPABLE, PR_SET_CHILD_SUBREAPER = 1, 4, 36
KEYCTL = {"x86_64": 250, "aarch64": 219}
KEYCTL_JOIN_SESSION_KEYRING = 1


def main() -> None:
    """Supervise one program from its start to its end, or fork supervisors on request."""
    given, arguments = socket.socket(fileno=int(sys.argv[1])), sys.argv[2:]
    if arguments:
        supervise(given, arguments, exec_program)
        return
    os.close(os.pidfd_open(os.getpid()))  # fails at once on a system without it
    from gridtrack.trackers import serve

    if command := answer_requests(given):
        sys.argv = [serve.__file__, *command[-1:]]
        serve.main()


def answer_requests(requests: socket.socket) -> list[str]:
    """Fork a supervisor for each of the `requests`. Returns in each program that these fork, with its command, and at
    the end, without one.

    A request has the descriptors of the wire, of the log and of CONTROL_FD; the supervisor alone reads the rest there.
    The answer has the number of the supervisor's process and a descriptor of it. This process learns nothing of a
    tracker, and no tracker can write to its memory: none finds anything of another one.
    """
    make_unreadable()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for the supervisors
    gc.freeze()
    requests.settimeout(IDLE_S)
    while True:
        try:
            request, descriptors, *_ = socket.recv_fds(requests, len(FORK), 4)
        except (TimeoutError, ConnectionError):
            return []
        if not request:
            return []
        pid = os.fork()
        if pid == 0:
            requests.close()
            return supervise_forked(descriptors)
        close_all(descriptors)
        supervisor = os.pidfd_open(pid)
        socket.send_fds(requests, [str(pid).encode()], [supervisor])
        os.close(supervisor)


def supervise_forked(descriptors: list[int]) -> list[str]:
    """Supervise a program from its start to its end, and exit. Returns in the forked program alone: its command.

    The host sends the working folder, the environment and the arguments of this supervisor as JSON after its length.
    """
    try:
        os.setsid()  # else it is an orphan of the host once the nursery has ended
        *wire_and_log, control_fd = descriptors
        for number, descriptor in enumerate(wire_and_log):
            os.dup2(descriptor, number)
        close_all(wire_and_log)
        control = socket.socket(fileno=control_fd)
        size = int.from_bytes(control.recv(LENGTH_BYTES, socket.MSG_WAITALL), "little")
        found = json.loads(control.recv(size, socket.MSG_WAITALL))
        os.chdir(found["cwd"])
        os.environ.clear()
        os.environ.update(found["env"])
        time.tzset()
        supervise(control, found["arguments"], become_program)
    except ProgramForked as forked:
        command = forked.command
    except BaseException:  # noqa: BLE001 - a supervisor never returns to the loop of the nursery
        traceback.print_exc()
        os._exit(1)
    else:
        os._exit(0)
    os.closerange(3, max(map(int, names_in("/proc/self/fd"))) + 1)
    return command


class ProgramForked(BaseException):
    """Leaves the frames of the supervisor in the program that it forked."""

    def __init__(self, command: list[str]) -> None:
        super().__init__()
        self.command = command


def close_all(descriptors: list[int]) -> None:
    """Close the descriptors."""
    for descriptor in descriptors:
        os.close(descriptor)


Start = Callable[[list[str], int, int], None]
"""What a forked child does to be the program: from its command, its stderr, and where to write why it cannot start."""


def supervise(control: socket.socket, arguments: list[str], start: Start) -> None:
    """Supervise a program from its start to its end; `arguments`: MEMORY_MB, LOG, FOLDER and its command."""
    control.set_inheritable(False)
    prctl(PR_SET_CHILD_SUBREAPER, 1)
    make_unreadable()
    wake, notify = os.pipe()
    os.set_blocking(notify, False)
    signal.set_wakeup_fd(notify, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    memory_mb, log, folder, *command = arguments
    os.environ["TMPDIR"] = folder
    program = Program(command, start, memory_kb=int(memory_mb) * 1024, bounded_log=log == "1")
    program.watch(control, wake)
    program.end()
    remove_folder(folder)
    # the host may have died: the line is then not needed
    with control:
        try:
            control.sendall(json.dumps(program.exit_report()).encode() + b"\n")
        except OSError:
            return


class Program:
    """The supervised program: its exit status, peak memory and log."""

    def __init__(self, command: list[str], start: Start, memory_kb: int, *, bounded_log: bool) -> None:
        """Start it; `memory_kb` 0: its memory is not measured."""
        self.memory_kb = memory_kb
        self.shared = SharedFiles()
        self.peak_kb = 0
        self.over_memory = False
        self.status: int | None = None
        self.log = BoundedLog(2) if bounded_log else None
        failure, fail = os.pipe()  # closed when the program starts
        self.pid = os.fork()
        if self.pid == 0:
            start(command, self.log.source if self.log else 2, fail)
        os.close(fail)
        if self.log:
            os.close(self.log.source)
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)
        os.dup2(nothing, 1)
        failed = os.read(failure, 4096).decode(errors="replace")
        self.start_error = failed and f"{command[0]}: {failed}"

    def watch(self, control: socket.socket, wake: int) -> None:
        """Return when the program has ended or exceeds its memory limit, or the host asks for its end."""
        poll = select.poll()
        for fd in (control.fileno(), wake, *((self.log.reading,) if self.log else ())):
            poll.register(fd, select.POLLIN)
        next_measurement = time.monotonic() if self.memory_kb else math.inf
        while self.status is None and not self.over_memory:
            left_s = max(0.0, next_measurement - time.monotonic())
            ready = {fd for fd, _ in poll.poll(left_s * 1000 if self.memory_kb else None)}
            if control.fileno() in ready:
                if not control.recv(1):
                    return
                kill(self.pid, signal.SIGINT)
            if wake in ready:
                os.read(wake, 4096)
                self.reap()
            if self.log and self.log.reading in ready and not self.log.copy():
                poll.unregister(self.log.reading)
            if time.monotonic() >= next_measurement:
                self.measure_memory()
                next_measurement = time.monotonic() + MEMORY_PERIOD_S

    def measure_memory(self) -> None:
        """Measure the memory of the program, of all processes that it started, and of their files in shared memory.

        To count shared pages once costs time. It is done only where the simple sum over the processes, which counts
        them in each, is above the peak or the limit.
        """
        pids = descendants(os.getpid())
        sizes = {pid: resident_kb(pid) for pid in pids}
        files_kb = self.shared.find(pids)
        total = sum(now for now, _ in sizes.values()) + files_kb
        if (len(pids) > 1 or files_kb) and total > min(self.memory_kb, self.peak_kb):
            total = proportional_kb(sizes, files_kb)
        self.peak_kb = max(self.peak_kb, total, sizes.get(self.pid, (0, 0))[1])
        self.over_memory = total > self.memory_kb

    def reap(self) -> bool:
        """Collect the status of every ended child, adopted orphans included. Returns whether any child is left."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return False
            if pid == 0:
                return True
            if pid == self.pid:
                self.status = status

    def end(self) -> None:
        """Kill the program and all its descendants, and write the rest of its log.

        Repeated, because the supervisor adopts the children of each killed process; after GIVE_UP_S it gives up on
        processes that do not die.
        """
        give_up = time.monotonic() + GIVE_UP_S
        self.shared.find(descendants(os.getpid()))
        while self.reap() and time.monotonic() < give_up:
            for pid in descendants(os.getpid()) or [self.pid]:
                kill(pid, signal.SIGKILL)
            time.sleep(0.002)
        self.shared.remove()
        if self.log:
            self.log.finish()

    def exit_report(self) -> dict[str, object]:
        """The fields of ProcessExit, for the host."""
        return {
            "status": self.status,
            "peak_kb": self.peak_kb,
            "over_memory": self.over_memory,
            "start_error": self.start_error,
        }


class SharedFiles:
    """Files in memory that processes have open or mapped: without a name (memfd), or in SHARED_MEMORY.

    For processes with their own mounts, in a sandbox, all files in their own IN_MEMORY are counted.
    """

    def __init__(self) -> None:
        self.before = names_in(SHARED_MEMORY)
        self.owned: set[str] = set()
        self.mounts = link_target("/proc/self/ns/mnt")
        self.systems = {system for folder in IN_MEMORY for system, _ in allocated(folder)}

    def find(self, pids: list[int]) -> int:
        """Find the files of these processes. Returns the size of all files found until now, KiB."""
        sizes: dict[tuple[int, int], int] = {}
        for pid in pids:
            apart = link_target(f"/proc/{pid}/ns/mnt") != self.mounts
            for descriptor in names_in(f"/proc/{pid}/fd"):
                self.add_size(f"/proc/{pid}/fd/{descriptor}", sizes, apart)
            if apart:
                own = (used(f"/proc/{pid}/root{folder}") for folder in IN_MEMORY)
                sizes |= {key: size for found in own for key, size in found.items() if key[0] not in self.systems}
            elif names_in(SHARED_MEMORY) - self.before:
                self.owned |= {path for path in mapped_files(pid) if self.is_new(path)}
        for path in self.owned:
            sizes |= allocated(path)
        return sum(sizes.values()) // 1024

    def add_size(self, link: str, sizes: dict[tuple[int, int], int], apart: bool) -> None:
        """Add the size of the file behind the descriptor `link` to `sizes`, if it is in memory.

        With its own mounts (`apart`) a named file counts with its folder.
        """
        target = link_target(link)
        if target.startswith(MEMFD):
            sizes |= allocated(link)
        elif self.is_new(target) and not apart:
            sizes |= allocated(link)
            self.owned.add(target)

    def is_new(self, path: str) -> bool:
        """Whether `path` lies in shared memory and was not there when the program started."""
        return path.startswith(SHARED_MEMORY) and path[len(SHARED_MEMORY) :].partition("/")[0] not in self.before

    def remove(self) -> None:
        """Remove the files that were found."""
        for path in self.owned:
            try:
                pathlib.Path(path).unlink()
            except OSError:  # the program removed it, or it never had a name
                continue


class BoundedLog:
    """Copies a pipe to a log of bounded size: its first and last LOG_BYTES, and the number of bytes between them."""

    def __init__(self, fd: int) -> None:
        """`fd`: the file of the log. The program writes to `source`, which is read from `reading`."""
        self.fd = fd
        self.reading, self.source = os.pipe()
        os.set_blocking(self.reading, False)
        self.head_left = LOG_BYTES
        self.tail: collections.deque[bytes] = collections.deque()
        self.tail_bytes = 0
        self.left_out = 0

    def copy(self) -> bool:
        """Copy the next bytes. Returns whether there may be more."""
        try:
            text = os.read(self.reading, 1 << 16)
        except BlockingIOError:
            return False
        head, tail = text[: self.head_left], text[self.head_left :]
        self.write(head)
        self.head_left -= len(head)
        if tail:
            self.tail.append(tail)
            self.tail_bytes += len(tail)
        while self.tail_bytes > LOG_BYTES:
            dropped = len(self.tail.popleft())
            self.tail_bytes -= dropped
            self.left_out += dropped
        return bool(text)

    def finish(self) -> None:
        """Copy the rest, then write the number of bytes left out, and the tail."""
        while self.copy():
            pass
        if self.left_out:
            self.write(f"\n... {self.left_out} bytes left out ...\n".encode())
        for part in self.tail:
            self.write(part)

    def write(self, text: bytes) -> None:
        """Write all of `text`; a full disk ends the log, not the trial."""
        try:
            while text:
                text = text[os.write(self.fd, text) :]
        except OSError:
            self.head_left = 0


def exec_program(command: list[str], stderr: int, fail: int) -> None:
    """In the forked child: execute the program; where that fails, write the reason to `fail`."""
    try:
        leave_supervisor(stderr)
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        os.execvp(command[0], command)
    except OSError as error:
        os.write(fail, (error.strerror or str(error)).encode())
    finally:
        os._exit(127)


def become_program(command: list[str], stderr: int, fail: int) -> None:
    """In the forked child: undo what exec would undo, and raise ProgramForked."""
    leave_supervisor(stderr)
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    prctl(PR_SET_DUMPABLE, 1)
    show_arguments("\0".join(command).encode())
    if random := sys.modules.get("numpy.random"):
        random.seed()
    os.close(fail)
    raise ProgramForked(command)


def leave_supervisor(stderr: int) -> None:
    """Make this process a program of its own, with the log `stderr`, that ends with its supervisor."""
    supervisor = os.getppid()
    prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != supervisor:
        os._exit(127)
    os.setsid()
    join_new_keyring()
    os.dup2(stderr, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def prctl(option: int, value: int) -> None:
    """Set a process attribute on Linux; on other systems only the program itself is supervised."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def join_new_keyring() -> None:
    """Give this process a new session keyring: keys in the keyring of the user's session would outlive it."""
    if (number := KEYCTL.get(os.uname().machine)) and sys.platform == "linux":
        ctypes.CDLL(None).syscall(number, KEYCTL_JOIN_SESSION_KEYRING, None)


def make_unreadable() -> None:
    """Hide this process's descriptors, environment and memory from others in /proc: its log names the recording."""
    prctl(PR_SET_DUMPABLE, 0)


def shown_arguments() -> tuple[int, int]:
    """Address and size of the command line that others see of this process, on Linux."""
    fields = pathlib.Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start = int(fields[ARG_START])
    return start, int(fields[ARG_END]) - start if start else 0


def show_arguments(text: bytes) -> None:
    """Show `text` in place of the command line, as far as there is room."""
    start, size = shown_arguments()
    if size > 1:
        # the last byte stays 0: else the kernel takes the environment for a part of the command line
        ctypes.memmove(start, text[: size - 1].ljust(size, b"\0"), size)


def descendants(pid: int) -> list[int]:
    """All descendants of `pid`, from /proc."""
    found: list[int] = []
    unvisited = [pid]
    while unvisited:
        below = children(unvisited.pop())
        found += below
        unvisited += below
    return found


def children(pid: int) -> list[int]:
    """The children of `pid`, from /proc."""
    found: list[int] = []
    for task in names_in(f"/proc/{pid}/task"):
        try:
            found += map(int, pathlib.Path(f"/proc/{pid}/task/{task}/children").read_text().split())
        except OSError:  # this thread has ended in the meantime
            continue
    return found


def resident_kb(pid: int) -> tuple[int, int]:
    """Current and peak resident memory of `pid`, KiB; (0, 0) where it has ended."""
    sizes = fields_kb(f"/proc/{pid}/status", ("VmRSS", "VmHWM"))
    return (sizes["VmRSS"], sizes["VmHWM"])


def fields_kb(path: str, names: tuple[str, ...]) -> dict[str, int]:
    """The named fields of a file of /proc, KiB; 0 where it cannot be read or has no such field."""
    sizes = dict.fromkeys(names, 0)
    try:
        text = pathlib.Path(path).read_text()
    except OSError:
        return sizes
    for line in text.splitlines():
        name, _, value = line.partition(":")
        if name in sizes:
            sizes[name] = int(value.split(maxsplit=1)[0])
    return sizes


def proportional_kb(sizes: dict[int, tuple[int, int]], files_kb: int) -> int:
    """Memory of processes, KiB: each page divided by the processes that share it, and the part of files not mapped.

    `sizes`: `resident_kb` of each process, which counts where the system does not report shared pages.
    """
    total = mapped = 0
    for pid, (resident, _) in sizes.items():
        found = fields_kb(f"/proc/{pid}/smaps_rollup", ("Pss", "Pss_Shmem"))
        total += found["Pss"] or resident
        mapped += found["Pss_Shmem"]
    return total + max(0, files_kb - mapped)


def allocated(path: str) -> dict[tuple[int, int], int]:
    """Device, inode and size of a file, bytes; nothing if it is gone."""
    try:
        found = pathlib.Path(path).stat()
    except OSError:
        return {}
    return {(found.st_dev, found.st_ino): 512 * found.st_blocks}


def used(folder: str) -> dict[tuple[int, int], int]:
    """Device and size of all files of the file system at `folder`, bytes; nothing if it is gone.

    Both are of one opened folder: a sandbox that starts mounts its own file systems at the paths of the host's.
    """
    try:
        opened = os.open(folder, os.O_PATH)
    except OSError:
        return {}
    system, device = os.fstatvfs(opened), os.fstat(opened).st_dev
    os.close(opened)
    return {(device, 0): system.f_frsize * (system.f_blocks - system.f_bfree)}


def link_target(path: str) -> str:
    """The target of a link in /proc; "" if it is gone."""
    try:
        return str(pathlib.Path(path).readlink())
    except OSError:
        return ""


def names_in(folder: str) -> set[str]:
    """Names in a folder; none where it cannot be read."""
    try:
        return {path.name for path in pathlib.Path(folder).iterdir()}
    except OSError:
        return set()


def mapped_files(pid: int) -> set[str]:
    """Paths of the files that a process has mapped."""
    try:
        lines = pathlib.Path(f"/proc/{pid}/maps").read_text(errors="replace").splitlines()
    except OSError:
        return set()
    return {line.split(maxsplit=5)[5] for line in lines if SHARED_MEMORY in line}


def remove_folder(folder: str) -> None:
    """Remove a folder and its content, as far as possible."""
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


def kill(pid: int, number: int) -> None:
    """Send the signal `number` to `pid`, unless it has ended already."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return


if __name__ == "__main__":
    main()
