"""A tracker that writes how it finds its own process to the file named in the option `found`."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import stat
import sys
from pathlib import Path

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.trackers.baselines import BlankTracker

PR_GET_DUMPABLE = 3


class Found(Settings):
    found: str = ""


class Mirror(BlankTracker):
    """Forecasts nothing."""

    Options = Found

    def reset(self, seed: int) -> None:
        """Write the state of the process."""
        super().reset(seed)
        kinds = [stat.S_IFMT(mode) for path in Path("/proc/self/fd").iterdir() if (mode := _mode(path))]
        state = {
            "descriptors": sorted(kinds),
            "folder": str(Path.cwd()),
            "environment": {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")},
            "first environment": Path("/proc/self/environ").read_text(),
            "arguments": sys.argv[1:],
            "path": sys.path,
            "leads a session": os.getsid(0) == os.getpid(),
            "its supervisor leads another": os.getsid(os.getppid()) == os.getppid(),
            "handlers": [str(signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGCHLD, signal.SIGPIPE)],
            "wakeup": signal.set_wakeup_fd(-1),
            "core": resource.getrlimit(resource.RLIMIT_CORE),
            "dumpable": ctypes.CDLL(None).prctl(PR_GET_DUMPABLE, 0, 0, 0, 0),
            "random": np.random.random(),  # noqa: NPY002 - the state that all code of a process shares
        }
        Path(self.options.found).write_text(json.dumps(state))


def _mode(descriptor: Path) -> int:
    """0 for the descriptor by which the folder was listed."""
    try:
        return descriptor.stat().st_mode
    except OSError:
        return 0
