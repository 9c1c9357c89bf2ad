"""What the gateway says. Fields that this version does not know are in `raw`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, TypeAlias

JobState: TypeAlias = Literal[
    "queued",
    "sent",
    "running",
    "succeeded",
    "failed",
    "canceled",
    "timed_out",
    "rejected",
    "lost",
]
NodeState: TypeAlias = Literal[
    "offline", "idle", "ready", "running", "paused", "stopped", "fault"
]

FINAL = frozenset({"succeeded", "failed", "canceled", "timed_out", "rejected"})


def _time(text: str) -> datetime:
    return datetime.fromisoformat(text.replace("Z", "+00:00"))


@dataclass(frozen=True)
class Receipt:
    """A job was taken; or it was there already."""

    job: str
    state: JobState


@dataclass(frozen=True)
class Error:
    """Why a job ended early."""

    code: str
    message: str


@dataclass(frozen=True)
class Progress:
    """Commands that have ended, of all."""

    done: int
    total: int


@dataclass(frozen=True)
class Result:
    """Where a job left the axes, steps, and what its script returned."""

    position: tuple[int, ...]
    returned: Any = None


@dataclass(frozen=True)
class Start:
    """How far apart the nodes of a synchronized job began, µs, as they measured it."""

    skew_us: float
    uncertainty_us: float
    by_node_us: Mapping[str, float]


@dataclass(frozen=True)
class JobRecord:
    """A job as the gateway knows it."""

    job: str
    node: str | None
    group: str | None
    state: JobState
    created: datetime
    updated: datetime
    progress: Progress
    version: int
    error: Error | None
    result: Result | None
    start: Start | None
    raw: Mapping[str, Any] = field(repr=False)

    @property
    def is_final(self) -> bool:
        """Whether nothing more will happen to it."""
        return self.state in FINAL

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> JobRecord:
        """Reads a record."""
        error, result, start = raw.get("error"), raw.get("result"), raw.get("start")
        return cls(
            job=raw["job"],
            node=raw.get("node"),
            group=raw.get("group"),
            state=raw["state"],
            created=_time(raw["created"]),
            updated=_time(raw["updated"]),
            progress=Progress(raw["progress"]["done"], raw["progress"]["total"]),
            version=raw["version"],
            error=Error(error["code"], error["message"]) if error else None,
            result=Result(tuple(result["position"]), result.get("returned")) if result else None,
            start=(
                Start(start["skew_us"], start["uncertainty_us"], start["by_node_us"])
                if start
                else None
            ),
            raw=raw,
        )


@dataclass(frozen=True)
class NodeRecord:
    """A node as the gateway knows it."""

    node: str
    alive: bool
    state: NodeState
    position: tuple[int, ...]
    job: str | None
    stopped: str | None
    raw: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> NodeRecord:
        """Reads a record."""
        stopped = raw.get("stopped")
        return cls(
            node=raw["node"],
            alive=raw["alive"],
            state=raw["state"],
            position=tuple(raw["position"]),
            job=raw.get("job"),
            stopped=stopped["reason"] if stopped else None,
            raw=raw,
        )


@dataclass(frozen=True)
class Arrangement:
    """How a node is arranged: its labels, why it takes no jobs, which jobs wait and in which order."""

    node: str
    labels: frozenset[str]
    maintenance: str | None
    waiting: tuple[str, ...]

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Arrangement:
        """Reads an answer."""
        return cls(
            node=raw["node"],
            labels=frozenset(raw["labels"]),
            maintenance=raw["maintenance"],
            waiting=tuple(raw["waiting"]),
        )
