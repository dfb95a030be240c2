#!/usr/bin/python3
"""Summarises a test run from the JUnit files that ctest wrote.

usage: summary.py [--ci] [--steps FILE] [--table FILE] [--left-out FILE] [--not-built PRESETS] [--whole] [JUNIT_FILE]...

Prints the time of each step (FILE: "seconds<TAB>name<TAB>what pace.py said<TAB>seconds of CPU" a line), the ten slowest
tests, what was skipped and why, which of the chosen tests CMake left out and what is missing for them (tests_left_out.tsv
beside a JUnit file), what failed, and in the end "N passed, N failed, N skipped". With --ci a test that was left out is a
failure; so is a skip, unless the `skips_allowed` of limits.json name the test and the cause that it told, and this machine has
that cause (`CAUSES`), and, with --whole, a run that took longer than its `minutes`. These
are minutes of a machine where pace.py takes `pace_s` seconds: a slower machine is allowed more, in proportion, up to
`slower_at_most` times as much. --table: one line for each test. --left-out: a file that names the sources that lint.py had no
time for; they are told before the last line. --not-built: presets whose build failed; each counts as a failed test. The exit status is 1 after a failure.
"""
import argparse
import ctypes
import json
import os
import re
import statistics
import subprocess
import sys
import time
import xml.etree.ElementTree as xml
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, NamedTuple

LIMITS = Path(__file__).resolve().parent / "limits.json"
SLOWEST = 10


def landlock():
    """The version of Landlock in this kernel; -1: it has none, or it is off."""
    create_ruleset, tell_version = 444, 1
    return ctypes.CDLL(None).syscall(create_ruleset, None, 0, tell_version)


class Cause(NamedTuple):
    """Why a test may be skipped: what tests say then, and whether it is so here."""
    said: re.Pattern
    is_here: Callable[[], bool]


CAUSES = {
    "Landlock older than 1": Cause(re.compile("no Landlock"), lambda: landlock() < 1),
    "Landlock older than 4": Cause(re.compile("cannot restrict connections"), lambda: landlock() < 4),
    "no camera": Cause(re.compile("no camera"), lambda: not Path("/dev/video0").exists()),
    "no AVX2": Cause(re.compile("no AVX2"), lambda: "avx2" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split()),
    # Version 2 of cgroups has one tree there, version 1 one in each folder.
    "no cgroup to write to": Cause(re.compile("no cgroups in|no cgroup of its own"),
                                   lambda: not any(os.access(file, os.W_OK) for pattern in ("cgroup.procs", "*/cgroup.procs")
                                                   for file in Path("/sys/fs/cgroup").glob(pattern))),
    # Of version 2 of cgroups: a group counts what the one above it says.
    "no count of processes": Cause(re.compile("no group of processes here counts them"),
                                   lambda: (file := Path("/sys/fs/cgroup/cgroup.subtree_control")).exists() and
                                           "pids" not in file.read_text(encoding="utf-8").split()),
    "no name spaces": Cause(re.compile("no name spaces"),
                            lambda: subprocess.run(["unshare", "--mount", "--pid", "--fork", "true"],
                                                   stderr=subprocess.DEVNULL).returncode != 0),
    "not root": Cause(re.compile("only root (can|may)"), lambda: os.geteuid() != 0),
}


def allowed(name, reason, skips_allowed):
    """The cause for which a test may be skipped on this machine, which is the one that it told; None: there is none."""
    causes = [cause for pattern, named in skips_allowed.items() if re.search(pattern, name) for cause in named]
    return next((cause for cause in causes if CAUSES[cause].said.search(reason) and CAUSES[cause].is_here()), None)


# How GoogleTest, unittest and the scripts of this tree print why a test was skipped.
REASON = re.compile(r"^(?:.*: Skipped|SKIPPED? |.*\.\.\. skipped )(.*)$", re.MULTILINE)


@dataclass
class Test:
    preset: str
    name: str
    seconds: float
    outcome: str  # "passed", "failed" or "skipped"
    said: str

    def full_name(self):
        return f"{self.name} ({self.preset})"

    def reason(self):
        """Why the test was skipped: its text after the word, or its last line."""
        lines = [line.strip() for line in self.said.splitlines() if line.strip() and not line.startswith("[")]
        for at, line in enumerate(lines):
            if line.endswith(": Skipped") and at + 1 < len(lines):
                return lines[at + 1]
            if found := REASON.match(line):
                return found[1].strip(" '\"") or line
        return lines[-1] if lines else "it did not say why"


def read(file):
    """Reads the tests in one JUnit file of ctest; the preset is the name of its folder."""
    tests = []
    for case in xml.parse(file).getroot().iter("testcase"):
        if case.get("status") == "disabled":
            continue
        outcome = "passed" if case.get("status") == "run" else "failed"
        if case.find("skipped") is not None or case.get("status") == "notrun":
            outcome = "skipped"
        elif case.find("failure") is not None:
            outcome = "failed"
        tests.append(Test(Path(file).parent.name, case.get("name"), float(case.get("time", 0)), outcome,
                          case.findtext("system-out", "")))
    return tests


def left_out(file):
    """[name of the test, what is missing for it] of those that are not in a JUnit file of ctest, because CMake left them out."""
    listed = Path(file).parent / "tests_left_out.tsv"
    return [line.split("\t") for line in listed.read_text(encoding="utf-8").splitlines()] if listed.exists() else []


def in_minutes(seconds):
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def report(tests, missing, steps, limits, ci, whole):
    """Prints the report. Returns what is wrong besides failed tests, one text for each fault."""
    wrong = []
    if steps:
        print("\nsteps:")
        for seconds, name, _, cpu in steps:
            print(f"  {in_minutes(seconds):>9}  {name} ({in_minutes(cpu)} of CPU)")
        total = sum(seconds for seconds, _, _, _ in steps)
        measured = statistics.median(pace for _, _, pace, _ in steps) / limits["pace_s"]
        slower = min(max(1.0, measured), limits["slower_at_most"])
        most = 60 * limits["minutes"] * slower
        why = f"the {limits['minutes']} min of {LIMITS.name}, and {slower:.2f} times as much at this machine's pace"
        cpu = sum(cpu for _, _, _, cpu in steps)
        print(f"  {in_minutes(total):>9}  in all ({in_minutes(cpu)} of CPU); {in_minutes(most)} are allowed: {why}")
        if ci and whole and total > most:
            wrong.append(f"the whole took {in_minutes(total)}; {in_minutes(most)} are allowed: {why}")
    print(f"\nthe {SLOWEST} slowest tests:")
    for test in sorted(tests, key=lambda test: -test.seconds)[:SLOWEST]:
        print(f"  {test.seconds:>7.1f} s  {test.full_name()}")
    skipped = [test for test in tests if test.outcome == "skipped"]
    if skipped:
        print("\nskipped:")
    for test in skipped:
        cause = allowed(test.name, test.reason(), limits["skips_allowed"])
        print(f"  {test.full_name()}: {test.reason()}" + (f" [allowed: {cause}]" if cause else ""))
        if ci and cause is None:
            wrong.append(f"{test.full_name()} was skipped, which {LIMITS.name} does not allow on this machine")
    if missing:
        print("\nleft out:")
    for name, what in missing:
        print(f"  {name}: {what}")
        if ci:
            wrong.append(f"{name} was left out: {what}")
    failed = [test for test in tests if test.outcome == "failed"]
    if failed:
        print("\nfailed:")
    for test in failed:
        print(f"  {test.full_name()}, {test.seconds:.1f} s")
    for text in wrong:
        print(f"\nwrong: {text}")
    return wrong


def write_table(file, tests):
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True).stdout.strip()
    file.parent.mkdir(parents=True, exist_ok=True)
    with open(file, "w", encoding="utf-8") as out:
        out.write(f"# commit {commit}, {time.strftime('%Y-%m-%d %H:%M')}\npreset\ttest\toutcome\tseconds\n")
        for test in sorted(tests, key=lambda test: test.name):
            out.write(f"{test.preset}\t{test.name}\t{test.outcome}\t{test.seconds:.2f}\n")
    print(f"\nthe table of all tests is {file}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--ci", action="store_true")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--steps", type=Path)
    parser.add_argument("--table", type=Path)
    parser.add_argument("--left-out", type=Path)
    parser.add_argument("--not-built", default="")
    parser.add_argument("files", nargs="*", type=Path)
    given = parser.parse_args()
    limits = json.loads(LIMITS.read_text(encoding="utf-8"))
    tests = [Test(preset, "building", 0, "failed", "") for preset in given.not_built.split()]
    tests += [test for file in given.files for test in read(file)]
    missing = [each for file in given.files for each in left_out(file)]
    steps = []
    if given.steps:
        for line in given.steps.read_text(encoding="utf-8").splitlines():
            seconds, name, pace, cpu = line.split("\t")
            steps.append((float(seconds), name, float(pace), float(cpu)))
    wrong = report(tests, missing, steps, limits, given.ci, given.whole)
    if given.table:
        write_table(given.table, tests)
    if given.left_out and given.left_out.exists() and (names := given.left_out.read_text(encoding="utf-8").split("\n")[:-1]):
        print(f"\nclang-tidy had no time for {len(names)} files, and looks at them first the next time (or ./dev lint COMMIT): "
              f"{' '.join(names)}")
    count = {outcome: sum(test.outcome == outcome for test in tests) for outcome in ("passed", "failed", "skipped")}
    print(f"\n{count['passed']} passed, {count['failed'] + len(wrong)} failed, {count['skipped']} skipped" +
          (f", {len(missing)} left out" if missing else ""))
    return 1 if count["failed"] or wrong or not tests else 0


if __name__ == "__main__":
    sys.exit(main())
