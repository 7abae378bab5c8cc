"""The options of `compare` that need more than one line."""

from __future__ import annotations

from typing import Annotated

import typer

from gridtrack.cli.completion import complete_degradation, complete_engine, complete_row, complete_slurm
from gridtrack.cli.options import fetch_recordings, fetch_row_weights

RowsOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[LABEL=]NAME[:KEY=VALUE,...]",
        help="Repeat; default: every tracker",
        autocompletion=complete_row,
        callback=fetch_row_weights,
    ),
]
ValidationOption = Annotated[
    str | None,
    typer.Option(
        help=r"RECORDING\[@RANGE] to choose thresholds on; default: the recording's own", callback=fetch_recordings
    ),
]
ReferenceOption = Annotated[
    str | None, typer.Option(metavar="LABEL", help="The row that the others are compared with; default: persistence")
]
SegmentOption = Annotated[
    str | None,
    typer.Option(help="Cut longer test stretches into segments of at most this length, each a trial of its own"),
]
WarmUpOption = Annotated[
    str | None, typer.Option(help="Before a segment, what is delivered and not scored; the first one has 20 frames")
]
AllowLeakOption = Annotated[
    bool, typer.Option(help="Score a tracker on frames that it learned from too: it is marked and not ranked")
]
DeadlineOption = Annotated[
    bool, typer.Option(help="After the scores, measure the time of each tracker alone and score under a deadline")
]
DegradeOption = Annotated[
    str | None,
    typer.Option(
        metavar="KIND=VALUE,...",
        help="After the scores, score on degraded frames, one kind at a time",
        autocompletion=complete_degradation,
    ),
]
FollowOption = Annotated[
    bool,
    typer.Option("--follow", help="The recording, an MCAP file, is still being written: keep up with it to its end"),
]
IdleTimeoutOption = Annotated[
    str | None, typer.Option(help="With --follow, end when nothing was written for this long")
]
EngineOption = Annotated[
    str | None,
    typer.Option(
        metavar="ENGINE",
        help="What runs the trials: local, or the nodes of a cluster: ray or slurm",
        autocompletion=complete_engine,
    ),
]
AddressOption = Annotated[
    str | None, typer.Option(help="Of the Ray cluster; default: the one that this machine belongs to")
]
SlurmOption = Annotated[
    str | None,
    typer.Option(
        metavar="KEY=VALUE,...",
        help="What a trial asks of Slurm: partition, account, timeout_min, mem_gb; default: only --threads cores",
        autocompletion=complete_slurm,
    ),
]
