#!/usr/bin/python3
"""A room uses only the rooms that it may use, and few sources read heavy libraries: checks every include below a source
tree, and what the targets of its CMakeLists.txt name, against the tables here.

usage: check_includes.py ROOT     (exit status 1 and a line for each violation)
"""

import posixpath
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))
from project_files import project_files  # noqa: E402

# Room: the rooms that it may use, besides itself.
ROOMS = {
    "config": [],
    "security": ["config"],
    "rpc": ["config", "security"],
    "brokers": ["config"],
    "discovery": ["config"],
    "recording": ["brokers"],
    "drivers": ["brokers", "recording"],  # of brokers message.h only, see below
    "processes": ["config", "security"],
    "gateway": ["config", "security", "rpc", "brokers", "discovery", "drivers", "processes"],
    # of gateway and topology: what Thrift generates, see below
    "master": ["config", "security", "rpc", "discovery", "gateway", "topology"],
    "topology": ["config", "security", "rpc", "brokers", "discovery", "processes"],
    "check": ["config", "security", "brokers", "discovery", "drivers", "topology"],
}
# A part of a room with rules of its own. `None`: everything.
PARTS = {
    "drivers/testing": ["config", "brokers"],
    "topology/local": None,
    "topology/recorder": None,
    "topology/testing": None,
    "topology/runtime": ["config", "brokers"],
}
OUTSIDE = ("examples", "tests", "bench")  # users of the rooms
# A folder of a room: the room's folders that it may use, besides itself.
FOLDERS = {
    "topology/runtime/scheduling": [],
}
# Each folder of these rooms is an implementation, which only this factory may name, besides its own folder and tests,
FACTORIES = {"brokers": "brokers/make_broker.cc", "discovery": "discovery/registry.cc"}
# but for these folders, which all implementations use.
NO_IMPLEMENTATIONS = ("brokers/client", "brokers/spool", "discovery/client", "discovery/description",
                      "discovery/selection")
# Who may also name the servers that run in this process.
STARTERS = {"brokers/embedded": "topology/local/", "discovery/embedded": "topology/local/"}
THRIFT_FOR_MASTERS = re.compile(r"(gateway|topology/pool)/(\w+_types|T\w+Service)\.h$")
# A heavy library (CONTRIBUTING.md says how to measure what each costs a unit): the sources that may include it. `None`:
# all. No header may,
HEAVY = {
    "CLI/": re.compile(r"_main\.cc$|^master/cli/|^config/daemon/daemon\.cc$|^tests/master/cli/cli_test\.cc$"),
    "boost/asio": None,
    "boost/beast": re.compile(r"^rpc/http/http_(client|line|server)\.cc$|^drivers/http/http_end\.cc$"),
    "nlohmann/json.hpp": None,
    "spdlog/": re.compile(r"^config/log\.cc$"),
    "thrift/": None,
}
# but for these, of which every source that includes them needs the library itself.
HEAVY_HEADERS = {
    "boost/asio": ("drivers/turtle/robot/agent.h", "drivers/turtle/robot/session.h",
                   "drivers/turtle/standalone/device_host.h", "rpc/http/http_line.h", "rpc/http/http_message.h"),
    "boost/beast": ("rpc/http/http_message.h",),
    "nlohmann/json.hpp": ("discovery/description/json.h", "master/cli/topology/topology_pages.h",
                          "tests/master/cli/cli_fixture.h"),
    "thrift/": ("tests/fuzz/thrift_frames.h", "tests/rpc/service.h"),
}
# Targets that compile for long, and what does without them: what newcomers compile first, and what ./dev test runs under asan,
# which would compile them for it alone: fuzz targets of decoders (tests/fuzz/CMakeLists.txt), and tests.
LONG = ("rpc_http", "driver_host", "gateway", "master", "master_server", "topology_endpoints")
WITHOUT = {"turtlebot-demo": ("rpc_http", "rpc", "gateway_daemon")}
NO_LIBRARIES = ("asan", "test", "threaded fuzzer")  # kinds of targets that no other uses
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')
TARGET = re.compile(r"^[ \t]*iotcloud_(room|program|plugin|thrift|fuzzer|test)\(([^()]*)\)", re.MULTILINE)


def room_violation(file, target_room):
    """Why `file` (relative to the root) may not use this room; None when it may."""
    room = file.split("/")[0]
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
    return None


def folder_violation(file, target):
    """Why `file` may not use `target` of the same room; None when it may."""
    for folder, allowed in FOLDERS.items():
        if file.startswith(folder + "/") and target.split("/")[0] == folder.split("/")[0]:
            if not target.startswith(tuple(f"{place}/" for place in [folder, *allowed])):
                return f"{folder}/ may use {', '.join(allowed) or 'no other folder of its room'}"
    return None


def include_violation(file, included):
    """Why `file` (relative to the root) may not include `included`; None when it may."""
    if included.startswith("../") or "/../" in included:
        return "an include goes by way of the one include path: <iotcloud/...>"
    if not included.startswith("iotcloud/"):
        return None
    target = included.removeprefix("iotcloud/")
    room, target_room = file.split("/")[0], target.split("/")[0]
    implementation = "/".join(target.split("/")[:2]) if target_room in FACTORIES and target.count("/") > 1 else None
    if implementation and implementation not in NO_IMPLEMENTATIONS:
        allowed = [FACTORIES[target_room], *([STARTERS[implementation]] if implementation in STARTERS else [])]
        if not file.startswith((implementation + "/", "tests/", *allowed)):
            return f"only {', '.join(allowed)} may name {implementation}/"
    reason = room_violation(file, target_room) or folder_violation(file, target)
    if reason:
        return reason
    sdk = room == "drivers" or posixpath.dirname(file) == "topology"
    if sdk and target_room == "brokers" and target != "brokers/message.h":
        return f"the SDK in {room}/ may use <iotcloud/brokers/message.h> only"
    if room == "master" and target_room in ("gateway", "topology") and not THRIFT_FOR_MASTERS.search(target):
        return "master/ may use the Thrift clients of gateways and pools only"
    return None


def heavy_violation(file, included):
    """Why `file` may not include this file of a heavy library; None when it may, or when it is of none."""
    for library, sources in HEAVY.items():
        if not included.startswith(library):
            continue
        if file.endswith(".h"):
            if file not in HEAVY_HEADERS.get(library, ()):
                return f"{library} is heavy: for sources only (forward declare, as <nlohmann/json_fwd.hpp> does)"
        elif sources and not sources.search(file):
            return f"{library} is heavy: a unit that need not read it compiles seconds sooner (HEAVY in {Path(__file__).name})"
    return None


def includes_of(root, file):
    """(line, as it stands, relative to the root) of each include of a file of ours."""
    for number, line in enumerate((root / file).read_text().splitlines(), 1):
        include = INCLUDE.match(line)
        if include and include.group(2).startswith("iotcloud/"):
            yield number, include.group(2), include.group(2).removeprefix("iotcloud/")


def check_folders(root, files):
    """Folders of one room that use each other, neither within the other: of two one at most may use the other."""
    uses = {}
    for file in files:
        folder = posixpath.dirname(file)
        if folder.split("/")[0] not in ROOMS:
            continue
        for number, text, target in includes_of(root, file):
            other = posixpath.dirname(target)
            beside = not f"{folder}/".startswith(f"{other}/") and not f"{other}/".startswith(f"{folder}/")
            if beside and other.split("/")[0] == folder.split("/")[0]:
                uses.setdefault((folder, other), f"{file}:{number}: {text}")
    for (folder, other), place in uses.items():
        if (other, folder) in uses:
            yield f"{place}: {folder}/ and {other}/ use each other"


def check_source(root, file):
    lines = (root / file).read_text().splitlines()
    if file.endswith(".h") and "#pragma once" not in lines:
        yield f"{file}:1: a header begins with #pragma once"
    for number, line in enumerate(lines, 1):
        include = INCLUDE.match(line)
        if not include:
            continue
        quote, included = include.groups()
        # What lies beside the file is held to the same rules, whatever the way it is named.
        if quote == '"' and (root / posixpath.dirname(file) / included).exists() and ".." not in included:
            included = posixpath.join("iotcloud", posixpath.dirname(file), included)
        reason = include_violation(file, included) or heavy_violation(file, included)
        if reason:
            yield f"{file}:{number}: {include.group(2)}: {reason}"


def kind_of(function, words):
    """"asan" for what ./dev test runs under asan, as cmake/IotcloudTests.cmake decides it, "test" for other tests, "threaded
    fuzzer" for those, and otherwise the function's kind."""
    if function == "fuzzer":
        return "threaded fuzzer" if "THREADED" in words else "asan"
    if function != "test":
        return function
    label = words[words.index("LABELS") + 1] if "LABELS" in words else ""
    sanitizers = {"asan", "tsan"} if label in ("unit", "contract") else set()
    if "SANITIZERS" in words:
        at = words.index("SANITIZERS") + 1
        sanitizers = {word for word in words[at:at + 2] if word in ("asan", "tsan")}
    return "asan" if "LATER" not in words and ("asan" in sanitizers and ("OPTIMIZED" in words or "tsan" not in sanitizers)) else "test"


def targets_of(root, file):
    """(line, kind, name, names of the rooms' targets that it uses) of each target in a CMakeLists.txt."""
    text = re.sub(r"#[^\n]*", "", (root / file).read_text())
    for call in TARGET.finditer(text):
        name, keyword, used = None, None, []
        for word in call.group(2).split():
            if word.startswith("${"):  # fuzz targets name those
                continue
            if word.isupper():
                keyword = word
            elif keyword == "NAME":
                name = word
            elif keyword == "USES" or word.startswith("iotcloud_"):
                used.append(word.removeprefix("iotcloud_"))
        kind = kind_of(call.group(1), call.group(2).split())
        yield text[: call.start()].count("\n") + 1, kind, name, used


def way_to(name, wanted, uses):
    """The targets by which `name` comes to use `wanted`; None when it does not."""
    if name == wanted:
        return [name]
    ways = (way_to(used, wanted, uses) for used in uses.get(name, ()))
    return next(([name, *way] for way in ways if way), None)


def check_long(targets):
    """What compiles for long is used only by what cannot do without."""
    uses = {name: used for _, _, kind, name, used in targets if kind not in NO_LIBRARIES}
    for file, line, kind, name, used in targets:
        without = LONG if kind == "asan" else WITHOUT.get(name, ()) if kind == "program" else ()
        for target in without:
            way = next(filter(None, (way_to(by, target, uses) for by in used)), None)
            if way:
                yield f"{file}:{line}: {name} uses {' -> '.join(way)}, which takes long to compile (LONG in {Path(__file__).name})"


def check_targets(root, files):
    targets = [(file, *target) for file in files for target in targets_of(root, file)]
    yield from check_long(targets)
    places = {name: (file, kind) for file, _, kind, name, _ in targets if kind != "program" and kind not in NO_LIBRARIES}
    for file, line, _, name, uses in targets:
        room = file.split("/")[0]
        for used in uses:
            if used not in places:
                yield f"{file}:{line}: {name} uses {used}, and no CMakeLists.txt makes that"
                continue
            place, kind = places[used]
            reason = room_violation(file, place.split("/")[0])
            if not reason and room == "master" and place.startswith("gateway/") and kind != "thrift":
                reason = "master/ may use the gateway's Thrift client only"
            if not reason and room == "drivers" and place.startswith("brokers/") and used != "message":
                reason = "the SDK in drivers/ may use message of brokers/ only"
            if reason:
                yield f"{file}:{line}: {name} uses {used}: {reason}"


def check(root):
    files = [path.relative_to(root).as_posix() for path in project_files(root)]
    sources = [file for file in files if file.endswith((".h", ".cc"))]
    problems = [problem for file in sources for problem in check_source(root, file)]
    problems += check_folders(root, sources)
    # tests/external is a project of its own.
    recipes = [f for f in files if posixpath.basename(f) == "CMakeLists.txt" and not f.startswith("tests/external/")]
    return problems + list(check_targets(root, recipes))


if __name__ == "__main__":
    found = check(Path(sys.argv[1]).resolve())
    print("\n".join(found) or "includes and targets keep the rooms apart")
    sys.exit(1 if found else 0)
