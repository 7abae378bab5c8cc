"""CARMEN logs (`.clf`, `.log`, also packed by gzip or bzip2): FLASER and ROBOTLASER1 lines with poses of the laser.

Format: http://carmen.sourceforge.net/doc/logger_file_format.html
"""

from __future__ import annotations

import bz2
import gzip
import math
import re
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import name_from
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.file_reading import DamageError, ReadBudget
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.recordings.registry import RecordingFormat

CARMEN_SUFFIXES = tuple(f"{name}{packed}" for name in (".clf", ".log") for packed in ("", ".bz2", ".gz"))
PACKED: dict[bytes, Callable[[BinaryIO], AbstractContextManager[BinaryIO]]] = {
    b"BZh": bz2.BZ2File,  # type: ignore[dict-item]
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),  # type: ignore[dict-item,return-value]
}
"""Readers of packed logs by the first bytes of the file."""
FIRST_LINE = re.compile(rb"\s*(#|[A-Z][A-Z0-9_]*\s)")
"""A log begins with a comment or the name of a message."""
MAX_LINE_BYTES = 1 << 20
MAX_STAMP_DIGITS, NO_STAMP = 12, -1
SICK_RANGE_MAX_M = 81.8
"""A SICK LMS reports 81.83 m or more for a beam without a return; its true maximum range is shorter."""
ANGLES_DEG = {
    **dict.fromkeys((180, 181), (-90.0, 1.0)),
    **dict.fromkeys((360, 361), (-90.0, 0.5)),
    **dict.fromkeys((400, 401), (-50.0, 0.25)),
    **dict.fromkeys((540, 541), (-135.0, 0.5)),
    **dict.fromkeys((1080, 1081), (-135.0, 0.25)),
}
"""First angle and step between beams, degrees, by the number of beams: FLASER lines do not contain them.

Up to 401 beams: SICK LMS 2xx, possibly without the last beam, as in CARMEN's carmen_laser_guess_fov. 540 beams and
more: SICK LMS 1xx and Hokuyo UTM-30LX.
"""


class CarmenLog(Recording):
    """A CARMEN log. FLASER and ROBOTLASER1 are two forms of the same scan: the first one in the file is read."""

    _logger_differs = False
    """Whether the logger gave the scans different times."""

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata of the recording: its file name as `site`, and the source of its poses."""
        return RecordingInfo(site=name_from(self.path), poses="of the laser, in each line with a scan")

    def read(self, topics: Topics) -> Iterator[Scan]:
        """As in every recording."""
        if self.options.stamps == "end":
            raise RecordingError("--stamps end: a CARMEN log has no time between beams: leave it out")
        wanted, read, first_logged = self.options.topic, -1, ""
        for number, words in _lines(self.path):
            kind = words[0]
            topics.add(kind, "CARMEN", kind in ("FLASER", "ROBOTLASER1"))
            wanted = wanted or (kind if kind in topics.scans else None)
            if self.options.topic is None and len(topics.scans) > 1:
                self.warn(f"has FLASER and ROBOTLASER1; {wanted} is read: name the other as topic to read it instead")
            if kind == wanted and kind in topics.scans:
                scan = self._scan(kind, words, number)
                if kind == "FLASER" and scan.ranges.size not in ANGLES_DEG:
                    self.notify(
                        "FLASER lines do not contain the angles of their beams, and no known laser has"
                        f" {scan.ranges.size} beams: 180 deg are assumed, as in CARMEN; if that is wrong, use"
                        " ROBOTLASER1 lines, which contain the angles"
                    )
                first_logged = first_logged or words[-1]
                self._logger_differs |= words[-1] != first_logged
                yield self._stamped(scan, words[-1], read := read + 1)

    @property
    def stamp_remedy(self) -> str:
        """As in every recording."""
        remedy = f"give the rate of the laser, as in `{self.import_command(['--stamps', '10hz'])}`"
        return f"{remedy}, or take the logger's times with --stamps received" if self._logger_differs else remedy

    def _stamped(self, scan: Scan, logger_time: str, number: int) -> Scan:
        """Scan `number` with the stamp that the options name."""
        source = self.options.stamps
        if isinstance(source, float):
            return replace(scan, stamp_ns=round(number * 1e9 / source))
        return replace(scan, stamp_ns=_stamp_ns(logger_time)) if source == "received" else scan

    def _scan(self, kind: str, words: list[str], line: int) -> Scan:
        try:
            with np.errstate(over="ignore"):  # a range beyond float32 becomes infinite: no return
                return _flaser(words) if kind == "FLASER" else _robotlaser(words)
        except (ValueError, IndexError) as error:
            raise DamageError(f"line {line}: not a readable {kind} ({error})") from None


def is_carmen_log(path: Path, head: bytes) -> bool:
    """Whether the file has the name of a CARMEN log, and begins as one if it is not packed."""
    if not path.name.lower().endswith(CARMEN_SUFFIXES) or path.is_dir():
        return False
    return head.startswith(tuple(PACKED)) or FIRST_LINE.match(head) is not None


CARMEN_FORMAT = RecordingFormat("CARMEN log", CARMEN_SUFFIXES, is_carmen_log, CarmenLog, ("topic", "stamps"))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line, without comments and empty lines. Raises DamageError."""
    with path.open("rb") as raw:
        head, budget = raw.read(max(map(len, PACKED))), ReadBudget()
        raw.seek(0)
        unpack = next((found for magic, found in PACKED.items() if head.startswith(magic)), nullcontext)
        with unpack(raw) as file:
            number = 0
            try:
                while line := file.readline(MAX_LINE_BYTES):
                    number += 1
                    if file is not raw:
                        budget.take_bytes(len(line), raw.tell())
                        budget.take_record(raw.tell())
                    if len(line) == MAX_LINE_BYTES:
                        raise DamageError(f"line {number} is longer than {MAX_LINE_BYTES} bytes")
                    words = line.decode("latin-1").split()  # names of hosts and comments in any encoding
                    if words and not words[0].startswith("#"):
                        yield number, words
            except (EOFError, OSError, zlib.error) as error:
                raise DamageError(f"damaged after line {number} ({error})") from None


def _flaser(words: list[str]) -> Scan:
    """FLASER n r_1..r_n x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp."""
    beams = int(words[1])
    ranges, rest = words[2 : 2 + beams], words[2 + beams :]
    if beams < 2 or len(rest) != 9:
        raise ValueError(f"{len(words)} words for {beams} beams")
    first_deg, step_deg = ANGLES_DEG.get(beams, (-90.0, 180.0 / (beams - 1)))
    return Scan(
        stamp_ns=_stamp_ns(rest[6]),
        ranges=np.array(ranges, np.float32),
        angle_min=math.radians(first_deg),
        angle_increment=math.radians(step_deg),
        range_min=0.0,
        range_max=SICK_RANGE_MAX_M,
        sensor="scan",
        world_T_sensor=SE2(*(float(word) for word in rest[:3])),
    )


def _robotlaser(words: list[str]) -> Scan:
    """ROBOTLASER1 type start fov step range_max accuracy mode n r_1..r_n m i_1..i_m x y theta ... stamp host stamp."""
    beams = int(words[8])
    ranges, rest = words[9 : 9 + beams], words[9 + beams :]
    remissions = int(rest[0])
    tail = rest[1 + remissions :]
    if len(ranges) != beams or len(tail) != 14:
        raise ValueError(f"{len(words)} words for {beams} beams and {remissions} remissions")
    return Scan(
        stamp_ns=_stamp_ns(tail[11]),
        ranges=np.array(ranges, np.float32),
        angle_min=float(words[2]),
        angle_increment=float(words[4]),
        range_min=0.0,
        range_max=float(words[5]),
        sensor="scan",
        last_angle=float(words[2]) + float(words[3]),
        world_T_sensor=SE2(*(float(word) for word in tail[:3])),
    )


def _stamp_ns(seconds: str) -> int:
    """Seconds, also with an exponent, as C++ streams write them; exact where decimals are.

    NO_STAMP for a text that is no time: StampOrder leaves that scan out, and the log goes on.
    """
    try:
        stamp = Decimal(seconds)
    except InvalidOperation:
        return NO_STAMP
    if not stamp.is_finite() or stamp < 0 or stamp.adjusted() > MAX_STAMP_DIGITS:
        return NO_STAMP
    return int(stamp * 1_000_000_000)
