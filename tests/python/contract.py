"""What any zenoh client may rely on, asked for by one that shares no code with the product.

Every test is one sentence of the contract. The pins are not believed from records: the fixture on
the other side of `--control` counts pulses for itself and lets nodes come, go and lose their power.

    cargo test -p tests --test python_client                    the whole of it
    CONTRACT="Stop Ids" cargo test -p tests --test python_client       two classes

Nothing waits for a time to pass: every wait is for a message or an answer, up to PATIENCE_S. And
nothing depends on how busy the machine is: what a node says may come late and in fewer words (the
last one counts), so a state that passes may go unheard; a put that must arrive is sent so that
zenoh drops nothing; work that has to last until something else has happened lasts for ever.
"""

import argparse
import collections
import contextlib
import datetime
import itertools
import json
import re
import socket
import sys
import threading
import time
import unittest

import zenoh

PATIENCE_S = 60

# Longer than any test: what lasts so long is ended by the test.
FOREVER_S = 3_600

JSON = zenoh.Encoding.APPLICATION_JSON
LUA = zenoh.Encoding("text/x-lua")
POSTCARD = zenoh.Encoding.APPLICATION_OCTET_STREAM.with_schema("postcard")

NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}\Z")
TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z\Z")

FINAL = {"succeeded", "failed", "canceled", "timed_out", "rejected"}
STATES = FINAL | {"queued", "sent", "running", "lost"}
CODES = {
    "bad_json",
    "bad_command",
    "unknown_node",
    "node_offline",
    "stopped",
    "too_large",
    "bad_id",
    "not_allowed",
    "internal",
}
# What may follow what. A rejected id was never a job: a better job may have it.
NEXT = {
    "queued": {"sent", "failed", "canceled"},
    "sent": {"sent", "running", "lost"} | FINAL - {"rejected"},
    "running": {"running", "lost"} | FINAL - {"rejected"},
    "lost": {"sent", "running"} | FINAL - {"rejected"},
    "rejected": {"rejected", "queued"},
    "succeeded": set(),
    "failed": set(),
    "canceled": set(),
    "timed_out": set(),
}
JOB_FIELDS = {
    "job",
    "node",
    "group",
    "state",
    "version",
    "created",
    "updated",
    "progress",
    "error",
    "result",
    "parts",
}
NODE_FIELDS = {
    "node",
    "alive",
    "state",
    "position",
    "queue",
    "job",
    "stopped",
    "clock",
    "firmware",
    "uptime_s",
    "rssi_dbm",
    "faults",
}
NODE_STATES = {"offline", "idle", "ready", "running", "paused", "stopped", "fault"}


class Refused(Exception):
    """An error reply."""

    def __init__(self, code, message):
        super().__init__(f"{code}: {message}")
        self.code = code
        self.message = message


class Fixture:
    """What the test bench can do and no client can."""

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.link = socket.create_connection((host, int(port)), PATIENCE_S)
        self.lines = self.link.makefile("rw", encoding="utf-8", newline="\n")

    def __call__(self, *words):
        self.lines.write(" ".join(str(word) for word in words) + "\n")
        self.lines.flush()
        verdict, _, rest = self.lines.readline().rstrip("\n").partition(" ")
        if verdict != "ok":
            raise RuntimeError(rest or "the fixture is gone")
        return rest

    def pulses(self, node, axis=0):
        """Pulses forward minus pulses backward that have left the pin."""
        return int(self("pulses", node, axis))


def settle(session):
    """Waits until the router has taken what was declared so far: it answers what is asked after it.

    Whoever speaks on another link is not heard before.
    """
    for _ in session.liveliness().get("nobody/knows", timeout=PATIENCE_S):
        pass


class Heard:
    """Everything that was put on some keys, in the order in which it came."""

    def __init__(self, session, key, read):
        self.condition = threading.Condition()
        self.samples = []
        self.by_key = collections.defaultdict(list)
        self.read = read
        self.subscriber = session.declare_subscriber(key, self.take)

    def take(self, sample):
        at = time.monotonic()
        value = self.read(sample)
        with self.condition:
            key = str(sample.key_expr)
            heard = (at, key, str(sample.encoding), value)
            self.samples.append(heard)
            self.by_key[key].append(heard)
            self.condition.notify_all()

    def all(self):
        with self.condition:
            return list(self.samples)

    def of(self, key):
        """Returns what was put on one key."""
        with self.condition:
            return list(self.by_key[key])

    def wait(self, what, find, key=None):
        """Returns the first thing that `find` finds in the list of samples, or in that of a key."""
        with self.condition:
            samples = self.samples if key is None else self.by_key[key]
            found = self.condition.wait_for(lambda: find(samples), PATIENCE_S)
            if not found:
                raise AssertionError(f"not heard: {what}; the last were {samples[-5:]}")
            return found

    def end(self):
        self.subscriber.undeclare()


def read_json(sample):
    return json.loads(sample.payload.to_bytes().decode("utf-8"))


def read_bytes(sample):
    return sample.payload.to_bytes()


class World:
    """The fleet under test and one session with it."""

    def __init__(self, locator, control):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([locator]))
        config.insert_json5("scouting/multicast/enabled", "false")
        # A busy machine is not to be taken for a dead peer.
        config.insert_json5("transport/unicast/open_timeout", str(PATIENCE_S * 1_000))
        config.insert_json5("transport/link/tx/lease", str(PATIENCE_S * 1_000))
        queue = "transport/link/tx/queue/congestion_control"
        config.insert_json5(f"{queue}/block/wait_before_close", str(PATIENCE_S * 1_000_000))
        self.session = zenoh.open(config)
        self.fixture = Fixture(control)
        self.jobs = Heard(self.session, "fleet/job/*", read_json)
        self.nodes = Heard(self.session, "fleet/node/*/state", read_json)
        settle(self.session)
        self.numbers = itertools.count(1)
        # Keys of jobs that went on while this session was without a router.
        self.unheard = set()

    def end(self):
        self.session.close()


world: World


def get(selector, payload=None, encoding=None, **options):
    """Returns keys and values of all replies; the first error reply is raised.

    TimeoutError: zenoh's own word that no answer came in time.
    """
    options.setdefault("consolidation", zenoh.ConsolidationMode.NONE)
    options.setdefault("timeout", PATIENCE_S)
    answers = []
    for reply in world.session.get(selector, payload=payload, encoding=encoding, **options):
        if reply.err is not None:
            if str(reply.err.encoding) != "application/json":
                raise TimeoutError(selector)
            error = read_json(reply.err)
            assert set(error) == {"error"}, error
            assert set(error["error"]) == {"code", "message"}, error
            assert error["error"]["code"] in CODES, error
            assert error["error"]["message"], error
            raise Refused(error["error"]["code"], error["error"]["message"])
        assert str(reply.ok.encoding) == "application/json", reply.ok.encoding
        answers.append((str(reply.ok.key_expr), read_json(reply.ok)))
    return answers


def get_one(selector, payload=None, encoding=None, **options):
    answers = get(selector, payload, encoding, **options)
    assert len(answers) == 1, (selector, answers)
    return answers[0][1]


def put(key, payload=b"", encoding=None):
    block = zenoh.CongestionControl.BLOCK
    world.session.put(key, payload, encoding=encoding, congestion_control=block)


def move(steps, delay_us=200, axis=0):
    return {"move": {"axis": axis, "delay_us": delay_us, "steps": steps}}


def lasting(seconds, axis=0):
    """A move that takes so long, there or, with a time below 0, back."""
    return move(round(seconds * 1e6 / 500), 500, axis)


def ramp(steps, speed_hz=5_000, accel=50_000, axis=0, **shape):
    fields = {"axis": axis, "steps": steps, "speed_hz": speed_hz, "accel": accel, **shape}
    return {"ramp": fields}


def ramp_to(position, speed_hz=5_000, accel=50_000, axis=0, **shape):
    fields = {"axis": axis, "position": position, "speed_hz": speed_hz, "accel": accel, **shape}
    return {"ramp_to": fields}


def line(*steps, speed_hz=5_000, accel=50_000, **jerk):
    return {"line": {"steps": list(steps), "speed_hz": speed_hz, "accel": accel, **jerk}}


def set_position(position, axis=0):
    return {"set_position": {"axis": axis, "position": position}}


# Every shape that a ramp can have.
SHAPES = [
    {},
    {"linear_steps": 0, "jump_steps": 0},
    {"linear_steps": 50},
    {"jump_steps": 20},
    {"linear_steps": 50, "jump_steps": 20},
    {"linear_steps": 65_535, "jump_steps": 65_535},
    {"jerk": 2_000_000},
    {"jerk": 2_000_000, "linear_steps": 0, "jump_steps": 0},
    {"jerk": None, "linear_steps": 50},
]


def a_job(*commands, **fields):
    return {"commands": list(commands or [move(10)]), **fields}


def submit(node, job):
    """Hands in a job and returns the receipt."""
    return get_one(f"fleet/node/{node}/job", json.dumps(job), JSON)


def put_job(node, job):
    put(f"fleet/node/{node}/job", json.dumps(job), JSON)


def fresh(word="job"):
    """A name that nobody has used."""
    return f"{word}-{next(world.numbers)}"


def record(job):
    return get_one(f"fleet/job/{job}")


def records_of(job):
    """Every record of a job that was put so far."""
    return [value for _, _, _, value in world.jobs.of(f"fleet/job/{job}")]


def job_until(job, *states):
    """Waits until a record in one of these states has been put, and returns it."""

    def find(samples):
        for _, _, _, value in samples:
            if value["state"] in states:
                return value
            # A rejected id is free for a better job.
            over = value["state"] in FINAL - {"rejected"}
            assert not over, f"{job} was to be {states}: {value}"
        return None

    return world.jobs.wait(f"{job} {states}", find, f"fleet/job/{job}")


def ended(job):
    return job_until(job, *FINAL)


def node_record(node):
    return get_one(f"fleet/node/{node}/state")


def node_until(node, what, holds):
    """Asks for a node's record until something holds of it."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        found = node_record(node)
        if holds(found):
            return found
        assert time.monotonic() < deadline, f"{node} is never {what}: {found}"


def node_in(node, *states):
    return node_until(node, states, lambda found: found["state"] in states)


def up(node, *axes):
    """Switches a node on, and waits until the gateway knows it."""
    # A name that is being seen for the first time is unknown at first.
    world.fixture("up", node, *axes)
    deadline = time.monotonic() + PATIENCE_S
    while True:
        with contextlib.suppress(Refused):
            if node_record(node)["alive"]:
                return node
        assert time.monotonic() < deadline, f"{node} does not come"


def down(node):
    """Switches a node off, and waits until the gateway knows that.

    A node that is gone and not yet missed would still be given jobs on wild keys.
    """
    world.fixture("down", node)
    node_in(node, "offline")


def release(node):
    """Releases a node and returns the answer.

    The gateway gives a release up after a while, and a busy machine is no pressed button: so again.
    """
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            return get_one(f"fleet/node/{node}/release")
        except Refused as refusal:
            assert refusal.code == "not_allowed" and time.monotonic() < deadline, refusal


def utc(text):
    assert TIME.match(text), text
    return datetime.datetime.fromisoformat(text.replace("Z", "+00:00"))


class Case(unittest.TestCase):
    maxDiff = None

    def new_node(self, word="n", *axes):
        """A node of this test alone, gone when it ends."""
        name = fresh(word)
        up(name, *axes)
        self.addCleanup(self.switch_off, name)
        return name

    def switch_off(self, name):
        # A test that failed on the way may have switched it off.
        with contextlib.suppress(RuntimeError):
            down(name)

    def refused(self, code, node, job, *places):
        """A get with this job is refused with this code, and the message names these places."""
        payload = job if isinstance(job, (bytes, str)) else json.dumps(job)
        with self.assertRaises(Refused, msg=payload[:300]) as caught:
            get(f"fleet/node/{node}/job", payload, JSON)
        self.assertEqual(caught.exception.code, code, (payload[:300], caught.exception))
        for place in places:
            self.assertIn(place, caught.exception.message, payload[:300])
        return caught.exception

    def finished(self, job, state="succeeded"):
        found = ended(job)
        self.assertEqual(found["state"], state, found)
        return found


class Encodings(Case):
    """The encoding says what the payload is."""

    @classmethod
    def setUpClass(cls):
        cls.node = up(fresh("enc"))

    @classmethod
    def tearDownClass(cls):
        down(cls.node)

    def test_a_job_in_json_is_answered_with_a_receipt(self):
        job = fresh()
        answers = get(f"fleet/node/{self.node}/job", json.dumps(a_job(id=job)), JSON)
        self.assertEqual(len(answers), 1)
        self.assertEqual(answers[0][1], {"job": job, "state": "queued"})
        self.finished(job)

    def test_a_get_with_all_of_zenohs_defaults_is_answered(self):
        job = fresh()
        replies = list(
            world.session.get(f"fleet/node/{self.node}/job", payload=json.dumps(a_job(id=job)))
        )
        self.assertEqual(len(replies), 1)
        self.assertEqual(
            read_json(replies[0].ok), {"job": job, "state": "queued"}
        )
        self.finished(job)

    def test_without_an_encoding_what_begins_with_a_brace_is_json(self):
        for blank in ["", " ", "\n", "\r\n\t  "]:
            job = fresh()
            receipt = get_one(f"fleet/node/{self.node}/job", blank + json.dumps(a_job(id=job)))
            self.assertEqual(receipt["job"], job)
            put_id = fresh()
            put(f"fleet/node/{self.node}/job", blank + json.dumps(a_job(id=put_id)))
            self.finished(job)
            self.finished(put_id)

    def test_without_an_encoding_anything_else_is_refused(self):
        for payload in ["", "  ", "[]", "motor.execute()", '"{', "\x00{", "null", "\ufeff{}"]:
            with self.assertRaises(Refused, msg=payload) as caught:
                get(f"fleet/node/{self.node}/job", payload)
            self.assertEqual(caught.exception.code, "bad_json", payload)

    def test_a_script_runs_and_its_result_is_in_the_record(self):
        script = "motor.queue_move(0, 200, 50) motor.execute() wait_idle() return {ok = true}"
        for payload, encoding in [
            (script, LUA),
            (json.dumps({"lua": script}), JSON),
        ]:
            receipt = get_one(f"fleet/node/{self.node}/job", payload, encoding)
            record = self.finished(receipt["job"])
            self.assertEqual(record["state"], "succeeded")
            self.assertEqual(record["result"]["returned"], {"ok": True})
            self.assertEqual(record["progress"], {"done": 1, "total": 1})

    def test_what_is_wrong_with_a_script_is_told_with_its_line(self):
        receipt = get_one(f"fleet/node/{self.node}/job", "motor.execute()\nx = = 1", LUA)
        record = self.finished(receipt["job"], "failed")
        self.assertEqual(record["error"]["code"], "bad_command")
        self.assertIn(":2: unexpected symbol near '='", record["error"]["message"])

    def test_stored_scripts_are_put_listed_called_and_deleted(self):
        base = f"fleet/node/{self.node}/script"
        # Longer than any one message on the way to the node.
        text = "local a = ... return a.x * 2 --" + "x" * 20_000
        put(f"{base}/double", text)
        put(f"{base}/other", "return 1")

        def stored(selector):
            replies = world.session.get(selector, timeout=PATIENCE_S)
            found = [reply.ok for reply in replies if reply.ok is not None]
            return {str(ok.key_expr): ok.payload.to_string() for ok in found}

        both = {f"{base}/double": text, f"{base}/other": "return 1"}
        deadline = time.monotonic() + PATIENCE_S
        while stored(f"{base}/*") != both:
            assert time.monotonic() < deadline, "the scripts are never stored"
        self.assertEqual(stored(f"{base}/double"), {f"{base}/double": text})
        job = {"call": "double", "args": {"x": 21}}
        receipt = get_one(f"fleet/node/{self.node}/job", json.dumps(job), JSON)
        self.assertEqual(self.finished(receipt["job"])["result"]["returned"], 42)
        world.session.delete(f"{base}/double")
        while stored(f"{base}/*") != {f"{base}/other": "return 1"}:
            assert time.monotonic() < deadline, "the script is never deleted"
        receipt = get_one(f"fleet/node/{self.node}/job", json.dumps(job), JSON)
        error = self.finished(receipt["job"], "failed")["error"]
        self.assertIn("no script 'double' is stored", error["message"])

    def test_postcard_is_read(self):
        job = fresh()
        payload = (
            # Version 1; an id; commands, one of them; move, axis 1, 200 µs, -300 steps (zigzag).
            bytes([1, 1, len(job)])
            + job.encode()
            + bytes([0, 1, 0, 1, 0xC8, 0x01, 0xD7, 0x04])
            # Queue if offline; no time limit.
            + bytes([0, 0])
        )
        receipt = get_one(f"fleet/node/{self.node}/job", payload, POSTCARD)
        self.assertEqual(receipt["job"], job)
        before = self.finished(job)["result"]["position"][1]
        self.assertEqual(before % -300, 0)
        self.assertEqual(world.fixture.pulses(self.node, 1), before)

    def test_postcard_garbage_is_refused(self):
        good = bytes([1, 0, 0, 1, 0, 1, 0xC8, 0x01, 0xD7, 0x04, 0, 0])
        garbage = [b"", b"\x00", b"\x01", b"\xff" * 100, bytes(64), b"{}", good + b"\0"]
        garbage += [bytes([2]) + good[1:], bytes([0]) + good[1:]]
        garbage += [good[:end] for end in range(1, len(good))]
        # A million commands are promised and none is there.
        garbage += [bytes([1, 0, 0, 0xC0, 0x84, 0x3D])]
        for payload in garbage:
            with self.assertRaises(Refused, msg=payload) as caught:
                get(f"fleet/node/{self.node}/job", payload, POSTCARD)
            self.assertEqual(caught.exception.code, "bad_json", payload)

    def test_postcard_is_checked_like_json(self):
        # 0 µs between steps.
        payload = bytes([1, 0, 0, 1, 0, 1, 0, 0xD7, 0x04, 0, 0])
        with self.assertRaises(Refused) as caught:
            get(f"fleet/node/{self.node}/job", payload, POSTCARD)
        self.assertEqual(caught.exception.code, "bad_command")
        self.assertIn("commands[0].move.delay_us", caught.exception.message)

    def test_an_encoding_that_is_not_in_the_contract_is_refused(self):
        for encoding in [
            "image/png",
            "text/plain",
            "application/octet-stream",
            "application/octet-stream;protobuf",
            "zenoh/string",
            "something/else",
        ]:
            with self.assertRaises(Refused, msg=encoding) as caught:
                get(f"fleet/node/{self.node}/job", json.dumps(a_job()), zenoh.Encoding(encoding))
            self.assertEqual(caught.exception.code, "bad_json", encoding)

    def test_a_refused_put_leaves_a_record_whatever_its_encoding(self):
        key = f"fleet/node/{self.node}/job"
        before = len(world.jobs.all())
        put(key, b"\xff\xfe", JSON)
        put(key, b"\xff\xfe", POSTCARD)
        put(key, b"\xff", LUA)
        put(key, b"{}", zenoh.Encoding("image/png"))
        put(key, b"")

        def find(samples):
            new = [s[3] for s in samples[before:] if s[3]["node"] == self.node]
            rejected = [value for value in new if value["state"] == "rejected"]
            return rejected if len(rejected) == 5 else None

        rejected = world.jobs.wait("five rejected records", find)
        codes = [value["error"]["code"] for value in rejected]
        self.assertEqual(codes, ["bad_json"] * 5)


class Commands(Case):
    """What a job may hold, and what is said about what it may not."""

    @classmethod
    def setUpClass(cls):
        cls.node = up(fresh("cmd"))

    @classmethod
    def tearDownClass(cls):
        down(cls.node)

    def run_job(self, *commands, **fields):
        job = fresh()
        submit(self.node, a_job(*commands, id=job, **fields))
        return self.finished(job)

    def test_a_move_gives_its_pulses_in_its_direction(self):
        before = world.fixture.pulses(self.node)
        found = self.run_job(move(123), move(-23), move(1), move(-1))
        self.assertEqual(world.fixture.pulses(self.node), before + 100)
        self.assertEqual(found["progress"], {"done": 4, "total": 4})

    def test_a_sync_move_moves_both_axes(self):
        before = [world.fixture.pulses(self.node, axis) for axis in (0, 1)]
        self.run_job({"sync_move": {"delay_us": [500, 1000], "steps": [200, -100]}})
        after = [world.fixture.pulses(self.node, axis) for axis in (0, 1)]
        self.assertEqual(after, [before[0] + 200, before[1] - 100])

    def test_the_other_commands_of_this_firmware_succeed(self):
        self.run_job(
            {"laser": {"power_percent": 0}},
            {"laser": {"power_percent": 100}},
            {"lidar_read": {}},
            {"pause": {"ms": 0}},
            {"pause": {"ms": 1}},
            {"laser": {"power_percent": 0}},
        )

    def test_a_pause_lasts(self):
        job = fresh()
        submit(self.node, a_job({"pause": {"ms": 300}}, id=job))
        started = utc(job_until(job, "sent")["updated"])
        lasted = utc(self.finished(job)["updated"]) - started
        self.assertGreaterEqual(lasted.total_seconds(), 0.3)

    def test_a_move_takes_the_time_of_its_pulses(self):
        job = fresh()
        submit(self.node, a_job(move(500, 1000), id=job))
        started = utc(job_until(job, "sent")["updated"])
        lasted = utc(self.finished(job)["updated"]) - started
        # 500 pulses have 499 intervals between them.
        self.assertGreaterEqual(lasted.total_seconds(), 0.499)

    def test_set_position_names_the_place_and_moves_nothing(self):
        node = self.new_node("pos")
        for place in [0, -1, 2**40, -(2**62), 2**63 - 1, -(2**63)]:
            job = fresh()
            submit(node, a_job({"set_position": {"axis": 1, "position": place}}, id=job))
            self.assertEqual(self.finished(job)["result"]["position"], [0, place])
            self.assertEqual(node_record(node)["position"], [0, place])
        self.assertEqual(world.fixture.pulses(node, 1), 0)

    def test_positions_are_exact_beyond_what_a_double_holds(self):
        job = fresh()
        submit(
            self.node,
            a_job({"set_position": {"axis": 0, "position": 2**53}}, move(1), move(2), id=job),
        )
        self.assertEqual(self.finished(job)["result"]["position"][0], 2**53 + 3)

    def test_an_axis_without_a_reference_switch_is_not_homed(self):
        self.refused(
            "bad_command",
            self.node,
            a_job(move(1), {"home": {"axis": 1}}),
            "commands[1].home.axis",
            "axis 1 of this node has no reference switch",
        )

    def test_an_axis_is_homed_and_its_switch_has_the_position(self):
        node = self.new_node("home", 2, "home=1:min@-150")
        job = fresh()
        home = {"home": {"axis": 1}}
        submit(node, a_job(move(7), home, id=job))
        # It ends 200 steps off its switch.
        self.assertEqual(self.finished(job)["result"]["position"], [7, 200])
        self.assertEqual(node_record(node)["position"], [7, 200])
        self.assertEqual(world.fixture.pulses(node, 1), 50)
        self.refused("bad_command", node, a_job({"home": {"axis": 0}}), "axis 0")

    def test_a_limit_stops_the_node_and_says_so(self):
        node = self.new_node("limit", 2, "limit=0:max@40")
        job = submit(node, a_job(move(1_000, 1_000), move(5)))["job"]
        self.assertEqual(self.finished(job, "failed")["error"]["code"], "stopped")
        found = node_in(node, "stopped")
        self.assertEqual(found["stopped"]["reason"], "limit")
        self.assertEqual(found["faults"][-1]["code"], 205)
        self.assertEqual(found["position"][0], world.fixture.pulses(node))
        self.assertIn(found["position"][0], [40, 41])
        self.refused("stopped", node, a_job(move(-5)))

    def test_a_barrier_outside_a_synchronized_job_is_refused_with_the_place(self):
        job = a_job(move(1), {"barrier": {"name": "layer-2"}})
        self.refused("bad_command", self.node, job, "commands[1].barrier")

    def test_the_largest_numbers_are_taken(self):
        # The longest move that a node can count is 2⁵⁸ µs.
        for command in [
            move(2**31 - 1, 2**27),
            move(-(2**31 - 1), 2**27),
            move(-(2**26), 2**32 - 1),
            {"sync_move": {"delay_us": [2**27, 2**27], "steps": [1 - 2**31, 2**31 - 1]}},
            {"pause": {"ms": 86_400_000}},
        ]:
            job = fresh()
            submit(self.node, a_job(command, id=job))
            job_until(job, "running")
            put(f"fleet/job/{job}/cancel")
            self.finished(job, "canceled")
            node_in(self.node, "idle")

    def test_a_move_that_no_node_could_count_is_refused_whole(self):
        job = a_job(*[move(1)] * 1000, move(2**31 - 1, 2**27 + 1))
        self.refused("bad_command", self.node, job, "commands[1000].move.delay_us: ")

    def test_numbers_out_of_range_are_refused_with_the_place(self):
        def with_field(word, field, value):
            fields = {
                "move": {"axis": 0, "delay_us": 5, "steps": 1},
                "pause": {"ms": 1},
                "laser": {"power_percent": 1},
                "set_position": {"axis": 0, "position": 1},
            }[word]
            return {word: {**fields, field: value}}

        bad = {
            ("move", "steps"): [0, 2**31, -(2**31), 2**63, 2**64, 10**30],
            ("move", "delay_us"): [0, -1, 2**32],
            ("move", "axis"): [2, 3, 255, 256, -1, 2**32],
            ("pause", "ms"): [-1, 2**32, 86_400_001],
            ("laser", "power_percent"): [101, 255, 256, -1],
            ("set_position", "axis"): [2, 256, -1],
            ("set_position", "position"): [2**63, -(2**63) - 1, 2**64],
        }
        for (word, field), values in bad.items():
            # What is no integer is out of range everywhere.
            for value in [*values, 1.5, 1.0, True, None, "1", [1], {}]:
                command = with_field(word, field, value)
                # Earlier commands are right: the number is that of the wrong one.
                job = a_job(move(1), move(2), command)
                self.refused("bad_command", self.node, job, f"commands[2].{word}.{field}: ")

    def test_both_axes_of_a_sync_move_are_checked(self):
        for field, value in [
            ("delay_us", [0, 5]),
            ("delay_us", [5, 0]),
            ("steps", [0, 5]),
            ("steps", [5, -(2**31)]),
            ("steps", [5]),
            ("steps", [5, 5, 5]),
            ("steps", 5),
        ]:
            command = {"sync_move": {"delay_us": [5, 5], "steps": [5, 5], field: value}}
            job = a_job(command)
            self.refused("bad_command", self.node, job, f"commands[0].sync_move.{field}")

    def test_an_axis_that_the_node_does_not_have_is_refused(self):
        node = self.new_node("one", 1)
        self.refused("bad_command", node, a_job(move(1, axis=1)), "commands[0].move.axis: ")
        sync = {"sync_move": {"delay_us": [5, 5], "steps": [5, 5]}}
        self.refused("bad_command", node, a_job(move(1), sync), "commands[1].sync_move")
        job = fresh()
        submit(node, a_job(move(7), id=job))
        self.assertEqual(self.finished(job)["result"]["position"], [7])

    def test_unknown_words_are_refused_with_the_place(self):
        def with_commands(*commands):
            return a_job(*commands)

        unknown = [
            (a_job(extra=1), "bad_json", "extra"),
            (a_job(ID="x"), "bad_json", "ID"),
            (a_job(timeout=1), "bad_json", "timeout"),
            (with_commands({"jump": {}}), "bad_command", "commands[0]"),
            (with_commands({"Move": move(1)["move"]}), "bad_command", "commands[0]"),
            (
                with_commands(move(1), {"move": {**move(1)["move"], "speed": 3}}),
                "bad_command",
                "commands[1].move",
            ),
            (with_commands({"pause": {"ms": 1, "s": 1}}), "bad_command", "commands[0].pause"),
            (with_commands({"lidar_read": {"x": 1}}), "bad_command", "commands[0].lidar_read"),
            (with_commands({**move(1), "pause": {"ms": 1}}), "bad_command", "commands[0]"),
            (with_commands({}), "bad_command", "commands[0]"),
            (with_commands("lidar_read"), "bad_command", "commands[0]"),
            (with_commands(None), "bad_command", "commands[0]"),
            (with_commands([]), "bad_command", "commands[0]"),
            (with_commands(7), "bad_command", "commands[0]"),
            (with_commands({"move": {"axis": 0, "delay_us": 5}}), "bad_command", "steps"),
            (with_commands({"move": {}}), "bad_command", "commands[0].move"),
            (with_commands({"move": None}), "bad_command", "commands[0].move"),
            (with_commands({"move": [0, 5, 1]}), "bad_command", "commands[0].move"),
            ({"commands": {}}, "bad_json", "commands"),
            ({"commands": 1}, "bad_json", "commands"),
            ({"lua": 5}, "bad_json", "lua"),
            (a_job(offline="maybe"), "bad_json", "offline"),
            (a_job(offline=True), "bad_json", "offline"),
        ]
        for job, code, place in unknown:
            self.refused(code, self.node, job, place)

    def test_what_is_no_json_object_is_refused(self):
        whole = json.dumps(a_job())
        texts = [
            "",
            " ",
            "{",
            "}",
            "null",
            "1",
            '"x"',
            "[]",
            "[" + whole + "]",
            '["' + fresh() + '", [{"lidar_read": {}}], null, null, null]',
            whole + "x",
            whole + whole,
            whole[:-1],
            whole.replace("10", "010"),
            whole.replace("10", "NaN"),
            whole.replace("10", "Infinity"),
            whole.replace('"axis"', "axis"),
            "{'commands':[]}",
            "// x\n" + whole,
            whole.replace("}]", "},]"),
            "[" * 10_000,
            '{"commands":' + "[" * 10_000,
        ]
        payloads = [text.encode() for text in texts] + [b"\xff", whole.encode("utf-16")]
        payloads.append(b'{"id":"\xff","commands":[]}')
        for payload in payloads:
            with self.assertRaises(Refused, msg=payload[:100]) as caught:
                get(f"fleet/node/{self.node}/job", payload, JSON)
            self.assertIn(caught.exception.code, ("bad_json", "bad_command"), payload[:100])

    def test_a_field_that_comes_twice_is_refused(self):
        one = json.dumps(move(1))
        for text in [
            f'{{"commands":[{one}],"commands":[{one}]}}',
            f'{{"id":"a","id":"b","commands":[{one}]}}',
            '{"commands":[{"move":{"axis":0,"axis":1,"delay_us":5,"steps":1}}]}',
        ]:
            self.refused("bad_command" if '"axis":1' in text else "bad_json", self.node, text)

    def test_a_job_needs_something_to_do(self):
        self.refused("bad_json", self.node, {})
        self.refused("bad_json", self.node, {"id": fresh()})
        self.refused("bad_json", self.node, a_job(lua="x"))
        self.refused("bad_command", self.node, {"commands": []}, "commands")

    def test_a_job_is_taken_whole_or_not_at_all(self):
        before = world.fixture.pulses(self.node)
        job = fresh()
        many = [move(1)] * 300
        self.refused("bad_command", self.node, a_job(*many, move(0), id=job), "commands[300].")
        self.refused("bad_command", self.node, a_job(*many, move(1, axis=9), id=job))
        with self.assertRaises(Refused):
            record(job)
        # What comes behind it runs, and only that.
        self.run_job(move(5))
        self.assertEqual(world.fixture.pulses(self.node), before + 5)

    def test_a_job_larger_than_the_queue_runs_to_its_end(self):
        node = self.new_node("big")
        free = node_record(node)["queue"]["free"]
        count = 2 * free + 100
        job = fresh()
        submit(node, a_job(*[move(1, 50), move(-1, 50), move(1, 50)] * (count // 3), id=job))
        found = self.finished(job)
        total = count // 3 * 3
        self.assertEqual(found["progress"], {"done": total, "total": total})
        self.assertEqual(found["result"]["position"][0], count // 3)
        self.assertEqual(world.fixture.pulses(node), count // 3)

    def test_what_is_too_large_is_refused_as_that(self):
        too_many = '{"commands":[' + ",".join(['{"lidar_read":{}}'] * 1_000_001) + "]}"
        self.refused("too_large", self.node, too_many, "1000001")
        too_long = b"{" + b" " * (64 << 20) + b"}"
        self.refused("too_large", self.node, too_long)


class Ramps(Case):
    """`ramp` relative, `ramp_to` absolute, `line` with all axes together."""

    @classmethod
    def setUpClass(cls):
        cls.node = up(fresh("ramp"))

    @classmethod
    def tearDownClass(cls):
        world.fixture("down", cls.node)

    def run_on(self, node, *commands, **fields):
        """Runs a job to its end and returns where the axes are, by record and by pins."""
        job = submit(node, a_job(*commands, **fields))["job"]
        found = self.finished(job)
        self.assertEqual(found["progress"], {"done": len(commands), "total": len(commands)})
        positions = found["result"]["position"]
        self.assertEqual(node_record(node)["position"], positions)
        return positions

    def pins(self, node):
        return [world.fixture.pulses(node, axis) for axis in (0, 1)]

    def test_a_ramp_of_every_shape_makes_its_steps_in_its_direction(self):
        for shape in SHAPES:
            for steps, axis in [(1, 0), (-1, 1), (2, 1), (377, 0), (-250, 0), (-1_203, 1)]:
                before = self.pins(self.node)
                expected = list(before)
                expected[axis] += steps
                command = ramp(steps, 20_000, 400_000, axis, **shape)
                positions = self.run_on(self.node, command)
                self.assertEqual(self.pins(self.node), expected, (shape, steps))
                self.assertEqual(positions, expected, (shape, steps))

    def test_a_ramp_to_of_every_shape_ends_at_its_position(self):
        for shape in SHAPES:
            for place, axis in [(300, 0), (-200, 1), (-1, 0), (0, 1), (0, 0)]:
                expected = self.pins(self.node)
                expected[axis] = place
                command = ramp_to(place, 20_000, 400_000, axis, **shape)
                positions = self.run_on(self.node, command)
                self.assertEqual(self.pins(self.node), expected, (shape, place))
                self.assertEqual(positions, expected, (shape, place))

    def test_a_ramp_lasts_as_long_as_its_law_says(self):
        node = self.new_node("law")
        for command, least_s in [
            # Way through top speed, and once the way up and down again.
            (ramp(1_000, 2_000, 8_000), 0.5 + 0.25),
            # No room for the top speed: up to the middle and down.
            (ramp_to(0, 1_000_000, 4_000), 2 * (1_000 / 4_000) ** 0.5),
            # Acceleration itself has ramps of a/j.
            (ramp(-800, 2_000, 8_000, jerk=40_000), 0.4 + 0.25 + 0.2),
            # Longer than without.
            (ramp(1_000, 2_000, 8_000, linear_steps=100), 0.5 + 0.25),
            # The axis with most steps keeps the limits.
            (line(400, -1_000, speed_hz=2_000, accel=8_000), 0.5 + 0.25),
        ]:
            job = fresh()
            submit(node, a_job(command, id=job))
            started = utc(job_until(job, "sent")["updated"])
            lasted = utc(self.finished(job)["updated"]) - started
            self.assertGreaterEqual(lasted.total_seconds(), least_s, command)

    def test_ramp_to_is_relative_to_the_position_that_was_set(self):
        node = self.new_node("to")
        positions = self.run_on(
            node,
            move(30),
            set_position(1_000),
            ramp_to(1_100),
            set_position(-7, axis=1),
            ramp_to(13, axis=1),
            ramp(-5),
            ramp_to(1_000),
            set_position(0),
        )
        self.assertEqual(positions, [0, 13])
        self.assertEqual(self.pins(node), [30, 20])
        # A later job begins where the one before it ended.
        self.assertEqual(self.run_on(node, ramp_to(-30), ramp_to(0, axis=1)), [-30, 0])
        self.assertEqual(self.pins(node), [0, 7])

    def test_ramp_to_where_it_stands_moves_nothing(self):
        node = self.new_node("here")
        self.assertEqual(self.run_on(node, ramp_to(0)), [0, 0])
        self.assertEqual(self.run_on(node, *[ramp_to(0, axis=1)] * 20), [0, 0])
        self.assertEqual(self.pins(node), [0, 0])
        positions = self.run_on(
            node,
            ramp_to(0),
            ramp(40),
            ramp_to(40, jerk=5),
            set_position(2**62),
            ramp_to(2**62, linear_steps=9, jump_steps=9),
            ramp_to(0, axis=1),
            {"pause": {"ms": 1}},
            ramp_to(2**62),
        )
        self.assertEqual(positions, [2**62, 0])
        self.assertEqual(self.pins(node), [40, 0])

    def test_positions_of_ramps_are_exact_at_the_ends_of_64_bits(self):
        node = self.new_node("far")
        for place, target in [
            (2**53 + 1, 2**53 + 4),
            (-(2**53) - 1, -(2**53) - 4),
            (2**63 - 1, 2**63 - 101),
            (2**63 - 101, 2**63 - 1),
            (-(2**63), -(2**63) + 99),
            (-(2**63) + 99, -(2**63)),
        ]:
            before = world.fixture.pulses(node)
            positions = self.run_on(node, set_position(place), ramp_to(target))
            self.assertEqual(positions[0], target)
            self.assertEqual(world.fixture.pulses(node), before + target - place)

    def test_a_line_moves_all_its_axes(self):
        node = self.new_node("line")
        expected = [0, 0]
        for steps in [
            [300],
            [0, 200],
            [-300, 0],
            [1, -1],
            [1_000, -400],
            [-7, 900],
            [2, 1_001],
            [-1, 0, 0],
            [1, 1, 0, 0],
        ]:
            for limits in [{}, {"jerk": 2_000_000}, {"jerk": None}]:
                command = line(*steps, speed_hz=20_000, accel=400_000, **limits)
                positions = self.run_on(node, command)
                expected = [a + b for a, b in zip(expected, [*steps, 0])]
                self.assertEqual(positions, expected, (steps, limits))
                self.assertEqual(self.pins(node), expected, (steps, limits))

    def test_a_path_of_many_short_lines_comes_back_to_its_beginning(self):
        node = self.new_node("path")
        corner = [(20, 2), (18, 8), (14, 14), (8, 18), (2, 20)]
        quarters = [(1, 1, False), (-1, 1, True), (-1, -1, False), (1, -1, True)]
        path = []
        for x_sign, y_sign, swapped in quarters:
            way = [(x * x_sign, y * y_sign) for x, y in (corner[::-1] if swapped else corner)]
            path += [line(*way[0]), *[line(*steps) for steps in way[1:]]]
        self.assertEqual(self.run_on(node, *path * 4), [0, 0])
        self.assertEqual(self.pins(node), [0, 0])
        # Half of it leads to the other side.
        x, y = (2 * sum(steps) for steps in zip(*corner))
        self.assertEqual(self.run_on(node, *path[:10]), [0, y])
        self.assertEqual(x, y)

    def test_all_kinds_of_commands_follow_each_other(self):
        node = self.new_node("mix")
        commands = [
            move(50),
            ramp(100, jump_steps=5),
            line(-30, 60),
            line(-30, 60, jerk=1_000_000),
            {"laser": {"power_percent": 30}},
            ramp(-20, axis=1, jerk=1_000_000),
            {"sync_move": {"delay_us": [500, 300], "steps": [20, -20]}},
            {"pause": {"ms": 2}},
            ramp_to(0, axis=1, linear_steps=10),
            {"lidar_read": {}},
            line(0, 5),
            {"laser": {"power_percent": 0}},
            ramp_to(7),
        ]
        self.assertEqual(self.run_on(node, *commands), [7, 5])
        self.assertEqual(self.pins(node), [7, 5])

    def test_a_job_of_more_ramps_than_the_queue_holds_runs_to_its_end(self):
        node = self.new_node("bigr")
        free = node_record(node)["queue"]["free"]
        fast = {"speed_hz": 100_000, "accel": 10_000_000}
        some = [ramp(2, **fast), line(1, 3, **fast), ramp_to(1, axis=1, **fast)]
        # Axis 1 is at 1 after each round.
        count = free // 2
        self.assertEqual(self.run_on(node, *some * count), [3 * count, 1])
        self.assertEqual(self.pins(node), [3 * count, 1])

    def test_progress_counts_ramps(self):
        node = self.new_node("progr")
        job = fresh()
        short = [ramp(200, 10_000, 100_000), ramp_to(0), line(100, 200)]
        submit(node, a_job(*short, ramp(2**31 - 1, 1_000, 1_000), ramp(1), id=job))

        def find(samples):
            values = [value for _, _, _, value in samples]
            return [v for v in values if v["state"] == "running" and v["progress"]["done"] == 3]

        world.jobs.wait("three of five", find, f"fleet/job/{job}")
        get_one(f"fleet/job/{job}/cancel")
        found = self.finished(job, "canceled")
        self.assertEqual(found["progress"], {"done": 3, "total": 5})
        self.assertEqual(found["result"]["position"], self.pins(node))

    def test_numbers_out_of_range_are_refused_with_the_place(self):
        good = {
            "ramp": {**ramp(1)["ramp"], "jerk": None, "linear_steps": 0, "jump_steps": 0},
            "ramp_to": {**ramp_to(1)["ramp_to"], "jerk": None, "linear_steps": 0, "jump_steps": 0},
            "line": {**line(1, 1)["line"], "jerk": None},
        }
        beyond = [-1, 2**32, 2**64, 10**30]
        # The shortest time between two steps is 1 µs, as that of a move.
        speeds = [0, 1_000_001, 2**32 - 1, *beyond]
        bad = {
            ("ramp", "axis"): [2, 3, 255, 256, -1],
            ("ramp", "steps"): [0, 2**31, -(2**31), 2**64],
            ("ramp", "speed_hz"): speeds,
            ("ramp", "accel"): [0, *beyond],
            ("ramp", "jerk"): [0, *beyond],
            ("ramp", "linear_steps"): [-1, 65_536, 10**30],
            ("ramp", "jump_steps"): [-1, 65_536, 10**30],
            ("ramp_to", "axis"): [2, 256, -1],
            ("ramp_to", "position"): [2**63, -(2**63) - 1, 2**64],
            ("ramp_to", "speed_hz"): speeds,
            ("ramp_to", "accel"): [0, *beyond],
            ("ramp_to", "jerk"): [0, *beyond],
            ("ramp_to", "linear_steps"): [-1, 65_536],
            ("ramp_to", "jump_steps"): [-1, 65_536],
            ("line", "speed_hz"): speeds,
            ("line", "accel"): [0, *beyond],
            ("line", "jerk"): [0, *beyond],
        }
        for (word, field), values in bad.items():
            # What is no integer is out of range everywhere; `null` is no jerk.
            no_integers = [1.5, 1.0, True, "1", [1], {}] + [None] * (field != "jerk")
            for value in [*values, *no_integers]:
                # Commands before it are right: the number is that of the wrong one.
                job = a_job(move(1), ramp(1), line(1), {word: {**good[word], field: value}})
                self.refused("bad_command", self.node, job, f"commands[3].{word}.{field}: ")

    def test_what_is_no_line_is_refused_with_the_place(self):
        for steps, place in [
            ([], "steps: "),
            ([0], "steps: "),
            ([0, 0, 0, 0], "steps: "),
            ([1, 1, 1, 1, 1], "steps: "),
            # This node has two axes.
            ([0, 0, 1], "steps: "),
            ([1, 1, 0, -1], "steps: "),
            ([1, 2**31], "steps[1]: "),
            ([1, -(2**31)], "steps"),
            ([1.5], "steps[0]: "),
            ([1, None], "steps[1]: "),
            ([True], "steps[0]: "),
            (["1"], "steps[0]: "),
            ([[1]], "steps[0]: "),
            (5, "steps: "),
            (None, "steps: "),
            ({"0": 1}, "steps: "),
            ("1", "steps: "),
        ]:
            job = a_job(line(1), {"line": {**line(1)["line"], "steps": steps}})
            self.refused("bad_command", self.node, job, f"commands[1].line.{place}")

    def test_a_limit_of_jerk_excludes_the_shape_of_the_first_steps(self):
        for shape in [{"linear_steps": 1}, {"jump_steps": 1}, {"linear_steps": 5, "jump_steps": 5}]:
            for make in (ramp, ramp_to):
                command = make(10, jerk=1_000, **shape)
                (word,) = command
                self.refused(
                    "bad_command", self.node, a_job(move(1), command), f"commands[1].{word}.jerk: "
                )

    def test_unknown_and_missing_fields_are_refused_with_the_place(self):
        for command in (ramp(1), ramp_to(1), line(1)):
            ((word, fields),) = command.items()
            for extra in ["speed", "delay_us", "jerks", "Axis"]:
                job = a_job(move(1), {word: {**fields, extra: 1}})
                self.refused("bad_command", self.node, job, f"commands[1].{word}", extra)
            for missing in fields:
                rest = {name: value for name, value in fields.items() if name != missing}
                job = a_job(move(1), {word: rest})
                self.refused("bad_command", self.node, job, f"commands[1].{word}", missing)
        # Fields of one form in another.
        for command, field in [
            ({"ramp": ramp_to(5)["ramp_to"]}, "position"),
            ({"ramp_to": ramp(5)["ramp"]}, "steps"),
            ({"line": {**line(1)["line"], "linear_steps": 0}}, "linear_steps"),
            ({"line": {**line(1)["line"], "axis": 0}}, "axis"),
            ({"move": ramp(5)["ramp"]}, "speed_hz"),
        ]:
            (word,) = command
            job = a_job(command)
            self.refused("bad_command", self.node, job, f"commands[0].{word}", field)

    def test_a_job_with_a_wrong_ramp_is_not_taken_in_part(self):
        before = self.pins(self.node)
        job = fresh()
        many = [ramp(1), line(1, 1)] * 300
        wrong = ramp(1, speed_hz=0)
        self.refused("bad_command", self.node, a_job(*many, wrong, id=job), "commands[600].ramp.")
        self.refused("bad_command", self.node, a_job(*many, line(0, 0, 1), id=job))
        with self.assertRaises(Refused):
            record(job)
        self.run_on(self.node, ramp(3))
        self.assertEqual(self.pins(self.node), [before[0] + 3, before[1]])

    def test_a_refused_put_of_a_ramp_leaves_its_record(self):
        job = fresh()
        put_job(self.node, a_job(ramp(5), ramp(5, speed_hz=0), id=job))
        error = self.finished(job, "rejected")["error"]
        self.assertEqual(error["code"], "bad_command")
        self.assertIn("commands[1].ramp.speed_hz: ", error["message"])

    def test_postcard_of_each_form_is_read(self):
        node = self.new_node("card")
        # What a command begins with: its number, and for ramps the axis.
        forms = [
            # Axis 1, 100 steps (zigzag); 5,000 Hz; 50,000 steps/s²; no jerk; 3 linear, 2 jump.
            bytes([2, 1, 0xC8, 0x01, 0x88, 0x27, 0xD0, 0x86, 0x03, 0, 3, 2]),
            # Axis 0 to -50; jerk 1,000,000.
            bytes([3, 0, 0x63, 0x88, 0x27, 0xD0, 0x86, 0x03, 1, 0xC0, 0x84, 0x3D, 0, 0]),
            # Two axes, 10 and -1 steps; no jerk.
            bytes([4, 2, 20, 1, 0x88, 0x27, 0xD0, 0x86, 0x03, 0]),
        ]
        payload = bytes([1, 0, 0, len(forms)]) + b"".join(forms) + bytes([0, 0])
        job = get_one(f"fleet/node/{node}/job", payload, POSTCARD)["job"]
        self.assertEqual(self.finished(job)["result"]["position"], [-40, 99])
        self.assertEqual(self.pins(node), [-40, 99])
        # Jerk and linear steps together.
        bad = bytes([2, 1, 2, 1, 1, 1, 1, 3, 0])
        with self.assertRaises(Refused) as caught:
            get(f"fleet/node/{node}/job", bytes([1, 0, 0, 1]) + bad + bytes([0, 0]), POSTCARD)
        self.assertEqual(caught.exception.code, "bad_command")
        self.assertIn("commands[0].ramp.jerk: ", caught.exception.message)

    def test_the_largest_numbers_are_taken(self):
        node = self.new_node("huge")
        most = 2**32 - 1
        for command in [
            ramp(2**31 - 1, 1_000_000, most),
            ramp(1 - 2**31, 1, 1),
            ramp(2**31 - 1, 1_000_000, 1),
            ramp(1 - 2**31, 1_000, most, jerk=most),
            ramp(1 - 2**31, 1_000, 1_000, jerk=1),
            ramp(2**31 - 1, 1_000, 1_000, linear_steps=65_535, jump_steps=65_535),
            ramp_to(2**63 - 1, 1_000, 1_000),
            ramp_to(-(2**63), 1_000, most, jerk=most),
            line(2**31 - 1, 1 - 2**31, speed_hz=1_000, accel=most),
            line(1, 2**31 - 1, speed_hz=1_000_000, accel=1_000, jerk=1),
        ]:
            job = submit(node, a_job(command, ramp(1)))["job"]
            job_until(job, "running")
            put(f"fleet/job/{job}/cancel")
            found = self.finished(job, "canceled")
            self.assertEqual(found["result"]["position"], self.pins(node), command)
            node_in(node, "idle")

    def moving(self, node, *commands, **fields):
        """Hands in a job and waits until it has moved some steps."""
        before = self.pins(node)
        job = submit(node, a_job(*commands, **fields))["job"]
        node_until(
            node,
            "moving",
            lambda found: found["job"] == job
            and sum(abs(a - b) for a, b in zip(found["position"], before)) > 50,
        )
        return job

    LONG = [
        ramp(10_000_000, 3_000, 3_000),
        ramp(-10_000_000, 3_000, 3_000, linear_steps=200, jump_steps=10),
        ramp_to(10_000_000, 3_000, 3_000, axis=1, jerk=10_000),
        line(10_000_000, -3_333_333, speed_hz=3_000, accel=3_000),
        line(-3_333_333, -10_000_000, speed_hz=3_000, accel=3_000, jerk=10_000),
    ]

    def test_a_cancel_in_the_middle_leaves_exact_positions(self):
        node = self.new_node("cram")
        for command in self.LONG:
            job = self.moving(node, command, move(5))
            following = submit(node, a_job(ramp_to(0), ramp_to(0, axis=1)))["job"]
            get_one(f"fleet/job/{job}/cancel")
            found = self.finished(job, "canceled")
            self.assertEqual(found["progress"], {"done": 0, "total": 2})
            self.assertNotEqual(found["result"]["position"], [0, 0])
            # What waits behind it begins where it came to rest, and finds home.
            self.assertEqual(self.finished(following)["result"]["position"], [0, 0])
            self.assertEqual(self.pins(node), [0, 0], command)

    def test_a_stop_in_the_middle_leaves_exact_positions(self):
        node = self.new_node("sram")
        for mode in ["halt", "decelerate"]:
            for command in self.LONG:
                job = self.moving(node, command, move(5))
                put(f"fleet/node/{node}/stop", json.dumps({"mode": mode}))
                found = self.finished(job, "failed")
                self.assertEqual(found["error"]["code"], "stopped")
                at_rest = self.pins(node)
                self.assertEqual(found["result"]["position"], at_rest, (mode, command))
                self.assertEqual(node_in(node, "stopped")["position"], at_rest)
                self.refused("stopped", node, a_job(ramp(5)))
                get_one(f"fleet/node/{node}/release")
                self.assertEqual(self.pins(node), at_rest, (mode, command))
                home = self.run_on(node, ramp_to(0), ramp_to(0, axis=1))
                self.assertEqual(home, [0, 0], (mode, command))
                self.assertEqual(self.pins(node), [0, 0], (mode, command))

    def test_a_stop_on_a_path_of_short_lines_leaves_exact_positions(self):
        node = self.new_node("spath")
        path = [line(40, 10), line(35, 20), line(30, 30), line(20, 35), line(10, 40)]
        for mode in ["halt", "decelerate"]:
            job = self.moving(node, *path * 500, line(2**31 - 1, 2**31 - 1))
            put(f"fleet/node/{node}/stop", json.dumps({"mode": mode}))
            found = self.finished(job, "failed")
            at_rest = self.pins(node)
            self.assertEqual(found["result"]["position"], at_rest, mode)
            get_one(f"fleet/node/{node}/release")
            self.assertEqual(self.run_on(node, ramp_to(0), ramp_to(0, axis=1)), [0, 0], mode)
            self.assertEqual(self.pins(node), [0, 0], mode)

    def test_a_ramp_past_its_time_limit_comes_to_rest_without_a_latch(self):
        node = self.new_node("tram")
        job = submit(node, a_job(ramp(10_000_000, 3_000, 3_000), timeout_s=0.3))["job"]
        found = self.finished(job, "timed_out")
        self.assertEqual(found["result"]["position"], self.pins(node))
        self.assertIsNone(node_in(node, "idle")["stopped"])
        self.assertEqual(self.run_on(node, ramp_to(0)), [0, 0])
        self.assertEqual(self.pins(node), [0, 0])

    def test_jobs_of_ramps_follow_each_other_in_their_order(self):
        node = self.new_node("oram")
        places = [100, -50, 70, 70, 0, 3]
        jobs = [submit(node, a_job(ramp_to(place)))["job"] for place in places]
        ends = [self.finished(job)["result"]["position"][0] for job in jobs]
        self.assertEqual(ends, places)
        self.assertEqual(self.pins(node), [3, 0])

    def test_a_wild_key_gives_each_node_the_ramp(self):
        word = fresh("wram")
        nodes = [f"{word}-1", f"{word}-2"]
        for number, name in enumerate(nodes):
            up(name)
            self.addCleanup(self.switch_off, name)
            self.run_on(name, ramp(10 + number))
        job = json.dumps(a_job(ramp_to(-5), line(0, 9)))
        answers = get(f"fleet/node/{word}-$*/job", job, JSON)
        for _, receipt in answers:
            self.assertEqual(self.finished(receipt["job"])["result"]["position"], [-5, 9])
        self.assertEqual([self.pins(name) for name in nodes], [[-5, 9]] * 2)


class Ids(Case):
    """`id` is the client's own and makes a job idempotent."""

    @classmethod
    def setUpClass(cls):
        cls.node = up(fresh("ids"))

    @classmethod
    def tearDownClass(cls):
        down(cls.node)

    def test_every_legal_name_is_an_id(self):
        for job in ["0", "z", "a_b-c", "9-", "x" * 32, "0-_-_"]:
            self.assertEqual(submit(self.node, a_job(id=job))["job"], job)
            self.finished(job)

    def test_what_is_no_name_is_bad_id(self):
        names = ["", "A", "-a", "_a", "a b", "a/b", "a*", "*", "ä", "x" * 33, "a\n", "a\0", "a.b"]
        for job in names:
            self.refused("bad_id", self.node, a_job(id=job), "id")
        for job in [5, True, [], {}]:
            with self.assertRaises(Refused) as caught:
                submit(self.node, a_job(id=job))
            self.assertIn(caught.exception.code, ("bad_id", "bad_json"))

    def test_an_id_that_the_gateway_makes_sorts_by_time(self):
        ids = [submit(self.node, a_job())["job"] for _ in range(20)]
        for job in ids:
            self.assertRegex(job, NAME)
        self.assertEqual(ids, sorted(ids))
        self.assertEqual(len(set(ids)), 20)
        self.finished(ids[-1])

    def test_the_same_id_again_answers_with_the_job_and_does_nothing(self):
        before = world.fixture.pulses(self.node)
        other_node = self.new_node("other")
        job = fresh()
        submit(self.node, a_job(move(40), id=job))
        first = self.finished(job)
        again = {"job": job, "state": "succeeded"}
        self.assertEqual(submit(self.node, a_job(move(40), id=job)), again)
        self.assertEqual(submit(self.node, a_job(move(999), id=job)), again)
        self.assertEqual(submit(other_node, a_job(move(40), id=job)), again)
        put_job(self.node, a_job(move(40), id=job))
        put_job(other_node, a_job(move(999), id=job))
        # What is handed in behind them is handled behind them.
        for node in (self.node, other_node):
            behind = submit(node, a_job({"lidar_read": {}}))["job"]
            self.finished(behind)
        self.assertEqual(record(job), first)
        self.assertEqual(records_of(job)[-1], first)
        self.assertEqual(world.fixture.pulses(self.node), before + 40)
        self.assertEqual(world.fixture.pulses(other_node), 0)

    def test_the_same_id_again_while_the_job_waits_or_runs_does_nothing(self):
        node = self.new_node("twice")
        running, waiting = fresh(), fresh()
        submit(node, a_job(lasting(FOREVER_S), id=running))
        submit(node, a_job(move(3), id=waiting))
        job_until(running, "running")
        self.assertEqual(submit(node, a_job(id=running)), {"job": running, "state": "running"})
        self.assertEqual(submit(node, a_job(id=waiting)), {"job": waiting, "state": "queued"})
        put(f"fleet/job/{running}/cancel")
        at_rest = self.finished(running, "canceled")["result"]["position"][0]
        self.finished(waiting)
        self.assertEqual(world.fixture.pulses(node), at_rest + 3)

    def test_a_wrong_job_under_a_taken_id_leaves_the_job_alone(self):
        job = fresh()
        submit(self.node, a_job(id=job))
        first = self.finished(job)
        self.refused("bad_command", self.node, a_job(move(0), id=job))
        before = len(world.jobs.all())
        put_job(self.node, a_job(move(0), id=job))

        def find(samples):
            for _, _, _, value in samples[before:]:
                if value["state"] == "rejected" and value["node"] == self.node:
                    return value
            return None

        rejected = world.jobs.wait("a rejected record", find)
        self.assertNotEqual(rejected["job"], job)
        self.assertEqual(record(job), first)

    def test_many_clients_with_one_id_make_one_job(self):
        node = self.new_node("crowd")
        job = fresh()
        payload = json.dumps(a_job(move(100), id=job))
        gets = [
            world.session.get(
                f"fleet/node/{node}/job", payload=payload, encoding=JSON, timeout=PATIENCE_S
            )
            for _ in range(50)
        ]
        receipts = [read_json(reply.ok) for each in gets for reply in each]
        self.assertEqual({receipt["job"] for receipt in receipts}, {job})
        self.assertEqual(len(receipts), 50)
        self.finished(job)
        self.assertEqual(world.fixture.pulses(node), 100)


class Refusals(Case):
    """A refused get is answered with an error; a refused put leaves a record."""

    def test_a_node_that_was_never_seen_is_unknown(self):
        self.refused("unknown_node", "nobody", a_job())
        job = fresh()
        put_job("nobody", a_job(id=job))
        found = self.finished(job, "rejected")
        self.assertEqual(found["error"]["code"], "unknown_node")
        self.assertEqual(found["version"], 1)
        self.assertEqual(record(job), found)

    def test_a_key_that_names_no_node_is_refused(self):
        for name in ["Nobody", "x" * 33, "no.body", "-x"]:
            with self.assertRaises(Refused, msg=name) as caught:
                submit(name, a_job())
            self.assertIn(caught.exception.code, ("unknown_node", "bad_id"), name)

    def test_a_refused_put_without_an_id_has_a_record_under_a_made_one(self):
        node = self.new_node("put")
        before = len(world.jobs.all())
        put_job(node, {"commands": [move(0)]})
        put_job(node, {"id": "NOT A NAME", "commands": [move(1)]})

        def find(samples):
            new = [s[3] for s in samples[before:] if s[3]["node"] == node]
            return new if len(new) == 2 else None

        first, second = world.jobs.wait("two records", find)
        self.assertEqual(first["state"], "rejected")
        self.assertEqual(first["error"]["code"], "bad_command")
        self.assertIn("commands[0].move.steps", first["error"]["message"])
        self.assertEqual(second["error"]["code"], "bad_id")
        self.assertEqual(record(first["job"]), first)

    def test_put_and_get_are_refused_with_the_same_words(self):
        node = self.new_node("same")
        for job in [a_job(move(0)), a_job(timeout_s=-1), a_job(move(1, axis=7)), {"x": 1}]:
            with self.assertRaises(Refused) as caught:
                submit(node, job)
            name = fresh()
            put_job(node, {**job, "id": name})
            error = self.finished(name, "rejected")["error"]
            self.assertEqual(error["code"], caught.exception.code)
            self.assertEqual(error["message"].split(" at line")[0],
                             caught.exception.message.split(" at line")[0])

    def test_a_time_limit_must_be_a_time(self):
        node = self.new_node("limit")
        for limit in ["0", "-1", "-0.5", '"5"', "true", "[]", "1e999", "NaN"]:
            text = f'{{"commands":[{json.dumps(move(1))}],"timeout_s":{limit}}}'
            self.refused("bad_json", node, text)


class WildKeys(Case):
    """A job on a wild key becomes one for each matching node that is alive."""

    def setUp(self):
        word = fresh("cell")
        self.word = word
        self.nodes = [f"{word}-a-1", f"{word}-a-2", f"{word}-b-1"]
        for name in self.nodes:
            up(name)
            self.addCleanup(self.switch_off, name)

    def test_a_get_is_answered_by_one_receipt_for_each(self):
        for options in [{}, {"consolidation": zenoh.ConsolidationMode.LATEST}]:
            answers = get(
                f"fleet/node/{self.word}-a-$*/job", json.dumps(a_job(move(9))), JSON, **options
            )
            receipts = [value for _, value in answers]
            self.assertEqual(len(receipts), 2, answers)
            nodes = {self.finished(receipt["job"])["node"] for receipt in receipts}
            self.assertEqual(nodes, set(self.nodes[:2]))
        self.assertEqual([world.fixture.pulses(name) for name in self.nodes], [18, 18, 0])

    def test_a_put_makes_a_job_for_each(self):
        job = fresh()
        put_job(f"{self.word}-$*", a_job(move(9), id=job))

        def find(samples):
            done = {s[3]["node"]: s[3] for s in samples if s[3]["state"] == "succeeded"}
            return done if set(self.nodes) <= set(done) else None

        world.jobs.wait("a job for each", find)
        self.assertEqual([world.fixture.pulses(name) for name in self.nodes], [9, 9, 9])

    def test_an_id_is_idempotent_on_a_wild_key_too(self):
        job = fresh()
        text = json.dumps(a_job(move(9), id=job))
        first = get(f"fleet/node/{self.word}-$*/job", text, JSON)
        for _, receipt in first:
            self.finished(receipt["job"])
        again = get(f"fleet/node/{self.word}-$*/job", text, JSON)
        self.assertEqual({r["job"] for _, r in again}, {r["job"] for _, r in first})
        self.assertEqual({r["state"] for _, r in again}, {"succeeded"})
        self.assertEqual([world.fixture.pulses(name) for name in self.nodes], [9, 9, 9])

    def test_a_node_that_is_away_gets_none(self):
        down(self.nodes[0])
        answers = get(f"fleet/node/{self.word}-a-$*/job", json.dumps(a_job(move(9))), JSON)
        self.assertEqual(len(answers), 1, answers)
        self.assertEqual(self.finished(answers[0][1]["job"])["node"], self.nodes[1])

    def test_the_star_alone_means_every_node(self):
        with_all = get("fleet/node/*/job", json.dumps(a_job({"lidar_read": {}})), JSON)
        nodes = {self.finished(receipt["job"])["node"] for _, receipt in with_all}
        alive = {value["node"] for _, value in get("fleet/node/*/state") if value["alive"]}
        self.assertEqual(nodes, alive)
        self.assertLessEqual(set(self.nodes), nodes)

    def test_no_matching_node_is_an_error(self):
        with self.assertRaises(Refused) as caught:
            get("fleet/node/nothing-$*/job", json.dumps(a_job()), JSON)
        self.assertEqual(caught.exception.code, "unknown_node")
        job = fresh()
        put_job("nothing-$*", a_job(id=job))
        found = self.finished(job, "rejected")
        self.assertEqual((found["node"], found["error"]["code"]), (None, "unknown_node"))

    def test_one_stop_stops_all_that_match_and_no_other(self):
        jobs = [submit(name, a_job(lasting(FOREVER_S)))["job"] for name in self.nodes]
        for job in jobs:
            job_until(job, "running")
        put(f"fleet/node/{self.word}-a-$*/stop")
        for name, job in zip(self.nodes[:2], jobs[:2]):
            self.assertEqual(self.finished(job, "failed")["error"]["code"], "stopped")
            node_in(name, "stopped")
        self.assertEqual(node_record(self.nodes[2])["state"], "running")
        put("fleet/node/*/stop")
        self.finished(jobs[2], "failed")
        node_in(self.nodes[2], "stopped")
        for name in self.nodes:
            release(name)


class Records(Case):
    """What is said about a job."""

    @classmethod
    def setUpClass(cls):
        cls.node = up(fresh("rec"))

    @classmethod
    def tearDownClass(cls):
        down(cls.node)

    def test_a_job_goes_from_queued_to_sent_to_running_to_succeeded(self):
        node = self.new_node("path")
        job = fresh()
        submit(node, a_job(move(100), lasting(0.3), move(-5), id=job))
        last = self.finished(job)
        states = [value["state"] for value in records_of(job)]
        way = list(dict.fromkeys(states))
        # That it ran is told by the node while it does; one that is late tells the end only.
        self.assertIn(
            way, [["queued", "sent", "running", "succeeded"], ["queued", "sent", "succeeded"]]
        )
        self.assertEqual([value["version"] for value in records_of(job)],
                         list(range(1, len(states) + 1)))
        self.assertEqual(last["node"], node)
        self.assertIsNone(last["error"])
        self.assertIsNone(last["group"])
        self.assertIsNone(last["parts"])
        self.assertEqual(last["result"]["position"], [695, 0])
        self.assertEqual(record(job), last)

    def test_succeeded_means_that_the_last_pulse_has_left_the_pin(self):
        node = self.new_node("pulse")
        for _ in range(5):
            before = world.fixture.pulses(node)
            job = submit(node, a_job(lasting(0.02), move(1), move(30, 50)))["job"]
            self.finished(job)
            self.assertEqual(world.fixture.pulses(node), before + 71)
            self.assertEqual(world.fixture.pulses(node), record(job)["result"]["position"][0])

    def test_progress_counts_commands(self):
        node = self.new_node("prog")
        job = fresh()
        submit(node, a_job(*[move(10)] * 5, id=job))
        self.assertEqual(self.finished(job)["progress"], {"done": 5, "total": 5})
        done = [value["progress"]["done"] for value in records_of(job)]
        self.assertEqual(done, sorted(done))
        self.assertEqual(done[0], 0)

    def test_progress_is_told_while_a_job_runs(self):
        node = self.new_node("told")
        job = fresh()
        submit(node, a_job(*[move(10)] * 3, lasting(FOREVER_S), move(10), id=job))

        def find(samples):
            values = [value for _, _, _, value in samples]
            return [v for v in values if v["state"] == "running" and v["progress"]["done"] == 3]

        told = world.jobs.wait("three of five", find, f"fleet/job/{job}")
        self.assertEqual(told[0]["progress"]["total"], 5)
        get(f"fleet/job/{job}/cancel")
        self.assertEqual(self.finished(job, "canceled")["progress"], {"done": 3, "total": 5})

    def test_jobs_of_one_node_run_one_behind_the_other_in_their_order(self):
        node = self.new_node("order")
        jobs = [submit(node, a_job(move(20)))["job"] for _ in range(8)]
        self.finished(jobs[-1])
        ends = [self.finished(job)["updated"] for job in jobs]
        self.assertEqual(ends, sorted(ends))
        positions = [self.finished(job)["result"]["position"][0] for job in jobs]
        self.assertEqual(positions, [20 * n for n in range(1, 9)])

    def test_a_job_that_nobody_knows_is_an_error(self):
        for name in ["never-was", "NOT-A-NAME"]:
            with self.assertRaises(Refused):
                get(f"fleet/job/{name}")

    def test_all_records_are_given_newest_first(self):
        jobs = [submit(self.node, a_job())["job"] for _ in range(5)]
        self.finished(jobs[-1])
        answers = get("fleet/job/*?limit=5")
        self.assertEqual([value["job"] for _, value in answers], jobs[::-1])
        for key, value in answers:
            self.assertEqual(key, f"fleet/job/{value['job']}")
        created = [value["created"] for _, value in get("fleet/job/*")]
        self.assertEqual(created, sorted(created, reverse=True))

    def test_the_limit_is_a_hundred_unless_said_and_a_thousand_at_most(self):
        word = fresh("bulk")
        count = 1_010
        for number in range(count):
            put_job("nobody", a_job(id=f"{word}-{number}"))
        job_until(f"{word}-{count - 1}", "rejected")
        self.assertEqual(len(get("fleet/job/*")), 100)
        for limit in [1, 7, 101, 1000]:
            answers = get(f"fleet/job/{word}-$*?limit={limit}")
            newest = [f"{word}-{count - 1 - number}" for number in range(limit)]
            self.assertEqual([value["job"] for _, value in answers], newest)
        for limit in [1001, 5000, 2**32, 2**63]:
            self.assertEqual(len(get(f"fleet/job/*?limit={limit}")), 1000)
        for limit in ["0", "-1", "x", "", "1.5"]:
            with self.assertRaises(Refused, msg=limit):
                get(f"fleet/job/*?limit={limit}")

    def test_records_can_be_asked_for_by_state_and_node(self):
        node = self.new_node("ask")
        good = [submit(node, a_job())["job"] for _ in range(3)]
        self.finished(good[-1])
        bad = fresh()
        put_job(node, a_job(move(0), id=bad))
        self.finished(bad, "rejected")

        def names(parameters):
            return [value["job"] for _, value in get(f"fleet/job/*?{parameters}")]

        self.assertEqual(names(f"node={node}"), [bad, *good[::-1]])
        self.assertEqual(names(f"node={node};state=succeeded"), good[::-1])
        self.assertEqual(names(f"state=succeeded;node={node};limit=2"), good[:0:-1])
        self.assertEqual(names(f"node={node};state=rejected"), [bad])
        self.assertEqual(names(f"node={node};state=lost"), [])
        self.assertEqual(names("node=never-seen"), [])
        for _, value in get("fleet/job/*?state=rejected"):
            self.assertEqual(value["state"], "rejected")
        for wrong in ["state=done", "state=", "node=A", "status=failed", "Limit=5"]:
            with self.assertRaises(Refused, msg=wrong):
                names(wrong)

    def test_times_are_utc_with_microseconds(self):
        before = datetime.datetime.now(datetime.timezone.utc)
        job = submit(self.node, a_job(lasting(0.01)))["job"]
        last = self.finished(job)
        after = datetime.datetime.now(datetime.timezone.utc)
        created, updated = utc(last["created"]), utc(last["updated"])
        # The two programs read the same clock, one of them at its start.
        slack = datetime.timedelta(seconds=1)
        self.assertLess(before - slack, created)
        self.assertLess(created, updated)
        self.assertLess(updated, after + slack)

    def test_puts_on_a_record_or_a_delete_change_nothing(self):
        job = submit(self.node, a_job())["job"]
        last = self.finished(job)
        world.session.delete(f"fleet/node/{self.node}/job")
        world.session.delete(f"fleet/job/{job}/cancel")
        self.finished(submit(self.node, a_job())["job"])
        self.assertEqual(record(job), last)


class Cancel(Case):
    """A cancel ends a job and leaves the node ready for the next one."""

    def test_a_waiting_job_is_canceled_at_once(self):
        node = self.new_node("cq")
        first = submit(node, a_job(lasting(FOREVER_S)))["job"]
        job_until(first, "running")
        second, third = fresh(), fresh()
        submit(node, a_job(move(7), id=second))
        submit(node, a_job(move(7), id=third))
        answer = get_one(f"fleet/job/{second}/cancel")
        self.assertEqual((answer["job"], answer["state"]), (second, "canceled"))
        put(f"fleet/job/{third}/cancel")
        found = self.finished(third, "canceled")
        self.assertEqual(found["progress"], {"done": 0, "total": 1})
        # The one that runs is not touched.
        self.assertEqual(record(first)["state"], "running")
        put(f"fleet/job/{first}/cancel")
        at_rest = self.finished(first, "canceled")["result"]["position"][0]
        self.finished(submit(node, a_job(move(1)))["job"])
        self.assertEqual(world.fixture.pulses(node), at_rest + 1)

    def test_a_running_job_is_running_until_its_last_pulse(self):
        node = self.new_node("cr")
        for end in (get_one, put):
            job = submit(node, a_job(move(10), lasting(FOREVER_S), move(10)))["job"]
            job_until(job, "running")
            end(f"fleet/job/{job}/cancel")
            found = self.finished(job, "canceled")
            at_rest = world.fixture.pulses(node)
            self.assertEqual(found["result"]["position"], [at_rest, 0])
            self.assertEqual(found["progress"]["total"], 3)
            self.assertLess(found["progress"]["done"], 3)
            states = list(dict.fromkeys(value["state"] for value in records_of(job)))
            self.assertEqual(states, ["queued", "sent", "running", "canceled"])
            # No latch, no rest of the job, and the next one begins where this one ended.
            found = node_in(node, "idle")
            self.assertIsNone(found["stopped"])
            self.assertIsNone(found["job"])
            following = submit(node, a_job(move(5)))["job"]
            self.assertEqual(self.finished(following)["result"]["position"], [at_rest + 5, 0])
            self.assertEqual(world.fixture.pulses(node), at_rest + 5)

    def test_a_slow_move_is_not_waited_for(self):
        node = self.new_node("cs")
        # An hour from step to step: the last pulse of a canceled job is the one before.
        job = submit(node, a_job(move(5, 3_600_000_000)))["job"]
        node_until(node, "moving", lambda found: found["position"] == [1, 0])
        put(f"fleet/job/{job}/cancel")
        self.assertEqual(self.finished(job, "canceled")["result"]["position"], [1, 0])
        self.assertEqual(world.fixture.pulses(node), 1)

    def test_a_job_that_is_over_stays_as_it_is(self):
        node = self.new_node("cf")
        done = submit(node, a_job())["job"]
        rejected = fresh()
        put_job(node, a_job(move(0), id=rejected))
        for job in (done, rejected):
            last = ended(job)
            answer = get_one(f"fleet/job/{job}/cancel")
            self.assertEqual(answer["state"], last["state"])
            put(f"fleet/job/{job}/cancel")
            self.finished(submit(node, a_job())["job"])
            self.assertEqual(record(job), last)

    def test_a_job_that_nobody_knows_cannot_be_canceled(self):
        with self.assertRaises(Refused):
            get("fleet/job/never-was/cancel")

    def test_canceling_twice_is_as_canceling_once(self):
        node = self.new_node("ct")
        job = submit(node, a_job(lasting(FOREVER_S)))["job"]
        job_until(job, "running")
        for _ in range(10):
            put(f"fleet/job/{job}/cancel")
        get_one(f"fleet/job/{job}/cancel")
        self.finished(job, "canceled")
        after = submit(node, a_job(move(5)))["job"]
        self.finished(after)


class Stop(Case):
    """A stop is heard at once; until the release a stopped node refuses commands."""

    def stopped_while_running(self, payload):
        node = self.new_node("st")
        before = datetime.datetime.now(datetime.timezone.utc)
        job = submit(node, a_job(lasting(FOREVER_S), move(5)))["job"]
        waiting = submit(node, a_job(move(5)))["job"]
        job_until(job, "running")
        put(f"fleet/node/{node}/stop", payload)
        found = self.finished(job, "failed")
        self.assertEqual(found["error"]["code"], "stopped")
        at_rest = world.fixture.pulses(node)
        self.assertEqual(found["result"]["position"], [at_rest, 0])
        state = node_until(node, "stopped", lambda found: found["stopped"])
        self.assertEqual(state["state"], "stopped")
        self.assertEqual(state["stopped"]["reason"], "client")
        at = utc(state["stopped"]["at"])
        slack = datetime.timedelta(seconds=1)
        self.assertLess(before - slack, at)
        self.assertLess(at, datetime.datetime.now(datetime.timezone.utc) + slack)
        self.assertEqual(state["position"], [at_rest, 0])
        self.assertEqual(state["queue"]["depth"], 0)
        self.assertIsNone(state["job"])

        self.refused("stopped", node, a_job(move(5)))
        name = fresh()
        put_job(node, a_job(move(5), id=name))
        self.assertEqual(self.finished(name, "rejected")["error"]["code"], "stopped")

        self.assertEqual(release(node)["state"], "idle")
        self.assertIsNone(node_record(node)["stopped"])
        # Nothing that came before the stop moves after the release.
        self.assertIn(ended(waiting)["state"], ("failed", "canceled"))
        following = submit(node, a_job(move(5)))["job"]
        self.assertEqual(self.finished(following)["result"]["position"], [at_rest + 5, 0])
        self.assertEqual(world.fixture.pulses(node), at_rest + 5)

    def test_an_empty_stop_halts(self):
        self.stopped_while_running(b"")

    def test_a_stop_halts(self):
        self.stopped_while_running('{"mode":"halt"}')

    def test_a_stop_decelerates(self):
        self.stopped_while_running('{ "mode": "decelerate" }')

    def test_a_stop_that_cannot_be_read_is_a_stop(self):
        self.stopped_while_running(b"\xff{")

    def test_a_node_at_rest_is_stopped_too_and_a_put_releases_it(self):
        node = self.new_node("si")
        put(f"fleet/node/{node}/stop")
        found = node_until(node, "stopped", lambda found: found["stopped"])
        self.assertEqual((found["state"], found["stopped"]["reason"]), ("stopped", "client"))
        self.refused("stopped", node, a_job())
        # Again, while it is stopped.
        put(f"fleet/node/{node}/stop")
        put(f"fleet/node/{node}/release")
        found = node_in(node, "idle")
        self.assertIsNone(found["stopped"])
        self.finished(submit(node, a_job())["job"])

    def test_a_release_is_not_overtaken_by_the_stop_before_it(self):
        node = self.new_node("so")
        for _ in range(50):
            put(f"fleet/node/{node}/stop")
            node_until(node, "stopped", lambda found: found["stopped"])
            put(f"fleet/node/{node}/stop")
            put(f"fleet/node/{node}/release")
            node_in(node, "idle")
            self.finished(submit(node, a_job(move(1)))["job"])
        self.assertEqual(world.fixture.pulses(node), 50)

    def test_a_node_that_is_not_stopped_may_be_released(self):
        node = self.new_node("sr")
        job = submit(node, a_job(lasting(0.2)))["job"]
        self.assertEqual(get_one(f"fleet/node/{node}/release")["node"], node)
        self.finished(job)

    def test_what_is_not_there_cannot_be_released(self):
        with self.assertRaises(Refused) as caught:
            get("fleet/node/nobody/release")
        self.assertEqual(caught.exception.code, "unknown_node")
        node = self.new_node("sa")
        down(node)
        with self.assertRaises(Refused) as caught:
            get(f"fleet/node/{node}/release")
        self.assertEqual(caught.exception.code, "node_offline")

    def test_the_stop_input_stops_and_holds(self):
        node = self.new_node("sp")
        job = submit(node, a_job(lasting(FOREVER_S)))["job"]
        job_until(job, "running")
        world.fixture("pin", node, "true")
        found = self.finished(job, "failed")
        self.assertEqual(found["error"]["code"], "stopped")
        self.assertEqual(found["result"]["position"][0], world.fixture.pulses(node))
        state = node_until(node, "stopped", lambda found: found["stopped"])
        self.assertEqual((state["state"], state["stopped"]["reason"]), ("stopped", "pin"))
        with self.assertRaises(Refused):
            get(f"fleet/node/{node}/release")
        self.refused("stopped", node, a_job())
        world.fixture("pin", node, "false")
        release(node)
        self.finished(submit(node, a_job())["job"])

    def test_a_wild_release_is_answered_by_each(self):
        word = fresh("sw")
        for name in (f"{word}-1", f"{word}-2"):
            up(name)
            self.addCleanup(self.switch_off, name)
        put(f"fleet/node/{word}-$*/stop")
        for name in (f"{word}-1", f"{word}-2"):
            node_in(name, "stopped")
        answers = get(f"fleet/node/{word}-$*/release")
        self.assertEqual({value["node"] for _, value in answers}, {f"{word}-1", f"{word}-2"})
        self.assertEqual({value["state"] for _, value in answers}, {"idle"})

    def test_a_job_behind_a_stop_never_moves_anything(self):
        node = self.new_node("race")
        for _ in range(10):
            put(f"fleet/node/{node}/stop")
            try:
                job = submit(node, a_job(move(50)))["job"]
            except Refused as refusal:
                self.assertEqual(refusal.code, "stopped")
            else:
                self.assertEqual(ended(job)["state"], "failed")
            node_in(node, "stopped")
            release(node)
        self.assertEqual(world.fixture.pulses(node), 0)


class TimeLimit(Case):
    """`timeout_s` limits a job from its first command sent to its last pulse."""

    def test_a_job_that_takes_too_long_is_stopped_without_a_latch(self):
        node = self.new_node("tl")
        job = submit(node, a_job(lasting(FOREVER_S), timeout_s=0.25))["job"]
        found = self.finished(job, "timed_out")
        at_rest = world.fixture.pulses(node)
        self.assertEqual(found["result"]["position"], [at_rest, 0])
        lasted = utc(found["updated"]) - utc(found["created"])
        self.assertGreaterEqual(lasted.total_seconds(), 0.25)
        state = node_in(node, "idle")
        self.assertIsNone(state["stopped"])
        following = submit(node, a_job(move(5), timeout_s=FOREVER_S))["job"]
        self.assertEqual(self.finished(following)["result"]["position"], [at_rest + 5, 0])

    def test_the_time_in_the_queue_does_not_count(self):
        node = self.new_node("tq")
        submit(node, a_job(lasting(2.1)))
        job = submit(node, a_job(move(5), timeout_s=2))["job"]
        found = ended(job)
        if found["state"] == "timed_out":
            # So busy is the machine; the limit counted from the first command sent all the same.
            sent = utc(job_until(job, "sent")["updated"])
            self.assertGreaterEqual((utc(found["updated"]) - sent).total_seconds(), 2)
        else:
            self.assertEqual(found["state"], "succeeded", found)

    def test_whole_and_broken_numbers_are_limits(self):
        node = self.new_node("tn")
        for limit in [60, 3_600, 3_599.5, 1e9, 1e300]:
            self.finished(submit(node, a_job(timeout_s=limit))["job"])


class Offline(Case):
    """A job for a node that is away waits for it, unless it says otherwise."""

    def test_a_job_waits_for_its_node(self):
        node = self.new_node("off")
        down(node)
        jobs = [fresh(), fresh()]
        self.assertEqual(submit(node, a_job(move(5), id=jobs[0]))["state"], "queued")
        put_job(node, a_job(move(6), id=jobs[1], offline="queue"))
        job_until(jobs[1], "queued")
        self.assertEqual([record(job)["state"] for job in jobs], ["queued", "queued"])
        up(node)
        for job in jobs:
            self.finished(job)
        self.assertEqual(world.fixture.pulses(node), 11)

    def test_a_job_may_ask_to_be_refused_instead(self):
        node = self.new_node("rej")
        running = submit(node, a_job(offline="reject"))["job"]
        self.finished(running)
        down(node)
        self.refused("node_offline", node, a_job(offline="reject"))
        job = fresh()
        put_job(node, a_job(id=job, offline="reject"))
        self.assertEqual(self.finished(job, "rejected")["error"]["code"], "node_offline")
        with self.assertRaises(Refused) as caught:
            get(f"fleet/node/{node[:-1]}$*/job", json.dumps(a_job(offline="reject")), JSON)
        self.assertEqual(caught.exception.code, "node_offline")

    def test_a_wrong_job_is_refused_although_its_node_is_away(self):
        node = self.new_node("wrong")
        down(node)
        self.refused("bad_command", node, a_job(move(1, axis=2)))
        home = {"home": {"axis": 0}}
        self.refused("bad_command", node, a_job(home), "has no reference switch")

    def test_a_waiting_job_can_be_canceled_while_its_node_is_away(self):
        node = self.new_node("cx")
        down(node)
        job = submit(node, a_job(move(5)))["job"]
        self.assertEqual(get_one(f"fleet/job/{job}/cancel")["state"], "canceled")
        up(node)
        self.finished(submit(node, a_job(move(2)))["job"])
        self.assertEqual(world.fixture.pulses(node), 2)


class Lost(Case):
    """A job whose node is gone is lost, and never tried again by itself."""

    def test_a_node_that_returns_with_an_empty_memory_ends_the_job(self):
        node = self.new_node("lo")
        job = submit(node, a_job(move(5), lasting(FOREVER_S)))["job"]
        job_until(job, "running")
        down(node)
        self.assertEqual(job_until(job, "lost")["state"], "lost")
        self.assertEqual(record(job)["state"], "lost")
        waiting = submit(node, a_job(move(3)))["job"]
        up(node)
        found = self.finished(job, "failed")
        self.assertIsNotNone(found["error"])
        self.finished(waiting)
        # It was not retried: only the job that waited has moved the new life of the node.
        self.assertEqual(world.fixture.pulses(node), 3)

    def test_a_lost_job_can_be_canceled(self):
        node = self.new_node("lc")
        job = submit(node, a_job(lasting(FOREVER_S)))["job"]
        job_until(job, "running")
        down(node)
        job_until(job, "lost")
        self.assertEqual(get_one(f"fleet/job/{job}/cancel")["state"], "canceled")
        last = record(job)
        up(node)
        self.finished(submit(node, a_job(move(2)))["job"])
        self.assertEqual(record(job), last)
        self.assertEqual(world.fixture.pulses(node), 2)

    def test_a_power_cut_in_the_middle_fails_the_job_and_leaves_a_line_in_the_log(self):
        node = self.new_node("cut")
        log = Heard(world.session, f"fleet/node/{node}/log", read_bytes)
        self.addCleanup(log.end)
        settle(world.session)
        job = submit(node, a_job(lasting(FOREVER_S)))["job"]
        job_until(job, "running")
        world.fixture("cut", node)
        self.finished(job, "failed")
        _, _, _, line = log.wait("a line", lambda samples: samples and samples[-1])
        text = line.decode("utf-8")
        self.assertTrue(text.strip())
        self.assertNotIn("\n", text.rstrip("\n"))
        found = node_until(node, "back", lambda found: found["alive"])
        self.assertEqual(found["position"], [0, 0])
        self.finished(submit(node, a_job(move(4)))["job"])


class Nodes(Case):
    """What is said about a node."""

    def test_the_record_of_a_node_at_rest(self):
        node = self.new_node("rest")
        found = node_until(node, "locked", lambda found: found["clock"])
        self.assertEqual(set(found), NODE_FIELDS)
        self.assertEqual(found["node"], node)
        self.assertIs(found["alive"], True)
        self.assertEqual(found["state"], "idle")
        self.assertEqual(found["position"], [0, 0])
        self.assertEqual(set(found["queue"]), {"depth", "free"})
        self.assertEqual(found["queue"]["depth"], 0)
        self.assertGreater(found["queue"]["free"], 0)
        self.assertIsNone(found["job"])
        self.assertIsNone(found["stopped"])
        self.assertEqual(set(found["clock"]), {"offset_us", "error_us", "drift_ppm"})
        self.assertGreater(found["clock"]["error_us"], 0)
        self.assertRegex(found["firmware"], r"^\d+\.\d+\.\d+$")
        self.assertIsInstance(found["uptime_s"], int)
        self.assertIsNone(found["rssi_dbm"])
        self.assertEqual(found["faults"], [])

    def test_the_record_of_a_node_that_moves(self):
        node = self.new_node("busy")
        job = submit(node, a_job(lasting(FOREVER_S), move(1), move(1)))["job"]
        found = node_until(node, "moving", lambda found: found["position"][0] > 100)
        self.assertEqual((found["state"], found["job"]), ("running", job))
        self.assertEqual(found["queue"]["depth"], 3)
        later = node_until(node, "on", lambda now: now["position"][0] > found["position"][0])
        self.assertLessEqual(later["position"][0], world.fixture.pulses(node))
        get(f"fleet/job/{job}/cancel")
        self.finished(job, "canceled")

    def test_a_node_that_is_away_is_offline_and_keeps_its_place(self):
        node = self.new_node("away")
        self.finished(submit(node, a_job(move(33)))["job"])
        down(node)
        found = node_record(node)
        self.assertEqual((found["alive"], found["state"]), (False, "offline"))
        self.assertEqual(found["position"], [33, 0])
        self.assertIsNone(found["job"])
        world.nodes.wait(
            "offline",
            lambda samples: any(
                key == f"fleet/node/{node}/state" and value["state"] == "offline"
                for _, key, _, value in samples
            ),
        )

    def test_every_node_answers_a_wild_get(self):
        nodes = {self.new_node("wild"), self.new_node("wild")}
        answers = get("fleet/node/*/state")
        self.assertLessEqual(nodes, {value["node"] for _, value in answers})
        for key, value in answers:
            self.assertEqual(key, f"fleet/node/{value['node']}/state")

    def test_a_node_that_was_never_seen_has_no_record(self):
        with self.assertRaises(Refused) as caught:
            get("fleet/node/nobody/state")
        self.assertEqual(caught.exception.code, "unknown_node")

    def test_states_are_put_on_change_and_at_most_twenty_a_second(self):
        node = self.new_node("rate")
        status = Heard(world.session, f"fleet/node/{node}/status", read_bytes)
        self.addCleanup(status.end)
        settle(world.session)
        key = f"fleet/node/{node}/state"
        asked = time.monotonic()
        # The position changes all the time, and so does the queue while it is filled.
        job = submit(node, a_job(*[lasting(0.1), lasting(-0.1)] * 3_000))["job"]

        def find(samples):
            # From the first one that knows of the job: it was put after that was asked for.
            first = next((n for n, sample in enumerate(samples) if sample[3]["job"] == job), None)
            states = [] if first is None else samples[first:]
            return states if len(states) >= 20 else None

        states = world.nodes.wait("twenty states", find, key)
        seconds = states[-1][0] - asked
        # One more stands at the other end of the interval.
        self.assertLessEqual(len(states), 20 * seconds + 1)
        for (_, _, _, before), (_, _, _, after) in itertools.pairwise(states):
            self.assertNotEqual(before, after)
        get(f"fleet/job/{job}/cancel")
        self.finished(job, "canceled")

        def at_rest(samples):
            last = samples[-1][3]
            return last["state"] == "idle" and last["queue"]["depth"] == 0

        world.nodes.wait("the node at rest again", at_rest, key)
        # Statuses came all the time, whoever else was busy.
        said = status.wait("five statuses", lambda samples: len(samples) >= 5 and list(samples))
        for _, _, encoding, payload in said:
            self.assertEqual(encoding.split(";")[0], "application/octet-stream")
            self.assertEqual(payload[0], 1, "the version")

    def test_the_liveliness_token_comes_and_goes_with_the_node(self):
        node = fresh("token")
        key = f"fleet/node/{node}/alive"
        tokens = Heard(world.session.liveliness(), key, lambda sample: sample.kind)
        self.addCleanup(tokens.end)
        # There is no history: a token that comes before the subscription is never told.
        settle(world.session)
        self.addCleanup(self.switch_off, node)
        up(node)
        tokens.wait("the token", lambda samples: len(samples) >= 1)
        replies = world.session.liveliness().get("fleet/node/*/alive", timeout=PATIENCE_S)
        self.assertIn(key, [str(reply.ok.key_expr) for reply in replies])
        down(node)
        gone = zenoh.SampleKind.DELETE
        tokens.wait("its end", lambda samples: samples[-1][3] == gone)
        # A router may say more than once that a token is there.
        kinds = [kind for kind, _ in itertools.groupby(value for _, _, _, value in tokens.all())]
        self.assertEqual(kinds, [zenoh.SampleKind.PUT, gone])


class WideKeys(Case):
    """A key that merely includes the fleet's moves nothing."""

    def test_a_tool_that_looks_at_everything_changes_nothing(self):
        node = self.new_node("look")
        job = submit(node, a_job(lasting(0.3)))["job"]
        before = len(world.jobs.all())
        for selector in ["fleet/**", "**", "fleet/node/**", "fleet/job/**", f"fleet/node/{node}/*"]:
            with contextlib.suppress(Refused):
                get(selector)
        self.finished(job)
        # A last word about an older job may still be under way.
        new = [s[3] for s in world.jobs.all()[before:] if s[3]["version"] == 1]
        self.assertEqual({value["job"] for value in new} - {job}, set())
        self.assertEqual(node_in(node, "idle")["stopped"], None)


class TheRestart(Case):
    """A gateway that ends and comes back has forgotten nothing."""

    def test_jobs_go_on_and_ids_are_known(self):
        node = self.new_node("re")
        away = self.new_node("re")
        down(away)
        old = submit(node, a_job(move(1)))["job"]
        self.finished(old)
        running = submit(node, a_job(lasting(1.5), move(7)))["job"]
        waiting = submit(node, a_job(move(11)))["job"]
        offline = submit(away, a_job(move(13)))["job"]
        # On a busy machine it is over before it is heard to run.
        job_until(running, "running", *FINAL)
        world.unheard |= {f"fleet/job/{job}" for job in (running, waiting, offline)}
        world.fixture("restart")
        deadline = time.monotonic() + PATIENCE_S
        answers = []
        while not answers:
            self.assertLess(time.monotonic(), deadline)
            # The session connects again by itself.
            with contextlib.suppress(TimeoutError):
                answers = get(f"fleet/job/{old}", timeout=5)
        self.assertEqual(answers[0][1]["state"], "succeeded")
        self.assertEqual(submit(node, a_job(id=old)), {"job": old, "state": "succeeded"})
        self.assertEqual(record(offline)["state"], "queued")
        for job in (running, waiting):
            while record(job)["state"] not in FINAL:
                self.assertLess(time.monotonic(), deadline)
            self.assertEqual(record(job)["state"], "succeeded", record(job))
        self.assertEqual(world.fixture.pulses(node), 1 + 3000 + 7 + 11)
        up(away)
        while record(offline)["state"] not in FINAL:
            self.assertLess(time.monotonic(), deadline)
        self.assertEqual(world.fixture.pulses(away), 13)


def clock_is_known(node):
    return node_until(
        node, "known", lambda found: found["clock"] and found["clock"]["error_us"] < 20_000
    )


class Together(Case):
    """A synchronized job starts on all its nodes at one instant, or on none."""

    def several(self, count):
        nodes = [self.new_node(word) for word in ("left", "right", "front")[:count]]
        for node in nodes:
            clock_is_known(node)
        return nodes

    def pair(self):
        return self.several(2)

    def submit(self, nodes, *commands, **fields):
        parts = {node: {"commands": list(commands or [move(10)])} for node in nodes}
        return self.hand_in({"nodes": parts, "max_skew_us": 50_000, **fields})

    def hand_in(self, job):
        return get_one("fleet/group/g1/job", json.dumps(job), JSON)

    def started(self, *parts, until=(), hand_in=None):
        """Hands in a job for a node a part and waits for its end, or until its record says so.

        A machine that is busy for a quarter of a second is late for a start or a barrier. Then the
        job has failed, as the contract says: so once more, with other nodes.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            nodes = self.several(len(parts))
            job = {
                "id": fresh(),
                "nodes": dict(zip(nodes, parts)),
                "max_skew_us": 50_000,
                "ready_timeout_ms": PATIENCE_S * 1_000,
            }
            receipt = (hand_in or self.hand_in)(job)
            if receipt is not None:
                self.assertEqual(receipt, {"job": job["id"], "state": "queued"})
            found = job_until(job["id"], *until, *FINAL)
            late = found["error"] and found["error"]["code"] in ("node_offline", "not_allowed")
            if not late:
                return nodes, job, found
            self.assertLess(time.monotonic(), deadline, found)

    def refused_together(self, code, job, *places):
        with self.assertRaises(Refused, msg=job) as caught:
            get("fleet/group/g1/job", json.dumps(job), JSON)
        self.assertEqual(caught.exception.code, code, caught.exception)
        for place in places:
            self.assertIn(place, caught.exception.message)

    def test_two_nodes_start_and_the_record_says_how_far_apart(self):
        nodes, job, found = self.started(a_job(move(30), move(-10)), a_job(move(30), move(-10)))
        self.assertEqual(found["state"], "succeeded", found)
        self.assertEqual((found["node"], found["group"]), (None, "g1"))
        self.assertEqual(found["progress"], {"done": 4, "total": 4})
        self.assertEqual(set(found["parts"]), set(nodes))
        for part in found["parts"].values():
            self.assertEqual(part["state"], "succeeded")
            self.assertEqual(part["progress"], {"done": 2, "total": 2})
            self.assertEqual(part["result"]["position"], [20, 0])
            self.assertIsNone(part["error"])
        start = found["start"]
        self.assertEqual(
            set(start), {"planned", "skew_us", "by_node_us", "uncertainty_us"}, start
        )
        self.assertLess(utc(found["created"]), utc(start["planned"]))
        self.assertEqual(set(start["by_node_us"]), set(nodes))
        self.assertEqual(min(start["by_node_us"].values()), 0)
        self.assertEqual(max(start["by_node_us"].values()), start["skew_us"])
        self.assertGreater(start["uncertainty_us"], 0)
        for node in nodes:
            self.assertEqual(world.fixture.pulses(node), 20)
        # Once more is not twice.
        self.assertEqual(self.hand_in(job), {"job": job["id"], "state": "succeeded"})
        self.assertEqual(world.fixture.pulses(nodes[0]), 20)

    def test_by_put_too(self):
        def by_put(job):
            put("fleet/group/g2/job", json.dumps(job), JSON)

        _, _, found = self.started(a_job(move(5)), a_job(move(5)), hand_in=by_put)
        self.assertEqual((found["state"], found["group"]), ("succeeded", "g2"), found)

    def test_they_meet_at_barriers_and_end_together(self):
        meet = [{"barrier": {"name": name}} for name in ("one", "two")]
        (left, right), _, found = self.started(
            a_job(move(10), meet[0], move(10), meet[1], move(1)),
            a_job(lasting(0.5), meet[0], move(10), meet[1], move(2)),
        )
        self.assertEqual(found["state"], "succeeded", found)
        self.assertEqual(found["progress"], {"done": 10, "total": 10})
        self.assertEqual(found["parts"][left]["result"]["position"], [21, 0])
        self.assertEqual(found["parts"][right]["result"]["position"], [1012, 0])

    def test_three_nodes_draw_lines_together_and_meet(self):
        meet = {"barrier": {"name": "corner"}}
        parts = [
            a_job(
                line(300, 100 * number, jerk=2_000_000),
                line(300, 120 * number),
                meet,
                ramp(-50 * number, axis=1, linear_steps=20) if number else line(0, 7),
                ramp_to(number),
            )
            for number in range(3)
        ]
        nodes, _, found = self.started(*parts)
        self.assertEqual(found["state"], "succeeded", found)
        self.assertEqual(found["progress"], {"done": 15, "total": 15})
        self.assertEqual(set(found["start"]["by_node_us"]), set(nodes))
        for number, node in enumerate(nodes):
            expected = [number, 170 * number if number else 7]
            self.assertEqual(found["parts"][node]["result"]["position"], expected)
            pins = [world.fixture.pulses(node, axis) for axis in (0, 1)]
            self.assertEqual(pins, expected)

    def test_a_cancel_of_lines_on_three_nodes_leaves_exact_positions(self):
        way = [line(40, 10), line(30, 30), line(10, 40)] * 500
        part = a_job(*way, line(2**31 - 1, 2**31 - 1))
        nodes, job, found = self.started(part, part, part, until=("running",))
        self.assertEqual(found["state"], "running", found)
        for node in nodes:
            node_until(node, "moving", lambda found: found["position"][0] > 50)
        put(f"fleet/job/{job['id']}/cancel")
        found = self.finished(job["id"], "canceled")
        for node in nodes:
            pins = [world.fixture.pulses(node, axis) for axis in (0, 1)]
            self.assertEqual(found["parts"][node]["result"]["position"], pins)
            self.assertGreater(pins[0], 50)

    def test_no_node_moves_when_one_is_not_there(self):
        left, right = self.pair()
        down(right)
        job = fresh()
        self.submit([left, right], id=job)
        found = self.finished(job, "failed")
        self.assertEqual(found["error"]["code"], "node_offline")
        for node in (left, right):
            self.assertEqual(found["parts"][node]["error"]["code"], "node_offline")
        self.assertEqual(world.fixture.pulses(left), 0)

    def test_a_clock_that_is_not_known_well_enough_fails_the_job_before_anything_moves(self):
        nodes = self.pair()
        job = fresh()
        self.submit(nodes, id=job, max_skew_us=0.001, ready_timeout_ms=1_000)
        found = self.finished(job, "failed")
        self.assertEqual(set(found["parts"]), set(nodes))
        self.assertNotIn("start", found)
        for node in nodes:
            self.assertEqual(world.fixture.pulses(node), 0)

    def test_what_cannot_be_a_synchronized_job_is_refused_with_the_place(self):
        left, right = self.pair()
        good = a_job()
        two = {left: good, right: good}
        self.refused_together("unknown_node", {"nodes": {left: good, "nobody": good}}, "nobody")
        self.refused_together("bad_json", {})
        self.refused_together("bad_json", {"nodes": {}})
        self.refused_together("bad_json", {"nodes": two, "max_skew_us": 0}, "max_skew_us")
        self.refused_together("bad_json", {"nodes": two, "ready_timeout_ms": -1})
        self.refused_together("bad_json", {"nodes": two, "colour": 1}, "colour")
        bad = a_job(move(1), move(0))
        place = f"nodes.{right}.commands[1].move.steps"
        self.refused_together("bad_command", {"nodes": {left: good, right: bad}}, place)
        bad = a_job(line(1), line(1, 1, 1))
        place = f"nodes.{right}.commands[1].line.steps: "
        self.refused_together("bad_command", {"nodes": {left: good, right: bad}}, place)
        alone = a_job(move(1), {"barrier": {"name": "alone"}})
        self.refused_together(
            "bad_command", {"nodes": {left: good, right: alone}}, "commands[1].barrier"
        )

    def test_a_cancel_ends_all_parts(self):
        long = a_job(lasting(FOREVER_S))
        nodes, job, _ = self.started(long, long, until=["running"])
        put(f"fleet/job/{job['id']}/cancel")
        found = self.finished(job["id"], "canceled")
        for node in nodes:
            at_rest = world.fixture.pulses(node)
            self.assertEqual(found["parts"][node]["state"], "canceled")
            self.assertEqual(found["parts"][node]["result"]["position"], [at_rest, 0])

    def test_a_stop_of_one_stops_the_others(self):
        long = a_job(lasting(FOREVER_S))
        (left, right), job, _ = self.started(long, long, until=["running"])
        put(f"fleet/node/{left}/stop")
        found = self.finished(job["id"], "failed")
        self.assertEqual(found["parts"][left]["error"]["code"], "stopped")
        self.assertIn(found["parts"][right]["state"], ("canceled", "failed"))
        self.assertEqual(node_in(left, "stopped")["stopped"]["reason"], "client")
        self.assertEqual(node_in(right, "idle")["position"], [world.fixture.pulses(right), 0])


class ZAllThatWasHeard(Case):
    """Holds for every record that was put while the other tests ran; runs last."""

    def test_every_job_record_is_well_formed(self):
        last = {}
        for _, key, encoding, value in world.jobs.all():
            self.assertEqual(encoding, "application/json")
            self.assertEqual(set(value) - {"start"}, JOB_FIELDS, value)
            self.assertEqual(key, f"fleet/job/{value['job']}")
            self.assertRegex(value["job"], NAME)
            self.assertIn(value["state"], STATES)
            self.assertLessEqual(utc(value["created"]), utc(value["updated"]))
            progress = value["progress"]
            self.assertEqual(set(progress), {"done", "total"})
            self.assertLessEqual(0, progress["done"])
            self.assertLessEqual(progress["done"], progress["total"])
            if value["error"] is not None:
                self.assertEqual(set(value["error"]), {"code", "message"})
                self.assertIn(value["error"]["code"], CODES)
            if value["state"] in ("failed", "rejected"):
                self.assertIsNotNone(value["error"], value)
            if value["state"] == "succeeded":
                self.assertIsNone(value["error"])
                self.assertEqual(progress["done"], progress["total"])
                results = [value["result"]]
                if value["group"] is not None:
                    results = [part["result"] for part in value["parts"].values()]
                    self.assertIn("start", value)
                for result in results:
                    for position in result["position"]:
                        self.assertIs(type(position), int)
            if value["state"] not in FINAL:
                self.assertIsNone(value["result"], value)
            before = last.get(key)
            # A gateway that has come back says again what is true.
            if before is not None and before != value:
                if key in world.unheard:
                    self.assertGreater(value["version"], before["version"], (before, value))
                    last[key] = value
                    continue
                self.assertEqual(value["version"], before["version"] + 1, (before, value))
                # The whole may stay what it is while a part goes on.
                goes_on = value["group"] is not None and value["state"] == before["state"]
                if not goes_on:
                    self.assertIn(value["state"], NEXT[before["state"]], (before, value))
                self.assertLessEqual(before["updated"], value["updated"])
                if before["state"] != "rejected":
                    self.assertEqual(before["created"], value["created"])
                    self.assertLessEqual(before["progress"]["done"], progress["done"])
            elif before is None:
                self.assertEqual(value["version"], 1, value)
                self.assertIn(value["state"], ("queued", "rejected"))
            last[key] = value
        self.assertGreater(len(last), 1_000)

    def test_every_node_record_is_well_formed(self):
        heard = world.nodes.all()
        for _, key, encoding, value in heard:
            self.assertEqual(encoding, "application/json")
            self.assertEqual(set(value), NODE_FIELDS, value)
            self.assertEqual(key, f"fleet/node/{value['node']}/state")
            self.assertIn(value["state"], NODE_STATES)
            self.assertEqual(value["alive"], value["state"] != "offline")
            if value["stopped"] is not None:
                self.assertEqual(set(value["stopped"]), {"reason", "at"})
                self.assertIn(
                    value["stopped"]["reason"], ("client", "pin", "link", "fault", "limit")
                )
                utc(value["stopped"]["at"])
        # Some of each of the hundred nodes; of those that follow fast a busy machine drops some.
        self.assertGreater(len(heard), 100)


def main():
    global world
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--locator", required=True, help="the gateway's router, tcp/HOST:PORT")
    parser.add_argument("--control", required=True, help="the fixture, HOST:PORT")
    options, rest = parser.parse_known_args()
    world = World(options.locator, options.control)
    try:
        program = unittest.main(argv=[sys.argv[0], "--verbose", "--durations", "8", *rest]
                                if sys.version_info >= (3, 12)
                                else [sys.argv[0], "--verbose", *rest], exit=False)
    finally:
        world.end()
    sys.exit(not program.result.wasSuccessful())


if __name__ == "__main__":
    main()
