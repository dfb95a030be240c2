"""How long processes of this machine have waited for a processor: what a busy machine adds to a time that is measured on it."""

import bisect
import threading
import time
from pathlib import Path

COUNT = Path("/proc/pressure/cpu")  # an old kernel has none
NOTE_S = 0.05


class Starvation(threading.Thread):
    """Follows the kernel's count of the time in which some process waited for a processor. What is measured may be late because
    of that time, and because of no other. Where the kernel does not count, nobody is taken to have waited."""

    def __init__(self):
        super().__init__(daemon=True)
        self.times, self.counts = [], []
        self.note()
        self.start()

    def note(self):
        now = time.time()
        words = COUNT.read_text(encoding="ascii").splitlines()[0].split() if COUNT.exists() else ["total=0"]
        self.counts.append(int(words[-1].removeprefix("total=")) / 1e6)
        self.times.append(now)  # last, because who asks looks for a time first

    def run(self):
        while True:
            time.sleep(NOTE_S)
            self.note()

    def calm(self):
        """Whether hardly any process waited in the moment before now."""
        return self.counts[-1] - self.counts[max(len(self.counts) - 3, 0)] < NOTE_S / 5

    def without(self, begin, end):
        """For how many seconds from `begin` to `end`, two times of day that have passed, no process waited. Counted is from the
        last look before to the first look after, so that the seconds may be too few by a moment."""
        while self.times[-1] < end:
            time.sleep(NOTE_S)
        first = max(bisect.bisect_right(self.times, begin) - 1, 0)
        last = bisect.bisect_left(self.times, end)
        return max(end - begin - (self.counts[last] - self.counts[first]), 0)
