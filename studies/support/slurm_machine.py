"""A Slurm cluster on this machine: munged, slurmctld and two nodes of one core, on the loopback address."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

NODES = ("one", "two")
START_S = 120.0
CONFIGURATION = """\
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/builtin
SchedulerParameters=batch_sched_delay=0,sched_interval=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
SlurmdParameters=config_overrides
KillWait=2
NodeName=one NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=1 RealMemory=1000
NodeName=two NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=1 RealMemory=1000
PartitionName=low Nodes=one,two Default=YES PriorityTier=1 State=UP
PartitionName=high Nodes=one,two PriorityTier=10 PreemptMode=OFF State=UP
"""


def missing_programs() -> list[str]:
    """The programs of Debian's packages slurmctld, slurmd, slurm-client and munge that are not installed."""
    path = os.pathsep.join((os.environ["PATH"], "/usr/sbin"))
    return [name for name in ("slurmctld", "slurmd", "sbatch", "munged") if shutil.which(name, path=path) is None]


@contextmanager
def slurm_machine() -> Iterator[Path]:
    """A running cluster; the path of its slurm.conf. Raises TimeoutError if a daemon does not start."""
    # the path of a socket has at most 107 characters: a folder of pytest may be too deep
    with tempfile.TemporaryDirectory(prefix="slurm-") as name, ExitStack() as daemons:
        folder = Path(name)
        (folder / "state").mkdir()
        (folder / "munge.key").write_bytes(os.urandom(128))
        (folder / "munge.key").chmod(0o600)
        configuration = folder / "slurm.conf"
        values = {"host": socket.gethostname(), "user": getpass.getuser(), "folder": folder, "ports": _free_ports(3)}
        configuration.write_text(CONFIGURATION.format(**values), "utf-8")
        files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
        munge = [f"--{option}={folder}/munge.{end}" for option, end in files.items()]
        daemons.enter_context(_daemon(folder, "munged", "--foreground", "--force", *munge))
        _await((folder / "munge.socket").exists)
        daemons.enter_context(_daemon(folder, "slurmctld", "-D", "-f", str(configuration)))
        for node in NODES:
            daemons.enter_context(_daemon(folder, "slurmd", "-D", "-N", node, "-f", str(configuration)))
        _await(lambda: _idle_nodes(configuration) == len(NODES))
        yield configuration


def _await(true: Callable[[], bool]) -> None:
    end = time.monotonic() + START_S
    while not true():
        if time.monotonic() > end:
            raise TimeoutError(f"Slurm has not started within {START_S:g} s")
        time.sleep(0.05)


def _free_ports(count: int) -> list[int]:
    with ExitStack() as sockets:
        opened = [sockets.enter_context(closing(socket.socket())) for _ in range(count)]
        for one in opened:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in opened]


@contextmanager
def _daemon(folder: Path, *command: str) -> Iterator[None]:
    """A daemon in the foreground; its output goes to a file beside its other files."""
    environment = {**os.environ, "PATH": os.pathsep.join((os.environ["PATH"], "/usr/sbin"))}
    with (folder / f"{command[0]}.out").open("ab") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out, env=environment)
        try:
            yield
        finally:
            process.terminate()
            process.wait(60)


def _idle_nodes(configuration: Path) -> int:
    command = ["sinfo", "--Node", "--noheader", "--partition=low", "--states=idle", "--format=%N"]
    environment = {**os.environ, "SLURM_CONF": str(configuration)}
    return len(subprocess.run(command, capture_output=True, env=environment, check=False).stdout.split())
