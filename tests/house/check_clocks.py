#!/usr/bin/python3
"""Nothing waits for the time of day, and nothing measures by it: it is set back and forth while a process runs. Checks the
C++ below a source tree, and the Python below its folder tests. Waits and time spans are the steady clock's or an injected
config::Clock's (config/mutex.h), in Python time.monotonic()'s.

In the rooms INJECTED even the steady clock is not enough: everything waits and measures by the clock that it was given, so
that a test can move it. No room asks the machine's clock for the time in the middle of a function; a class takes it as the
default of its clock.

usage: check_clocks.py ROOT     (exit status 1 and a line for each violation)
"""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))
from project_files import project_files  # noqa: E402

# Where the time of day itself is meant, and why.
TIME_OF_DAY = {
    "config/clock.cc": "config::Clock::wall_ms() for all others",
    "drivers/mqtt/sparkplug/sparkplug.cc": "time stamps of messages; a driver links no clock of ours",
    "drivers/turtle/turtle_driver.cc": "time stamps of messages; a driver links no clock of ours",
    "tests/c11_threads_for_tsan.cc": "C's own functions, as the standard has them",
    "tests/chaos/machine.cc": "makes it go wrong",
    "tests/config/mutex_test.cc": "shows that our waits refuse it",
}
# Where wall_ms() is compared or calculated with: times that another process wrote, or that outlive this one.
STAMPS_OF_OTHERS = {
    "brokers/kafka/reading/partition_reader.cc": "a message's deadline, which its sender wrote",
    "brokers/kafka/record.cc": "a message's time stamp, which its driver wrote",
    "brokers/spool/spool_queue.cc": "the age of messages that an earlier process accepted",
    "security/plugin_versions.cc": "when a version first ran outlives the process",
    "gateway/order_feed.cc": "an order says when its master gave it",
    "config/output/output.cc": "the age of records that other processes wrote",
    "master/orders/order_book.cc": "two orders of one master never have the same time",
    "master/topologies/topology_service.cc": "an order says until when its master waits, whichever process reads it",
    "security/tokens.cc": "a token's end is a day of the calendar, which its file says",
    "topology/endpoints/receiving/broker_spout.cc": "the age of a message by the time stamp that its driver wrote",
    "topology/storm/shim/task_host.cc": "a tuple's birth in another worker's process",
    "topology/windows/watermarks.h": "event times, as windowed_bolt.cc gives them",
    "topology/windows/windowed_bolt.cc": "event times that are time stamps, by the steady clock from the first look on",
    "topology/worker/control.cc": "an order says until when its master waits, whichever process reads it",
    "tests/gateway/signed_orders_test.cc": "such orders",
    "tests/topology/pool/pool_test.cc": "such orders",
    "tests/topology/storm/components.cc": "the age of a message by the time stamp that its driver wrote",
    "tests/topology/storm/task_hosts_test.cc": "such a birth",
    "tests/topology/worker/worker_control_test.cc": "such an order",
    "tests/topology/worker/worker_test.cc": "such a message",
}

# Rooms whose waits and time spans go by an injected clock.
INJECTED = ("brokers/", "topology/state/")
# Where they go by the machine's, and why.
OF_THE_MACHINE = {
    "brokers/kafka/client.cc": "the end of a library's client, which knows no clock of ours",
    "brokers/spool/store/spool_store.cc": "the lock of another process, of whose end nothing tells this one",
    "gateway/gateway_main.cc": "the daemon's health, at the end of all injection",
    "gateway/host/control_server.cc": "the host's process, at the end of all injection",
    "topology/endpoints/standstill_fence.cc": "the fence's own default",
    "topology/state/redis/redis_connection.cc": "the limit of poll(), which knows no clock of ours",
    "topology/state/redis/redis_connection.h": "as redis_connection.cc",
}

CLOCKS = re.compile(
    r"\bchrono\s*::\s*(?:system_clock|utc_clock|file_clock|high_resolution_clock)\b"
    r"|(?<![\w:])(?:system_clock|utc_clock|high_resolution_clock)\s*::"
    r"|\bCLOCK_REALTIME(?:_COARSE)?\b|\bTIME_UTC\b|\bgettimeofday\s*\(|(?<![\w:.>])(?:std::)?time\s*\(\s*(?:nullptr|NULL|0|&\w+)\s*\)")
# These take the time of day whatever they are given.
WAITS = re.compile(
    r"\b(?:pthread_cond_timedwait|pthread_mutex_timedlock|pthread_rwlock_timed\w+|sem_timedwait|mtx_timedlock"
    r"|cnd_timedwait|mq_timed(?:send|receive))\s*\(")
# A wait or a look at the time that no injected clock can change.
NOT_INJECTED = re.compile(
    r"\bchrono\s*::\s*steady_clock\b|(?<![\w:])steady_clock\s*::"
    r"|(?:\.|->)\s*wait_for\s*\(|\bsleep_(?:for|until)\s*\(|\bfrom_now\s*\(")
MACHINES_TIME = re.compile(r"\bsystem_clock\(\)\s*\.\s*now\(\)")
# What yields the time of day in milliseconds: the clock, and a function that has it from there.
STAMPS = r"\b(?:wall_ms|now_ms)\(\)"
# A variable that holds it: one that is set to it, and any that is called now_ms.
STAMP_VARIABLES = re.compile(rf"\b(\w+)\s*(?:=|\{{|\()\s*(?:\w|[.:]|\(\))*{STAMPS}\s*[;}})]")
PYTHON_SPANS = re.compile(r"\btime\.time\(\)\s*[-+<>]|(?:[-+]|[<>]=?)\s*time\.time\(\)")
# A test that moves its clock's time of day.
MOVES = re.compile(r"\bset_wall_ms\([^;]*;")
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)


def without_comments(text):
    return COMMENT.sub(lambda comment: "\n" * comment.group().count("\n"), text)


def spans(names):
    """What calculates or compares with a time stamp of now, which variables of these names hold, too."""
    stamp = rf"(?:{STAMPS}|\b(?:{'|'.join(sorted(names))})\b(?!\())"
    return re.compile(rf"{stamp}\s*(?:[-+](?![+>])|[<>](?!<|>))|(?:(?<!-)[-+]|[<>]=?)\s*(?:[\w.]|::|\(\))*{stamp}")


def check_source(file, text):
    """Lines for what `file` (relative to the root) does wrong."""
    text = without_comments(text)
    names = {"now_ms"} | {name for name in STAMP_VARIABLES.findall(text.replace("->", "."))}
    spans_here = spans(names)
    for number, line in enumerate(text.splitlines(), 1):
        if file not in TIME_OF_DAY:
            for found in (CLOCKS.search(line), WAITS.search(line)):
                if found:
                    yield (f"{file}:{number}: {found.group().strip()}: the time of day may be set back at any moment; wait "
                           f"and measure by std::chrono::steady_clock or config::Clock::now(), and take time stamps from "
                           f"config::Clock::wall_ms()")
        if file not in OF_THE_MACHINE and not file.startswith("tests/"):
            for found in (file.startswith(INJECTED) and NOT_INJECTED.search(line), MACHINES_TIME.search(line)):
                if found:
                    yield (f"{file}:{number}: {found.group().strip()}: no test can move that clock; take a config::Clock, "
                           f"ask its now(), and wait with wait_until(mutex, clock, end)")
        span = spans_here.search(MOVES.sub("", line.replace("->", ".")))
        if span and file not in STAMPS_OF_OTHERS:
            yield (f"{file}:{number}: {span.group().strip()}: how long something takes is measured by "
                   f"config::Clock::now(); wall_ms() is for time stamps")


def check_python(file, text):
    for number, line in enumerate(text.splitlines(), 1):
        if span := PYTHON_SPANS.search(line.split("#")[0]):
            yield (f"{file}:{number}: {span.group().strip()}: wait and measure by time.monotonic(); time.time() is for time "
                   f"stamps of other processes")


def check(root):
    problems = []
    for path in project_files(root):
        file = path.relative_to(root).as_posix()
        if path.suffix in (".h", ".cc"):
            problems += check_source(file, path.read_text())
        elif path.suffix == ".py" and file.startswith("tests/") and not file.startswith("tests/house/check_clocks"):
            problems += check_python(file, path.read_text())
    return problems


if __name__ == "__main__":
    found = check(Path(sys.argv[1]).resolve())
    print("\n".join(found) or "nothing waits for the time of day")
    sys.exit(1 if found else 0)
