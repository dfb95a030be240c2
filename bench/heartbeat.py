"""Tells a user who waits for a benchmark what it is doing and about how long the rest takes."""

import json
import sys
import threading
import time

PERIOD_S = 30  # time between two lines if the output is no terminal


def in_minutes(seconds):
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.1f} min"


def seconds_of_last_run(file, command):
    """Duration of the run that wrote `file`, if it was a run of the same command; None otherwise."""
    try:
        written = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return written.get("seconds") if written.get("command") == command else None


class Line:
    """A line about the work. On a terminal each text replaces the one before; elsewhere a line is printed every 30 s.
    Not thread safe."""

    def __init__(self, out=None, clock=time.monotonic):
        self.out, self.clock = out or sys.stderr, clock
        self.told = clock()

    def say(self, text):
        if self.out.isatty():
            print(f"\r\033[K{text}\r", end="", file=self.out, flush=True)
        elif self.clock() - self.told >= PERIOD_S:
            self.told = self.clock()
            print(text, file=self.out, flush=True)


class Heartbeat:
    """While a `with` block lasts, a thread tells how long it has run, and how much is left if it takes as long as its
    last run."""

    def __init__(self, what, expected_s):
        self.what, self.expected_s = what, expected_s
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.beat, daemon=True)

    def text(self, spent):
        if self.expected_s is None:
            return f"{self.what}: {in_minutes(spent)}"
        return f"{self.what}: {in_minutes(spent)}, about {in_minutes(max(0.0, self.expected_s - spent))} left"

    def beat(self):
        line, began = Line(), time.monotonic()
        while not self.ended.wait(2):
            line.say(self.text(time.monotonic() - began))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.thread.join()
