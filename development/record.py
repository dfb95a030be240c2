#!/usr/bin/python3
"""Runs a command of ./dev, and adds to development/times.tsv what it took.

usage: ./dev demo --record [OPTIONS]
       ./dev test --record [OPTIONS]      (both run this file: record.py SECONDS CPU_SECONDS COMMAND [OPTIONS])

SECONDS and CPU_SECONDS are what ./dev took before this file could run, which is the time for installing python3 on a new
machine: they count in the step "packages" and in the whole.

A line for each step that build/steps.tsv names, and one for the whole: when, commit, command, cores, step, seconds,
seconds of CPU time, the most memory that the command's processes had at one time (MB, the share of each in what
several have), and what ran beside it: the CPU time of all other processes as a share of the machine, and the busiest of
them. A run that failed is recorded too, and says so.
"""
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from repeat import commit_of

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "development/times.tsv"
STEPS = ROOT / "build/steps.tsv"
HEAD = "began\tcommit\tcommand\tcores\tstep\tseconds\tcpu_s\tmemory_mb\tbeside\n"
PERIOD_S = 1.0
TICKS = os.sysconf("SC_CLK_TCK")


def processes():
    """{pid: (parent, name, ticks of CPU time)} of all processes; without those that end meanwhile."""
    found = {}
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            text = Path("/proc", pid, "stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        name, rest = text[text.index("(") + 1:text.rindex(")")], text[text.rindex(")") + 2:].split()
        found[int(pid)] = int(rest[1]), name, int(rest[11]) + int(rest[12])
    return found


def memory_mb(pid):
    try:
        for line in Path("/proc", str(pid), "smaps_rollup").read_text(encoding="ascii").splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024
    except OSError:
        pass  # it has ended, or is another user's
    return 0.0


class Family:
    """The processes that the command started, also those whose parents have ended: they are known from before."""

    def __init__(self, root):
        self.root, self.known = root, set()

    def update(self, found):
        """Returns those that are there now."""
        children = {}
        for pid, (parent, _, _) in found.items():
            children.setdefault(parent, []).append(pid)
        waiting = [pid for pid in (self.root, *self.known) if pid in found]
        self.known = set()
        while waiting:
            pid = waiting.pop()
            if pid not in self.known:
                self.known.add(pid)
                waiting += children.get(pid, [])
        return self.known


class Others:
    """The CPU time of the processes that are not the command's."""

    def __init__(self):
        self.before, self.seconds = {}, {}

    def update(self, found, family):
        for pid, (_, name, ticks) in found.items():
            if pid not in family and pid != os.getpid() and pid in self.before:
                self.seconds[name] = self.seconds.get(name, 0.0) + (ticks - self.before[pid]) / TICKS
        self.before = {pid: ticks for pid, (_, _, ticks) in found.items()}

    def text(self, seconds):
        share = sum(self.seconds.values()) / max(seconds * os.cpu_count(), 0.001)
        busiest = [name for name, spent in sorted(self.seconds.items(), key=lambda item: -item[1])[:3] if spent >= 0.5]
        return f"{100 * share:.0f} %" + (f": {', '.join(busiest)}" if busiest else "")


def steps():
    """(seconds, name, CPU seconds) of each step that has ended."""
    try:
        lines = STEPS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    return [(float(seconds), name, float(cpu)) for seconds, name, _, cpu in (line.split("\t") for line in lines)]


def run(command, environment):
    """Runs the command. Returns its exit status, its steps with their memory, and the row of the whole."""
    STEPS.unlink(missing_ok=True)
    most = [0.0]  # of each step; the last one has not ended
    others = Others()
    began, cpu_began = time.monotonic(), sum(os.times()[2:4])
    with subprocess.Popen(command, cwd=ROOT, env=environment) as child:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it reaches the command too, which ends
        family = Family(child.pid)
        while child.poll() is None:
            found = processes()
            present = family.update(found)
            others.update(found, present)
            most += [0.0] * (len(steps()) + 1 - len(most))
            most[-1] = max(most[-1], sum(map(memory_mb, present)))
            time.sleep(PERIOD_S)
    seconds, cpu = time.monotonic() - began, sum(os.times()[2:4]) - cpu_began
    ended = steps()
    most += [0.0] * (len(ended) - len(most))  # steps that began and ended between two looks
    rows = [(name, spent, cpu_s, memory) for (spent, name, cpu_s), memory in zip(ended, most)]
    failed = "" if child.returncode == 0 else f" (failed: {child.returncode})"
    rows.append(("whole" + failed, seconds, cpu, max(most)))
    return child.returncode, rows, others.text(seconds)


def with_before(rows, seconds, cpu):
    """The rows with what was spent before the first step, which is part of the packages and of the whole, the last row."""
    return [(name, spent + seconds, cpu_s + cpu, memory) if name == "packages" or at == len(rows) - 1
            else (name, spent, cpu_s, memory) for at, (name, spent, cpu_s, memory) in enumerate(rows)]


def write(table, began, commit, words, rows, beside):
    if not table.exists():
        table.write_text(HEAD, encoding="utf-8")
    with open(table, "a", encoding="utf-8") as out:
        for name, seconds, cpu, memory in rows:
            fields = (began, commit, " ".join(words), os.cpu_count(), name, f"{seconds:.0f}", f"{cpu:.0f}", f"{memory:.0f}",
                      beside)
            out.write("\t".join(map(str, fields)) + "\n")


def main():
    seconds, cpu, *words = sys.argv[1:]
    commit = commit_of(ROOT, TABLE)
    began = time.strftime("%Y-%m-%d %H:%M")
    status, rows, beside = run(["./dev", *words], {**os.environ, "IOTCLOUD_STEPS": "1"})
    write(TABLE, began, commit, words, with_before(rows, float(seconds), float(cpu)), beside)
    print(f"what it took is in {TABLE.relative_to(ROOT)}")
    return status


if __name__ == "__main__":
    sys.exit(main())
