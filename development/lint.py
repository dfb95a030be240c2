#!/usr/bin/python3
"""Runs clang-tidy on the sources of the tree, as many at once as there are cores.

usage: lint.py --build FOLDER [--since COMMIT] [--in-time]
       FOLDER: configured without unity builds and precompiled headers

It looks at all sources, or at those sources and headers that changed since COMMIT; files that git does not know yet
belong to both. Each file is read alone, so one that forgets an include is found. With --in-time no further file is
started after the `lint_seconds` of limits.json, which are a part of its `minutes`; the last line says how many files
were left out, and which. It then begins at another file with each commit, so that a machine that begins with an empty FOLDER
each time gets round to all. FOLDER/left_out names them, too: the next run looks at them first, whatever has changed since its
COMMIT, and ./dev test tells them in its summary. A file that was found clean is not looked at again until it, a header, a
definition in Thrift, a CMake file or clang-tidy's options change: FOLDER/clean remembers it. The exit status is 1 when
clang-tidy found something.
"""
import argparse
import concurrent.futures
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from progress import Teller, in_minutes  # noqa: E402

LIMITS = Path(__file__).resolve().parent / "limits.json"


def git_files(*words):
    said = subprocess.run(["git", *words], capture_output=True, check=True, text=True).stdout
    return [file for file in said.split("\0") if file]


def changed_files(since):
    """All files that differ from a commit, also those that are gone and those that git does not know."""
    return {*git_files("diff", "-z", "--name-only", "--no-renames", since),
            *git_files("ls-files", "-z", "--others", "--exclude-standard")}


def chosen(since):
    """The files to look at: all sources, or the sources and headers that changed since a commit."""
    if since is not None:
        return sorted(file for file in changed_files(since) if file.endswith((".cc", ".h")))
    return sorted(git_files("ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", "*.cc"))


def begun_elsewhere(files):
    """The files in their order, from one on that depends on the commit."""
    if not files:
        return files
    begin = int(git_files("rev-parse", "HEAD")[0], 16) % len(files)
    return files[begin:] + files[:begin]


class Progress:
    """How far the work is, for Teller."""

    def __init__(self, count, seconds):
        self.done, self.all, self.seconds = 0, count, seconds
        self.began = time.monotonic()

    def spent(self):
        return time.monotonic() - self.began

    def share(self):
        return max(self.done / self.all if self.all else 1.0, min(self.spent() / self.seconds, 1.0))

    def text(self):
        return f"{self.done} of {self.all} files", ""


def left_out_before(file):
    """The files that the run before had no time for."""
    return file.read_text(encoding="utf-8").splitlines() if file.exists() else []


def look_at(build, file, remembered):
    mark = remembered.mark_of(file)  # before clang-tidy reads it: it may be changed meanwhile
    done = subprocess.run(["clang-tidy-14", "-p", build, "--quiet", file], stdin=subprocess.DEVNULL,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    if done.returncode == 0:
        mark.touch()
    return file, done.returncode, done.stdout


class Remembered:
    """The files that were found clean, each by a digest of all that clang-tidy reads for it."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        listed = git_files("ls-files", "-z", "--cached", "--others", "--exclude-standard")
        self.shared = hashlib.sha256()
        for file in sorted(listed):
            if file.endswith((".h", ".thrift", ".cmake", "CMakeLists.txt", "CMakePresets.json", ".clang-tidy")):
                self.add(self.shared, file)

    def is_clean(self, file):
        return self.mark_of(file).exists()

    def mark_of(self, file):
        digest = self.shared.copy()
        self.add(digest, file)
        return self.folder / digest.hexdigest()

    @staticmethod
    def add(digest, file):
        path = Path(file)
        text = path.read_bytes() if path.exists() else b""
        digest.update(f"{file} {len(text)} ".encode() + text)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--build", required=True)
    parser.add_argument("--since")
    parser.add_argument("--in-time", action="store_true")
    given = parser.parse_args()
    seconds = json.loads(LIMITS.read_text(encoding="utf-8"))["lint_seconds"] if given.in_time else float("inf")
    remembered = Remembered(Path(given.build) / "clean")
    memory = Path(given.build) / "left_out"
    listed = begun_elsewhere(chosen(given.since)) if given.in_time else chosen(given.since)
    named = [file for file in dict.fromkeys([*left_out_before(memory), *listed]) if Path(file).exists()]
    files = [file for file in named if not remembered.is_clean(file)]
    print(f"lint: {len(named)} files" + (f" changed since {given.since[:12]}, or left out before" if given.since else "") +
          f"; {len(named) - len(files)} are as they were when they were found clean", flush=True)
    work, bad = Progress(len(files), seconds), 0
    teller = Teller("lint", work, sys.stdout)
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        waiting = iter(files)
        running = set()
        left_out = []
        while True:
            while len(running) < os.cpu_count() and work.spent() < seconds:
                file = next(waiting, None)
                if file is None:
                    break
                running.add(pool.submit(look_at, given.build, file, remembered))
            if not running:
                left_out = list(waiting)
                break
            finished, running = concurrent.futures.wait(running, timeout=1, return_when=concurrent.futures.FIRST_COMPLETED)
            for result in finished:
                file, status, said = result.result()
                work.done += 1
                if status != 0:
                    bad += 1
                    teller.say(f"{file}:\n{said}")
            teller.tick()
    teller.end()
    closing = f"lint: {work.done} files, {bad} with findings, {in_minutes(work.spent())}"
    if left_out:
        closing += f"; {len(left_out)} left out after {seconds:.0f} s: {' '.join(left_out)}"
    print(closing)
    memory.write_text("".join(f"{file}\n" for file in left_out), encoding="utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
