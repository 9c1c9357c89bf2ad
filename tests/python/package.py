"""The package of gateway/clients/python, installed by pip, against a running fleet."""

import argparse
import pathlib
import re
import socket
import subprocess
import sys
import time
import unittest
from datetime import datetime, timedelta, timezone

import stepfleet
from stepfleet import Fleet, NoGateway, Refused, TimedOut, line, move, pause, smooth_ramp, smooth_ramp_to

arguments = argparse.ArgumentParser()
arguments.add_argument("--locator", required=True)
arguments.add_argument("--control", required=True)
ARGUMENTS, REST = arguments.parse_known_args()


def control(text):
    """Asks the fixture for something that no client can do."""
    host, port = ARGUMENTS.control.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=60) as link:
        link.sendall(text.encode() + b"\n")
        answer = link.makefile().readline().strip()
    assert answer.startswith("ok"), answer


class Package(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.fleet = Fleet(ARGUMENTS.locator, timeout=60)
        for name in ("left", "right"):
            control(f"up {name} 2")
        deadline = time.monotonic() + 60
        alive = []
        while time.monotonic() < deadline:
            alive = [node.node for node in cls.fleet.nodes() if node.alive]
            if {"left", "right"} <= set(alive):
                return
        raise AssertionError(alive)

    @classmethod
    def tearDownClass(cls):
        cls.fleet.close()

    def test_it_is_typed_and_installed(self):
        from importlib.metadata import requires
        from importlib.resources import files

        self.assertEqual(requires("stepfleet"), ["eclipse-zenoh >=1.10.2,<2"])
        self.assertTrue(files(stepfleet).joinpath("py.typed").is_file())

    def test_a_job_is_followed_to_its_end(self):
        commands = [
            move(axis=0, delay_us=100, steps=500),
            pause(ms=1),
            line(steps=[100, -50], speed_hz=1000, accel=100_000),
            smooth_ramp(axis=0, steps=40, start_hz=200, speed_hz=2000, ramp_steps=15),
            smooth_ramp_to(axis=0, position=600, start_hz=200, speed_hz=2000, ramp_steps=15),
        ]
        receipt = self.fleet.submit("left", commands, id="py-1", timeout_s=60)
        self.assertEqual(receipt.job, "py-1")
        states = [record.state for record in self.fleet.follow("py-1", timeout=60)]
        self.assertEqual(states[-1], "succeeded")
        record = self.fleet.wait("py-1")
        self.assertEqual((record.progress.done, record.progress.total), (5, 5))
        self.assertEqual(len(record.result.position), 2)
        self.assertLessEqual(record.created, record.updated)
        self.assertEqual(self.fleet.submit("left", commands, id="py-1").state, "succeeded")
        steps = self.fleet.trace("py-1")
        self.assertEqual([state for _, state in steps][:2], ["queued", "sent"])
        self.assertIn("py-1", [job.job for job in self.fleet.jobs(node="left", limit=10)])

    def test_the_first_job_of_the_readme_runs_as_it_stands(self):
        readme = pathlib.Path(__file__).parents[2] / "README.md"
        (example,) = re.findall(r"```python\n(.*?)```", readme.read_text(), re.DOTALL)
        control("up node-1 2")
        deadline = time.monotonic() + 60
        while not any(node.node == "node-1" for node in self.fleet.nodes()):
            self.assertLess(time.monotonic(), deadline)
        example = example.replace("tcp/127.0.0.1:7447", ARGUMENTS.locator)
        ran = subprocess.run([sys.executable, "-c", example], capture_output=True, text=True)
        self.assertEqual(ran.returncode, 0, ran.stderr)
        self.assertIn('{"job":"hello-1","state":"queued"}', ran.stdout)
        self.assertEqual(self.fleet.wait("hello-1", 60).state, "succeeded")

    def test_the_example_in_the_packages_readme_runs_as_it_stands(self):
        here = pathlib.Path(__file__).parents[2] / "gateway" / "clients" / "python"
        text = (here / "README.md").read_text()
        (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        example = example.replace("tcp/127.0.0.1:7447", ARGUMENTS.locator)
        ran = subprocess.run([sys.executable, "-c", example], capture_output=True, text=True)
        self.assertEqual(ran.returncode, 0, ran.stderr)
        self.assertIn("succeeded", ran.stdout)

    def test_a_script_returns_a_value(self):
        receipt = self.fleet.submit("left", lua="return 6 * 7")
        self.assertEqual(self.fleet.wait(receipt.job, 60).result.returned, 42)

    def test_two_nodes_start_together(self):
        part = [move(axis=0, delay_us=100, steps=100)]
        receipt = self.fleet.submit_together({"left": part, "right": part}, max_skew_us=1_000_000)
        record = self.fleet.wait(receipt.job, 60)
        self.assertEqual(record.state, "succeeded", record.error)
        self.assertEqual(set(record.start.by_node_us), {"left", "right"})

    def test_labels_maintenance_and_times(self):
        self.fleet.label("right", ["py"])
        try:
            part = [move(axis=1, delay_us=100, steps=10)]
            receipts = self.fleet.submit_each("@py", part)
            self.assertEqual(self.fleet.wait(receipts[0].job, 60).node, "right")
            (right,) = self.fleet.maintenance("right", "new belt")
            self.assertEqual((right.labels, right.maintenance), (frozenset({"py"}), "new belt"))
            with self.assertRaises(Refused) as refused:
                self.fleet.submit("right", part)
            self.assertEqual(refused.exception.code, "not_allowed")
        finally:
            self.fleet.maintenance("right", None)
            self.fleet.label("right", remove=["py"])
        tomorrow = datetime.now(timezone.utc) + timedelta(days=1)
        late = self.fleet.submit("right", part, not_before=tomorrow)
        later = self.fleet.submit("right", part, not_before=tomorrow, when_idle=True)
        self.fleet.move(later.job, before=late.job)
        (right,) = self.fleet.arrangement("right")
        self.assertEqual(right.waiting, (later.job, late.job))
        with self.assertRaises(TimedOut):
            self.fleet.wait(late.job, timeout=0.01)
        for receipt in (late, later):
            self.assertEqual(self.fleet.cancel(receipt.job).state, "canceled")

    def test_what_cannot_be_is_refused_in_words(self):
        with self.assertRaises(Refused) as refused:
            self.fleet.submit("nobody", [pause(ms=1)])
        self.assertEqual(refused.exception.code, "unknown_node")
        with self.assertRaises(Refused) as refused:
            self.fleet.submit("left", [move(axis=0, delay_us=0, steps=1)])
        self.assertIn("commands[0].move.delay_us", refused.exception.message)
        with self.assertRaises(Refused) as refused:
            self.fleet.submit("left", gcode="G0 X1", id="g-1")
        self.assertIn("[node.left]", refused.exception.message)
        with self.assertRaises(Refused) as refused:
            self.fleet.submit("left", lua=" " * (80 << 20))
        self.assertEqual(refused.exception.code, "too_large")
        with self.assertRaises(ValueError):
            self.fleet.submit("left", [], lua="")
        with Fleet(ARGUMENTS.locator, prefix="other", timeout=60) as other:
            with self.assertRaises(NoGateway):
                other.nodes()

    def test_a_stop_and_a_release(self):
        receipt = self.fleet.submit("left", [move(axis=0, delay_us=1000, steps=1_000_000)])
        self.fleet.stop("left", decelerate=True)
        record = self.fleet.wait(receipt.job, 60)
        self.assertEqual((record.state, record.error.code), ("failed", "stopped"))
        (left,) = self.fleet.release("left")
        self.assertIsNone(left.stopped)


if __name__ == "__main__":
    unittest.main(argv=["package.py", *REST], verbosity=2)
