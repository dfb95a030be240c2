"""Splits a frame's time into parts, by the robot's trace, the time stamps of the follower's bolts, and the packets on
the wire. All times are of one machine's monotonic clock."""

import bisect
import csv
import math
from pathlib import Path

LATE, ENCODE, TO_BROKER, TO_SPOUT, TO_BOLT, COMPUTE, BACK = (
    "late", "encode", "gateway to broker", "broker to spout", "spout to bolt", "compute", "back")
PARTS = (LATE, ENCODE, TO_BROKER, TO_SPOUT, TO_BOLT, COMPUTE, BACK)
UNSEEN = "gateway to spout"  # replaces the two parts around the broker if the packets could not be captured
# Details that the packets tell: which share of two parts the broker takes.
IN_BROKER, TO_WORKER = "broker to spout: in the broker", "broker to spout: on the wire and in the worker"
BACK_WORKER, BACK_BROKER, BACK_HOST = "back: worker to broker", "back: in the broker", "back: broker to robot"
COMMAND = b'"linear"'  # text that every command contains
SMALL = 1000  # bytes; a frame's first packet is larger than this
MADE_UP_NS = 1_000_000_000  # EventLoop::start_timer() of gateway/host


class Frame:
    """One row of a trace. Times in nanoseconds."""

    def __init__(self, row):
        self.sequence, self.time_ms = int(row["seq"]), int(row["time_ms"])
        self.captured = round(float(row["monotonic_us"]) * 1000)
        # without the time to render, which a camera would not need
        self.begun = self.captured - round(float(row["render_us"]) * 1000)
        self.encoded = self.captured + round(float(row["encode_us"]) * 1000)
        self.size = int(row["payload_bytes"])
        self.answered = row["answered"] == "1"
        self.arrived = self.captured + int(row["latency_us"]) * 1000 if self.answered else None
        self.late = 0

    @property
    def whole_ms(self):
        """From the time at which the frame should have been captured to the arrival of its command, in ms."""
        return (self.arrived - self.captured + self.late) / 1e6


def read_trace(path):
    """The frames of a trace that may still be growing: a last line without its end is left out."""
    text = Path(path).read_text() if Path(path).exists() else ""
    return [Frame(row) for row in csv.DictReader(text[: text.rfind("\n") + 1].splitlines())]


def note_lateness(frames, period_ns):
    """Sets how late each frame was begun. The grid of intended times goes through the frame that was least late, so none is
    early. Returns how many frames the grid has between the first and the last one.

    The robot's timer makes up for frames that it begins late, one after the other, each of which is as late as it is. It
    leaves out those for which it is more than MADE_UP_NS late when it is done with the one before."""
    if not frames:
        return 0
    first = min(frame.begun - index * period_ns for index, frame in enumerate(frames))
    ticks = [0]
    for before in frames[:-1]:
        tick = ticks[-1] + 1
        behind = before.encoded - first - tick * period_ns
        ticks.append(tick + behind // period_ns if behind > max(MADE_UP_NS, period_ns) else tick)
    first = min(frame.begun - tick * period_ns for frame, tick in zip(frames, ticks, strict=True))
    for frame, tick in zip(frames, ticks, strict=True):
        frame.late = frame.begun - first - tick * period_ns
    return ticks[-1] + 1


def read_stamps(folder, component):
    """The time stamps that all tasks of a component recorded: {time_ms: (born, begin, end)}."""
    found = {}
    for file in Path(folder).glob(f"{component}-*.csv"):
        for row in csv.DictReader(file.read_text().splitlines()):
            found[int(row["time_ms"])] = tuple(int(row[name]) for name in ("born_ns", "begin_ns", "end_ns"))
    return found


class Wire:
    """The packets of a tap, ordered by time."""

    def __init__(self, packets):
        self.packets = sorted(packets, key=lambda packet: packet.at_ns)
        self.times = [packet.at_ns for packet in self.packets]

    def between(self, begin, end, to_broker):
        first, last = bisect.bisect_left(self.times, begin), bisect.bisect_right(self.times, end)
        return [packet for packet in self.packets[first:last] if packet.to_broker == to_broker]

    def body(self, begin, end, to_broker, size):
        """When the first and the last of `size` bytes passed on one connection; None when no connection carried so
        many."""
        passed = {}  # {peer: [first, bytes so far]}
        for packet in self.between(begin, end, to_broker):
            if packet.peer not in passed and packet.size <= SMALL:
                continue  # an acknowledgement or a heartbeat
            sent = passed.setdefault(packet.peer, [packet.at_ns, 0])
            sent[1] += packet.size
            if sent[1] >= size:
                return sent[0], packet.at_ns
        return None

    def command(self, begin, end, to_broker):
        """When a command passed; None when none passed."""
        return next((packet.at_ns for packet in self.between(begin, end, to_broker) if COMMAND in packet.head), None)


def parts_of(frame, decode, follow, wire):
    """Returns ({part: ms}, {detail: ms}) of an answered frame; None when a time stamp is missing. The parts add up to
    the whole; the details divide some of them further. `wire` may be None."""
    if frame.time_ms not in decode or frame.time_ms not in follow:
        return None
    born, begin, _ = decode[frame.time_ms]
    _, _, done = follow[frame.time_ms]
    parts, closer = {LATE: frame.late, ENCODE: frame.encoded - frame.captured}, {}
    if wire is None:
        parts[UNSEEN] = born - frame.encoded
    else:
        there = wire.body(frame.captured, begin, True, frame.size)
        leaves = wire.body(frame.encoded, begin, False, frame.size)
        if there is None or leaves is None:
            return None
        parts |= {TO_BROKER: there[1] - frame.encoded, TO_SPOUT: born - there[1]}
        closer |= {IN_BROKER: leaves[0] - there[1], TO_WORKER: born - leaves[0]}
        sent, came = (wire.command(done, frame.arrived, to_broker) for to_broker in (True, False))
        if sent and came:
            closer |= {BACK_WORKER: sent - done, BACK_BROKER: came - sent, BACK_HOST: frame.arrived - came}
    parts |= {TO_BOLT: begin - born, COMPUTE: done - begin, BACK: frame.arrived - done}
    return {name: value / 1e6 for name, value in parts.items()}, {name: value / 1e6 for name, value in closer.items()}


def slowest(frames, known):
    """{part: mean ms} over the slowest hundredth of the frames that have all time stamps; these means add up."""
    order = sorted(range(len(known)), key=lambda index: -frames[index].whole_ms)[: max(1, len(known) // 100)]
    return {name: sum(known[index][0][name] for index in order) / len(order) for name in known[0][0]} if known else {}


def statistics_of(values, lost=0):
    """The statistics of a point, from its values in ms."""
    ordered, n = sorted(values), len(values)
    if not n:
        return {"failed": "nothing came back", "n": 0, "lost": lost}
    mean = sum(ordered) / n

    def quantile(share):
        return ordered[min(n - 1, int(share * n))]

    return {"mean_ms": mean, "p50_ms": quantile(0.5), "p99_ms": quantile(0.99), "max_ms": ordered[-1],
            "stddev_ms": math.sqrt(sum((value - mean) ** 2 for value in ordered) / n), "n": n, "lost": lost}
