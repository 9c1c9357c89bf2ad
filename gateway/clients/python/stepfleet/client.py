"""The connection."""

from __future__ import annotations

import base64
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any

import zenoh

from .commands import Command
from .errors import NoGateway, Refused, TimedOut
from .records import Arrangement, JobRecord, JobState, NodeRecord, Receipt

# Largest text of a job.
_JOB_BYTES_MAX = 64 << 20


def _read_secret(path: Path) -> str:
    """Reads a file that nobody but its owner may read: the file that is open, not its name."""
    with path.open(encoding="utf-8") as file:
        mode = os.fstat(file.fileno()).st_mode & 0o777
        if os.name == "posix" and mode & 0o077:
            raise PermissionError(
                f"{path} may be read by others than its owner (mode {mode:03o}); chmod 600"
            )
        return file.read()


class Fleet:
    """A connection to a fleet; use it in a `with`.

    `connect` is the gateway's or a router's address. `credentials` is the file that `fleet users` made:
    where to connect, as whom, and whom to trust. `timeout` is the longest wait for an answer, s.
    """

    def __init__(
        self,
        connect: str | None = None,
        *,
        prefix: str = "fleet",
        credentials: str | Path | None = None,
        timeout: float = 10.0,
    ) -> None:
        self._prefix = prefix
        self._timeout = timeout
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("scouting/multicast/enabled", "false")
        if credentials is not None:
            known = json.loads(_read_secret(Path(credentials)))
            connect = connect or next(iter(known.get("connect", [])), None)
            login = "transport/auth/usrpwd"
            config.insert_json5(f"{login}/user", json.dumps(known["user"]))
            config.insert_json5(f"{login}/password", json.dumps(known["password"]))
            if known.get("ca"):
                ca = base64.b64encode(known["ca"].encode()).decode()
                key = "transport/link/tls/root_ca_certificate_base64"
                config.insert_json5(key, json.dumps(ca))
        endpoint = connect or "tcp/127.0.0.1:7447"
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise NoGateway(f"cannot connect to {endpoint}: {error}") from error

    def __enter__(self) -> Fleet:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends the connection."""
        self._session.close()  # type: ignore[no-untyped-call]

    # ── jobs ──

    def submit(
        self,
        node: str,
        commands: Sequence[Command] | None = None,
        *,
        lua: str | None = None,
        gcode: str | None = None,
        id: str | None = None,
        priority: int | None = None,
        when_idle: bool = False,
        not_before: datetime | None = None,
        timeout_s: float | None = None,
        or_refuse: bool = False,
    ) -> Receipt:
        """Hands in a job for one node: commands, a Lua script, or G-code.

        `id` makes it idempotent. `timeout_s` limits it from its first command to its last pulse;
        `or_refuse` refuses it when the node is away. Neither is there for G-code.
        """
        receipts = self._submit(
            f"node/{node}/job",
            commands,
            lua,
            gcode,
            id,
            _wishes(priority, when_idle, not_before),
            timeout_s,
            or_refuse,
        )
        if len(receipts) != 1:
            raise ValueError(f"{node}: submit_each is for patterns")
        return receipts[0]

    def submit_each(
        self,
        pattern: str,
        commands: Sequence[Command] | None = None,
        *,
        lua: str | None = None,
        id: str | None = None,
        priority: int | None = None,
        when_idle: bool = False,
        not_before: datetime | None = None,
        timeout_s: float | None = None,
    ) -> list[Receipt]:
        """A job for each node that is alive and matches (`*`, `cell-$*`), or has the label (`@mill`)."""
        key = f"node/{pattern}/job"
        if pattern.startswith("@"):
            key = f"manage/label/{pattern[1:]}/job"
        wishes = _wishes(priority, when_idle, not_before)
        return self._submit(key, commands, lua, None, id, wishes, timeout_s, False)

    def submit_together(
        self,
        parts: Mapping[str, Sequence[Command] | str],
        *,
        id: str | None = None,
        group: str = "python",
        max_skew_us: float | None = None,
        ready_timeout_ms: float | None = None,
        timeout_s: float | None = None,
    ) -> Receipt:
        """A synchronized job: commands or a script for each node, started at one instant."""
        nodes = {
            node: {"lua": part} if isinstance(part, str) else {"commands": list(part)}
            for node, part in parts.items()
        }
        job: dict[str, Any] = {"nodes": nodes}
        limits = {
            "id": id,
            "max_skew_us": max_skew_us,
            "ready_timeout_ms": ready_timeout_ms,
            "timeout_s": timeout_s,
        }
        job.update({name: value for name, value in limits.items() if value is not None})
        answer = self._one(f"group/{group}/job", json.dumps(job))
        return Receipt(answer["job"], answer["state"])

    def job(self, id: str) -> JobRecord:
        """The record of a job."""
        return JobRecord.from_json(self._one(f"job/{id}"))

    def jobs(
        self, *, limit: int = 100, state: JobState | None = None, node: str | None = None
    ) -> list[JobRecord]:
        """Records, newest first."""
        selector = f"job/*?limit={limit}"
        if state is not None:
            selector += f";state={state}"
        if node is not None:
            selector += f";node={node}"
        return [JobRecord.from_json(raw) for raw in self._get(selector)]

    def follow(self, id: str, timeout: float | None = None) -> Iterator[JobRecord]:
        """Each record of a job as it changes, the final one last.

        Raises TimedOut when `timeout` seconds are over before that.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._session.declare_subscriber(f"{self._prefix}/job/{id}") as changes:
            record = self.job(id)
            yield record
            while not record.is_final:
                if deadline is not None and time.monotonic() >= deadline:
                    raise TimedOut(f"{id} is {record.state}")
                change = changes.try_recv()
                if change is None:
                    # Short, because this receive cannot be told how long to wait.
                    time.sleep(0.02)
                    continue
                newer = JobRecord.from_json(json.loads(change.payload.to_string()))
                if newer.version > record.version:
                    record = newer
                    yield record

    def wait(self, id: str, timeout: float | None = None) -> JobRecord:
        """Waits until a job has ended, however it does."""
        record = None
        for record in self.follow(id, timeout):
            pass
        assert record is not None, "follow gives one record at least"
        return record

    def cancel(self, id: str) -> JobRecord:
        """Cancels a job; one that runs comes to rest by its ramps and is `canceled` then."""
        return JobRecord.from_json(self._one(f"job/{id}/cancel"))

    def move(
        self, id: str, *, before: str | None = None, priority: int | None = None
    ) -> Mapping[str, Any]:
        """Puts a job that waits before another one, or gives it a priority. Returns its story."""
        wishes = {"before": before, "priority": priority}
        given = {name: value for name, value in wishes.items() if value is not None}
        return self._one(f"manage/job/{id}", json.dumps(given))

    def trace(self, id: str) -> list[tuple[datetime, JobState]]:
        """When a job came into which state."""
        steps = self._one(f"manage/job/{id}")["steps"]
        return [(datetime.fromisoformat(at.replace("Z", "+00:00")), state) for at, state in steps]

    # ── nodes ──

    def nodes(self, pattern: str = "*") -> list[NodeRecord]:
        """Records of the nodes that match."""
        records = [NodeRecord.from_json(raw) for raw in self._get(f"node/{pattern}/state")]
        return sorted(records, key=lambda record: record.node)

    def stop(self, pattern: str = "*", *, decelerate: bool = False) -> None:
        """Tells nodes to stop. It is a stop by software over a network: look at `nodes` whether they
        have. `pattern` is a name or has `*` or `$*` in it, as everywhere."""
        if "/" in pattern or "**" in pattern:
            # The router of a secured fleet drops such a key without a word.
            raise ValueError(f"{pattern}: one name, `*` for all nodes, or `$*` for a part of it")
        mode = "decelerate" if decelerate else "halt"
        self._session.put(
            f"{self._prefix}/node/{pattern}/stop",
            json.dumps({"mode": mode}),
            encoding=zenoh.Encoding.APPLICATION_JSON,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )

    def release(self, pattern: str) -> list[NodeRecord]:
        """Lifts the latch of nodes that were stopped."""
        return [NodeRecord.from_json(raw) for raw in self._get(f"node/{pattern}/release")]

    def arrangement(self, pattern: str = "*") -> list[Arrangement]:
        """Labels, maintenance and queue of nodes."""
        return self._arrange(pattern, {})

    def label(
        self, pattern: str, add: Sequence[str] = (), *, remove: Sequence[str] = ()
    ) -> list[Arrangement]:
        """Gives labels to nodes and takes others away."""
        return self._arrange(pattern, {"label": list(add), "unlabel": list(remove)})

    def maintenance(self, pattern: str, reason: str | None) -> list[Arrangement]:
        """Lets nodes take no jobs, for this reason; with None they take jobs again."""
        wish = False if reason is None else {"reason": reason}
        return self._arrange(pattern, {"maintenance": wish})

    # ── below ──

    def _arrange(self, pattern: str, wishes: Mapping[str, Any]) -> list[Arrangement]:
        answers = self._get(f"manage/node/{pattern}", json.dumps(wishes))
        return [Arrangement.from_json(raw) for raw in answers]

    def _submit(
        self,
        key: str,
        commands: Sequence[Command] | None,
        lua: str | None,
        gcode: str | None,
        id: str | None,
        wishes: str | None,
        timeout_s: float | None,
        or_refuse: bool,
    ) -> list[Receipt]:
        if sum(work is not None for work in (commands, lua, gcode)) != 1:
            raise ValueError("a job has commands, or lua, or gcode")
        if gcode is not None:
            if timeout_s is not None or or_refuse:
                raise ValueError("G-code has neither timeout_s nor or_refuse")
            encoding = zenoh.Encoding("text/x-gcode")
            if id is not None:
                encoding = encoding.with_schema(f"id={id}")
            answers = self._get(key, gcode, encoding, wishes)
        else:
            job: dict[str, Any] = {"lua": lua} if lua is not None else {"commands": commands}
            if id is not None:
                job["id"] = id
            if timeout_s is not None:
                job["timeout_s"] = timeout_s
            if or_refuse:
                job["offline"] = "reject"
            answers = self._get(key, json.dumps(job), None, wishes)
        return [Receipt(answer["job"], answer["state"]) for answer in answers]

    def _one(self, selector: str, payload: str | None = None) -> Mapping[str, Any]:
        answers = self._get(selector, payload)
        if len(answers) != 1:
            raise NoGateway(f"{selector}: {len(answers)} answers")
        return answers[0]

    def _get(
        self,
        selector: str,
        payload: str | None = None,
        encoding: zenoh.Encoding | None = None,
        attachment: str | None = None,
    ) -> list[Mapping[str, Any]]:
        # The router would drop what is much larger without a word.
        if payload is not None and len(payload.encode()) > _JOB_BYTES_MAX:
            raise Refused("too_large", f"more than {_JOB_BYTES_MAX} bytes: split it")
        replies = self._session.get(
            f"{self._prefix}/{selector}",
            payload=payload,
            encoding=(encoding or zenoh.Encoding.APPLICATION_JSON) if payload is not None else None,
            attachment=attachment,
            # The order of replies is the gateway's.
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=self._timeout,
        )
        answers = []
        for reply in replies:
            if reply.ok is not None:
                answers.append(json.loads(reply.ok.payload.to_string()))
                continue
            text = reply.err.payload.to_string() if reply.err is not None else ""
            try:
                error = json.loads(text)["error"]
            except (ValueError, KeyError, TypeError):
                raise NoGateway(f"no answer within {self._timeout} s") from None
            raise Refused(error["code"], error["message"])
        # A gateway answers for each job, if only that there is none.
        if not answers and not selector.startswith("job/gateway"):
            try:
                self._get("job/gateway")
            except Refused:
                return answers
            raise NoGateway(f"nobody serves the prefix `{self._prefix}`")
        return answers


def _wishes(priority: int | None, when_idle: bool, not_before: datetime | None) -> str | None:
    wishes: dict[str, Any] = {}
    if priority is not None:
        wishes["priority"] = priority
    if when_idle:
        wishes["when_idle"] = True
    if not_before is not None:
        at = not_before.astimezone(timezone.utc)
        wishes["not_before"] = at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return json.dumps(wishes) if wishes else None
