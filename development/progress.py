#!/usr/bin/python3
"""Tells how far long work is, and about how long it still takes.

usage: ninja ... | progress.py build WHAT
       ctest ... | progress.py tests WHAT [--costs FILE]...      FILE: ctest's CTestCostData.txt of earlier runs
       cmake ... | progress.py configuration WHAT [--took FILE]
       ... | progress.py other WHAT [--took FILE]                another program, which does not say how far it is

--took: FILE gets the seconds that this took, and had those of the time before: that is how the time left is known. CMake's
first run in a new folder is judged by its lines. Reads what the program prints. On a terminal one line is written over and over, otherwise a line every 30 s. Warnings,
errors, tests that fail, and all that another program prints are passed on at once; the rest is in the file that the
caller keeps.
"""
import argparse
import re
import select
import sys
import time
from pathlib import Path

PERIOD_S = 30

NINJA_STEP = re.compile(r"^\[(\d+)/(\d+)\] (.*)")
CTEST_START = re.compile(r"^\s*Start\s+\d+: (.+)$")
CTEST_END = re.compile(r"^\s*(\d+)/(\d+) Test\s+#\d+: (.+?) \.+\s*(\*{3})?(Passed|Skipped|\S.*?)\s+([\d.]+) sec")


def in_minutes(seconds):
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.1f} min"


class Build:
    """Follows ninja's output: "[12/343] Building CXX object ...", and what compilers say."""

    def __init__(self, _costs):
        self.done = self.all = 0
        self.now = ""

    def take(self, line):
        """Returns what a person should see of this line at once, or None."""
        step = NINJA_STEP.match(line)
        if not step:
            return line if line.strip() and not line.startswith("ninja: Entering directory") else None
        self.done, self.all = int(step[1]), int(step[2])
        self.now = step[3].split("/")[-1].removesuffix(".o")
        return None

    def share(self):
        """The finished share of the whole, 0 to 1."""
        return self.done / self.all if self.all else 0.0

    def text(self):
        return f"step {self.done} of {self.all}", self.now


class Tests:
    """Follows ctest's output as tests begin and end."""

    def __init__(self, costs):
        self.costs = costs
        self.done = self.all = self.failed = 0
        self.spent = 0.0
        self.running = []

    def take(self, line):
        if start := CTEST_START.match(line):
            self.running.append(start[1])
        elif end := CTEST_END.match(line):
            self.done, self.all, name, bad, seconds = self.done + 1, int(end[2]), end[3], end[4], float(end[6])
            if name in self.running:
                self.running.remove(name)
            self.spent += self.costs.get(name, seconds)
            if bad and end[5] != "Skipped":
                self.failed += 1
                return f"FAILED after {seconds:.1f} s: {name}"
        return None

    def share(self):
        whole = sum(self.costs.values())
        if whole > self.spent:
            return self.spent / whole
        return self.done / self.all if self.all else 0.0

    def text(self):
        left = f"{self.all - self.done} of {self.all} left" if self.all else "beginning"
        failed = f", {self.failed} failed" if self.failed else ""
        return left + failed, ", ".join(self.running[-3:])


class Configuration:
    """Follows CMake's output, of which a person who waits sees the last line; all of it is in the file that the caller keeps."""

    LINES = 66  # about as many does CMake print in a new folder; later it prints fewer

    def __init__(self, _costs):
        self.now = ""
        self.lines = 0

    def take(self, line):
        self.now = line.removeprefix("-- ").strip() or self.now
        self.lines += 1
        return None

    def share(self):
        return self.lines / self.LINES if self.lines < self.LINES else 0.0

    def text(self):
        return "under way", self.now


class Other:
    """Follows a program of which only the time is known that it has taken."""

    def __init__(self, _costs):
        pass

    def take(self, line):
        return line if line.strip() else None

    def share(self):
        return 0.0

    def text(self):
        return "under way", ""


KINDS = {"build": Build, "tests": Tests, "configuration": Configuration, "other": Other}


def read_costs(files):
    """Seconds of each test in earlier runs. Skips missing files."""
    costs = {}
    for file in files:
        try:
            with open(file, encoding="utf-8") as lines:
                for line in lines:
                    words = line.split()
                    if len(words) == 3 and line.strip() != "---":
                        costs[words[0]] = float(words[2])
        except OSError:
            continue
    return costs


class Took:
    """The seconds that something took the last time, in a file."""

    LEAST_S = 3  # what is done sooner needs no telling, and says nothing about a time with more to do

    def __init__(self, file):
        self.file = file
        try:
            self.seconds = float(file.read_text(encoding="ascii"))
        except (OSError, ValueError):
            self.seconds = 0.0

    def keep(self, seconds):
        if seconds >= self.LEAST_S:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.write_text(f"{seconds:.0f}\n", encoding="ascii")


class Teller:
    """Tells how far the work is: again and again on one line of a terminal, elsewhere every 30 s. `before`: the seconds that it
    took the last time; 0: that is not known."""

    def __init__(self, what, work, out, clock=time.monotonic, before=0.0):
        self.what, self.work, self.out, self.clock, self.before = what, work, out, clock, before
        self.began = self.told = clock()
        self.terminal = out.isatty()

    def spent(self):
        return self.clock() - self.began

    def line(self):
        spent = self.spent()
        share = self.work.share()
        if self.before:
            share = spent / self.before if spent < self.before else 0.0  # longer than ever: nobody knows
        how_far, now = self.work.text()
        left = f", about {in_minutes(spent / share * (1 - share))} left" if share > 0.02 and spent > 3 else ""
        return f"{self.what}: {how_far}, {in_minutes(spent)}{left}" + (f"   {now}" if now else "")

    def say(self, text):
        """Prints a line that stays."""
        print(("\r\033[K" if self.terminal else "") + text, file=self.out, flush=True)

    def tick(self):
        if self.terminal:
            print("\r\033[K" + self.line()[:118], end="", file=self.out, flush=True)
        elif self.clock() - self.told >= PERIOD_S:
            self.told = self.clock()
            print(self.line(), file=self.out, flush=True)

    def end(self):
        if self.terminal:
            print("\r\033[K", end="", file=self.out, flush=True)


def lines_with_pauses(stream, period):
    """Yields each line of `stream`, and None whenever no line came for `period` seconds."""
    rest = b""
    while True:
        ready, _, _ = select.select([stream], [], [], period)
        if not ready:
            yield None
            continue
        data = stream.read1(65536)
        if not data:
            break
        *lines, rest = (rest + data).split(b"\n")
        yield from (line.decode(errors="replace").rstrip("\r") for line in lines)
    if rest:
        yield rest.decode(errors="replace")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kind", choices=list(KINDS))
    parser.add_argument("what")
    parser.add_argument("--costs", action="append", default=[])
    parser.add_argument("--took", type=Path)
    given = parser.parse_args()
    took = Took(given.took) if given.took else None
    work = KINDS[given.kind](read_costs(given.costs))
    teller = Teller(given.what, work, sys.stdout, before=took.seconds if took else 0.0)
    for line in lines_with_pauses(sys.stdin.buffer, 1):
        if line is not None:
            text = work.take(line)
            if text is not None:
                teller.say(text)
        teller.tick()
    teller.end()
    if took:
        took.keep(teller.spent())


if __name__ == "__main__":
    main()
