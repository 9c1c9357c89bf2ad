"""Starts two nodes at one instant and prints how far apart their first edges were.

    pip install eclipse-zenoh==1.10.2
    python start_together.py left right
"""

import json
import sys

import zenoh

nodes = sys.argv[1:] or ["node-1", "node-2"]
commands = [{"move": {"axis": 0, "delay_us": 500, "steps": 2000}}]
job = {"nodes": {node: {"commands": commands} for node in nodes}, "max_skew_us": 2000}

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
with zenoh.open(config) as session:
    changes = session.declare_subscriber("fleet/job/*")
    receipt = None
    for reply in session.get(
        "fleet/group/example/job", payload=json.dumps(job), encoding="application/json"
    ):
        if reply.err is not None:
            sys.exit(reply.err.payload.to_string())
        receipt = json.loads(reply.ok.payload.to_string())
    if receipt is None:
        sys.exit("no gateway answers")
    print(receipt)
    for change in changes:
        record = json.loads(change.payload.to_string())
        if record["job"] != receipt["job"]:
            continue
        print(record["state"], record["progress"])
        if record["state"] in ("succeeded", "failed", "canceled", "timed_out"):
            break
    print(json.dumps(record.get("start") or record["error"], indent=2))
