"""Hand jobs to a fleet of stepper controllers and follow them: a thin, typed layer over zenoh.

    Fleet     a connection: submit, wait, jobs, nodes, stop, release, labels
    records   what comes back: JobRecord, NodeRecord, …
    commands  what a job is made of: move, ramp, line, …
"""

from .client import Fleet
from .commands import (
    Command,
    barrier,
    home,
    laser,
    lidar_read,
    line,
    move,
    pause,
    ramp,
    ramp_to,
    set_position,
    smooth_ramp,
    smooth_ramp_to,
    sync_move,
)
from .errors import FleetError, NoGateway, Refused, TimedOut
from .records import Arrangement, Error, JobRecord, NodeRecord, Progress, Receipt, Result, Start

__all__ = [
    "Arrangement",
    "Command",
    "Error",
    "Fleet",
    "FleetError",
    "JobRecord",
    "NoGateway",
    "NodeRecord",
    "Progress",
    "Receipt",
    "Refused",
    "Result",
    "Start",
    "TimedOut",
    "barrier",
    "home",
    "laser",
    "lidar_read",
    "line",
    "move",
    "pause",
    "ramp",
    "ramp_to",
    "set_position",
    "smooth_ramp",
    "smooth_ramp_to",
    "sync_move",
]
