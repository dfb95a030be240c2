#!/usr/bin/python3
"""Repeats the release suite until RUNS runs in a row are without a failure, half of them beside processes that keep all
cores busy: it finds tests that depend on how busy the machine is.

usage: ./dev test --repeat RUNS [CTEST OPTIONS]      (it builds, and runs this file)

One line for each run is added to development/repeats.tsv: number, commit, idle or loaded, begin, seconds, tests, failed,
and the names of those that failed; what they printed is in build/repeat/run-NUMBER.log. Stopped and started again, also
on another day and with another commit, it goes on after the last line: the runs since the last one that failed count. A
run that fails ends it with the exit status 1; the next start begins the row anew. With options of ctest, which choose tests,
the lines go into a table of these options under build/repeat/ instead.
"""
import argparse
import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

TREE = Path(__file__).resolve().parents[1]
PR_SET_PDEATHSIG = 1
HEAD = "run\tcommit\tmachine\tbegan\tseconds\ttests\tfailed\tnames\n"
SUMMARY = re.compile(r"(\d+)% tests passed, (\d+) tests failed out of (\d+)")
FAILED = re.compile(r"^\s+\d+ - (\S+) \((?!Skipped)", re.MULTILINE)


def commit_of(tree, table):
    """The commit of the tree, with "-modified" when another file than the table differs from it."""
    def git(*words):
        return subprocess.run(["git", "-C", str(tree), *words], capture_output=True, text=True, check=True).stdout.strip()
    excluded = [f":(exclude){table.relative_to(tree)}"] if table.is_relative_to(tree) else []
    changes = git("status", "--porcelain", "--", ".", *excluded)
    return git("rev-parse", "--short", "HEAD") + ("-modified" if changes else "")


def table_for(options, out):
    """Where the lines of runs with these options of ctest stand: runs of chosen tests say nothing about the suite."""
    if not options:
        return TREE / "development/repeats.tsv"
    return out / f"chosen{re.sub('[^A-Za-z0-9_]+', '-', ' '.join(options))}.tsv"


def die_with_parent():
    ctypes.CDLL("libc.so.6").prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def burners():
    """Starts a process for each core that only computes."""
    return [subprocess.Popen([sys.executable, "-c", "while True: pass"], preexec_fn=die_with_parent)
            for _ in range(os.cpu_count())]


def outcome(said):
    """Returns the number of tests and the failed ones from what ctest printed. Raises ValueError without a summary."""
    summary = SUMMARY.search(said)
    if not summary:
        raise ValueError("ctest ended without a summary")
    return int(summary[3]), sorted(FAILED.findall(said[summary.end():]))


def read_with_progress(output):
    """Reads all of ctest's output, and shows meanwhile how far it is."""
    said = []
    with subprocess.Popen([sys.executable, TREE / "development/progress.py", "tests", "testing"], stdin=subprocess.PIPE,
                          text=True, errors="replace") as progress:
        for line in output:
            said.append(line)
            progress.stdin.write(line)
            progress.stdin.flush()
    return "".join(said)


def clean_row(lines):
    """The lines of the last runs in a row without a failure."""
    row = []
    for line in reversed(lines):
        if line.split("\t")[6] != "0":
            break
        row.insert(0, line)
    return row


def is_loaded_next(row):
    """Whether the row's next run is beside busy cores, so that half of the row is."""
    loaded = sum(line.split("\t")[2] == "loaded" for line in row)
    return loaded < len(row) - loaded


def run_suite(build, options):
    """Runs the suite, as many tests at a time as ./dev test does, and returns ctest's output. An interrupt ends its tests and
    their servers too."""
    command = ["ctest", "--test-dir", str(build), "--output-on-failure", "-j", str(3 * os.cpu_count()), "-LE", "^long$",
               *options]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          errors="replace", start_new_session=True) as suite:
        try:
            return read_with_progress(suite.stdout)
        except BaseException:
            os.killpg(suite.pid, signal.SIGKILL)
            raise


def main():
    parser = argparse.ArgumentParser(prog="./dev test --repeat", description=__doc__.split("\n")[0])
    parser.add_argument("runs", type=int, metavar="RUNS", help="how many runs in a row are to be without a failure")
    parser.add_argument("--build", type=Path, default=Path("build/release"), help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("build/repeat"), help=argparse.SUPPRESS)
    given, options = parser.parse_known_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    given.out.mkdir(parents=True, exist_ok=True)
    table = table_for(options, given.out)
    if not table.exists():
        table.write_text(HEAD)
    commit = commit_of(TREE, table)
    lines = table.read_text().splitlines()[1:]
    row = clean_row(lines)
    while len(row) < given.runs:
        number, loaded = len(lines) + 1, is_loaded_next(row)
        print(f"run {number}, {len(row) + 1} of {given.runs} in a row: "
              f"{'beside busy cores' if loaded else 'the machine to itself'}", flush=True)
        began = time.strftime("%Y-%m-%dT%H:%M:%S")
        start = time.monotonic()
        busy = burners() if loaded else []
        try:
            said = run_suite(given.build, options)
        finally:
            for process in busy:
                process.kill()
                process.wait()
        (given.out / f"run-{number}.log").write_text(said)
        tests, names = outcome(said)
        lines.append("\t".join([str(number), commit, "loaded" if loaded else "idle", began,
                                f"{time.monotonic() - start:.0f}", str(tests), str(len(names)), " ".join(names)]))
        with open(table, "a", encoding="utf-8") as file:
            file.write(lines[-1] + "\n")
        print(lines[-1], flush=True)
        if names:
            print(f"run {number} failed: the row begins anew; {given.out / f'run-{number}.log'} says why")
            return 1
        row = clean_row(lines)
    print(f"{len(row)} runs in a row without a failure; {table}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
