#!/usr/bin/python3
"""A room uses only the rooms that it may use: checks every include below a source tree against the table here.

usage: check_includes.py ROOT     (exit status 1 and a line for each violation)
"""

import re
import sys
from pathlib import Path

# Room: the rooms whose headers it may include, besides its own.
ROOMS = {
    "config": [],
    "brokers": ["config"],
    "discovery": ["config"],
    "drivers": ["brokers"],  # message.h only, see below
    "gateway": ["config", "brokers", "discovery", "drivers"],
    "master": ["config", "discovery", "gateway"],  # of the gateway: what Thrift generates, see below
    "topology": ["config", "brokers", "discovery"],
}
# A part of a room with rules of its own. `None`: everything.
PARTS = {
    "topology/local": None,
    "topology/runtime": ["config", "brokers"],
    "topology/endpoints": ["config", "brokers", "discovery"],
}
OUTSIDE = ("examples", "tests", "bench")  # users of the rooms
# Only these may name an implementation: its own folder, the factory, and who starts the in-process servers.
IMPLEMENTATIONS = {
    "brokers/embedded": ["brokers/make_broker.cc", "topology/local/"],
    "brokers/rabbitmq": ["brokers/make_broker.cc"],
    "discovery/embedded": ["discovery/registry.cc", "topology/local/"],
    "discovery/zookeeper": ["discovery/registry.cc"],
}
INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]')


def violation(file, included):
    """Why `file` (relative to the root) may not include `included`; None when it may."""
    if included.startswith("../") or "/../" in included:
        return "an include goes by way of the one include path: <iotcloud/...>"
    if not included.startswith("iotcloud/"):
        return None
    target = included.removeprefix("iotcloud/")
    room, target_room = file.split("/")[0], target.split("/")[0]
    for implementation, allowed in IMPLEMENTATIONS.items():
        if target.startswith(implementation + "/") and not file.startswith((implementation + "/", "tests/")):
            if not any(file.startswith(place) for place in allowed):
                return f"only {', '.join(allowed)} may name {implementation}/"
    if room in OUTSIDE or room == target_room:
        return None
    if target_room not in ROOMS:
        return f"{target_room}/ is no room that others may use"
    part = next((part for part in PARTS if file.startswith(part + "/")), None)
    allowed = PARTS[part] if part else ROOMS.get(room)
    if part and allowed is None:
        return None
    if allowed is None or target_room not in allowed:
        return f"{part or room}/ may use {', '.join(allowed or []) or 'no other room'}, not {target_room}/"
    sdk_only = room == "drivers" or (room == "topology" and not part)
    if sdk_only and target_room == "brokers" and target != "brokers/message.h":
        return f"{room}/ may use <iotcloud/brokers/message.h> only"
    if room == "master" and target_room == "gateway" and not re.search(r"gateway/(\w+_types|T\w+)\.h$", target):
        return "master/ may use the gateway's Thrift client only"
    return None


def check(root):
    problems = []
    for path in sorted(root.rglob("*")):
        file = path.relative_to(root).as_posix()
        if path.suffix not in (".h", ".cc") or file.startswith(("build/", ".")):
            continue
        lines = path.read_text().splitlines()
        if path.suffix == ".h" and "#pragma once" not in lines:
            problems.append(f"{file}:1: a header begins with #pragma once")
        for number, line in enumerate(lines, 1):
            include = INCLUDE.match(line)
            reason = violation(file, include.group(1)) if include else None
            if reason:
                problems.append(f"{file}:{number}: {include.group(1)}: {reason}")
    return problems


if __name__ == "__main__":
    found = check(Path(sys.argv[1]).resolve())
    print("\n".join(found) or "every include keeps the rooms apart")
    sys.exit(1 if found else 0)
