"""Rounds in which the sides of `./dev bench runtime` and `./dev bench storm` take turns."""

from brokers_report import NOISE
from figures import ProgramFailed


class Rounds:
    """Rounds in each of which all sides take one turn, in reverse order in every second round. The first side is ours. A
    round in which other processes took more than NOISE CPUs is thrown away and taken again, unless `keep_noisy`."""

    def __init__(self, title, wanted, sides, keep_noisy=False):
        self.sides, self.title, self.wanted, self.taken, self.thrown, self.problem = sides, title, wanted, 0, 0, None
        self.keep_noisy, self.lines = keep_noisy, {side: [] for side in sides}

    def wants_more(self):
        return not self.problem and len(self.lines[self.sides[0]]) < self.wanted and self.taken < 2 * self.wanted

    def take(self, turn):
        """Runs one round. `turn(side)` measures one side and returns a line."""
        order = self.sides if self.taken % 2 == 0 else self.sides[::-1]
        self.taken += 1
        try:
            lines = {side: turn(side) for side in order}
        except ProgramFailed as failure:  # the other figures are measured in any case
            self.problem, self.lines = str(failure).strip(), {side: [] for side in self.sides}
            return
        if not self.keep_noisy and max(line["others_cpu"] for line in lines.values()) > NOISE:
            self.thrown += 1
            return
        for side, line in lines.items():
            self.lines[side].append(line)

    def say_problem(self, report):
        report.thrown_away += self.thrown
        if self.problem:
            report.fail(f"{self.title}: GIVEN UP: {self.problem}")
        elif not self.lines[self.sides[0]]:
            print(f"{self.title}: no round was quiet", flush=True)

    def of(self, side, figure):
        return [figure(line) for line in self.lines[side]]
