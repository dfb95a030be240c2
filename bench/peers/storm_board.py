"""The files of numbers that the benchmark shares with the tasks of its DAGs (bench/storm/components.cc)."""

import dataclasses
import mmap
import struct
from pathlib import Path

FULL, NOTHING = -1, 0  # in place of items a second
NUMBER = struct.Struct("<q")
HEAD, BUCKETS, FIRST_LATENCY = 3, 704, 8
SIZE = (FIRST_LATENCY + BUCKETS) * NUMBER.size


@dataclasses.dataclass(frozen=True)
class Counts:
    """What all tasks have counted so far, or between two moments."""

    emitted: int
    results: int
    failed: int
    latencies: tuple  # by bucket

    def __sub__(self, before):
        return Counts(self.emitted - before.emitted, self.results - before.results, self.failed - before.failed,
                      tuple(now - then for now, then in zip(self.latencies, before.latencies)))

    def latency_us(self, part):
        """The latency below which this part of all lie; None when there is none."""
        wanted, seen = part * sum(self.latencies), 0
        for bucket, count in enumerate(self.latencies):
            seen += count
            if count and seen >= wanted:
                return middle_of(bucket)
        return None


def middle_of(bucket):
    """Microseconds in the middle of a bucket: there are 32 for each doubling, and one for each microsecond below 64."""
    shift = max(0, bucket // 32 - 1)
    return (bucket - 32 * shift + 0.5) * 2 ** shift


class Board:
    """A folder with the file `control` and the files of tasks."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True)
        self.control = self.map(self.folder / "control", b"\0" * SIZE)

    @staticmethod
    def map(path, content=None):
        if content:
            path.write_bytes(content)
        with open(path, "r+b") as file:
            return mmap.mmap(file.fileno(), SIZE)

    def send(self, rate):
        """Lets the sources send so many items a second."""
        NUMBER.pack_into(self.control, 0, rate)

    def counts(self):
        heads, latencies = [0] * HEAD, [0] * BUCKETS
        for file in self.folder.glob("*-*"):
            content = file.read_bytes()
            if len(content) != SIZE:
                continue  # its task has just begun
            numbers = [number for number, in NUMBER.iter_unpack(content)]
            heads = [sum(pair) for pair in zip(heads, numbers)]
            latencies = [sum(pair) for pair in zip(latencies, numbers[FIRST_LATENCY:])]
        return Counts(*heads, tuple(latencies))
