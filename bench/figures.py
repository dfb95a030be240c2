"""What all benchmarks share: their programs, how figures are written, and what is said about the machine."""

import json
import os
import platform
import shlex
import subprocess


LIMIT_S = 600  # of one program


class ProgramFailed(Exception):
    """A program that measures found something wrong; the text has all that it said."""


class Programs:
    """What CMake built for one benchmark: bench_PREFIX_NAME."""

    def __init__(self, folder, prefix):
        self.folder, self.prefix = folder, prefix

    def has(self, name):
        return (self.folder / f"bench_{self.prefix}_{name}").exists()

    def run(self, name, *arguments):
        """The lines of JSON that a program prints. Raises ProgramFailed: its figures would mean nothing."""
        return [json.loads(line) for line in self.output(name, *arguments).splitlines()]

    def output(self, name, *arguments):
        """What a program prints. Raises ProgramFailed."""
        command = [str(self.folder / f"bench_{self.prefix}_{name}"), *map(str, arguments)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
        except subprocess.TimeoutExpired as late:
            raise ProgramFailed(f"{shlex.join(command)} did not end within {LIMIT_S} s") from late
        if done.returncode != 0:
            raise ProgramFailed(
                f"{shlex.join(command)} failed with status {done.returncode}:\n{done.stderr}{done.stdout}"
            )
        return done.stdout


class Verdict:
    """The results of a benchmark in the form of its JSON file, and how many targets were met."""

    def __init__(self):
        self.results = []
        self.failed = False

    def verdict(self):
        judged = {}
        for result in self.results:
            if result["met"] is not None:  # a figure stands there once for each of what is beside it
                judged[result["name"]] = judged.get(result["name"], True) and result["met"]
        missed = [name for name, met in judged.items() if not met]
        lines = [f"{len(judged) - len(missed)} of {len(judged)} targets met"]
        lines += [f"  missed: {name}" for name in missed]
        return "\n".join(lines + ["  bench/README.md says why"] * bool(missed))


def number(value):
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if abs(value) >= 100:
        return f"{value:,.0f}"
    if abs(value) < 0.001 and value != 0:
        return f"{value:.0e}"
    return f"{value:.3g}"


def machine():
    with open("/proc/cpuinfo", encoding="ascii", errors="replace") as cpuinfo:
        model = next((line.split(":", 1)[1].strip() for line in cpuinfo if line.startswith("model name")), "unknown")
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "memory_mb": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20,
        "kernel": platform.release(),
        "load_average_before": os.getloadavg()[0],
    }


def commit(root):
    def git(*arguments):
        return subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True).stdout.strip()

    return git("rev-parse", "HEAD") + ("-modified" if git("status", "--porcelain") else "")
