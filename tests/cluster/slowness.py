#!/usr/bin/python3
"""How much longer than on a free processor things take on this machine now: what a busy machine does to a time that is measured
on it. Run as a program, it measures until nobody reads its lines any more, one for each measurement."""

import bisect
import subprocess
import sys
import threading
import time

PAUSE_S = 0.05
STEPS = 20_000  # about a millisecond of work


def measure():
    """Wakes up, and works for about a millisecond, again and again. Writes when it was done (time of day), how long that took
    from the time at which it should have woken up, and how long it had a processor."""
    while True:
        due = time.monotonic() + PAUSE_S
        time.sleep(PAUSE_S)
        before = time.thread_time()
        for _ in range(STEPS):
            pass
        worked, took = time.thread_time() - before, time.monotonic() - due
        print(time.time(), took, worked, flush=True)


class Slowness(threading.Thread):
    """Follows that program, a process like those that are measured; a context manager. It cannot tell work from waiting: what a cluster
    waits for needlessly, beyond `idle`, is divided by the factor, too, and so weighs less in what without() returns the busier the
    machine is."""

    def __init__(self):
        super().__init__(daemon=True)
        self.times, self.took, self.worked = [], [0], [0]  # of the two, the sums until then

    def __enter__(self):
        self.program = subprocess.Popen([sys.executable, __file__], stdout=subprocess.PIPE, text=True)
        self.start()
        return self

    def __exit__(self, *failure):
        self.program.kill()
        self.program.wait()
        self.join()
        self.program.stdout.close()

    def run(self):
        for line in self.program.stdout:
            self.note(*map(float, line.split()))

    def note(self, at, took, worked):
        self.took.append(self.took[-1] + took)
        self.worked.append(self.worked[-1] + worked)
        self.times.append(at)  # last, because who asks looks for a time first

    def factor(self, begin, end):
        """How many times longer things took from `begin` to `end`, two times of day that have passed; at least 1."""
        while not self.times or self.times[-1] < end:
            if not self.is_alive():
                raise SystemExit("slowness.py has ended, so nothing can be judged")
            time.sleep(PAUSE_S)
        first, last = bisect.bisect_left(self.times, begin), bisect.bisect_left(self.times, end) + 1
        return max((self.took[last] - self.took[first]) / (self.worked[last] - self.worked[first]), 1)

    def without(self, begin, end, idle=0):
        """For how many seconds what happened from `begin` to `end` would have lasted on a free processor. Of them, `idle` are a wait that
        no machine makes longer: a session's time-out."""
        return min(end - begin, idle) + max(end - begin - idle, 0) / self.factor(begin, end)


if __name__ == "__main__":
    try:
        measure()
    except BrokenPipeError:
        sys.exit()
