"""What all benchmarks share: running their programs, printing figures, and describing the machine."""

import json
import os
import platform
import shlex
import subprocess
import time


LIMIT_S = 600  # how long one program may take


class ProgramFailed(Exception):
    """A measuring program failed; the text has all that it printed."""


class Programs:
    """The programs bench_PREFIX_NAME that CMake built for one benchmark."""

    def __init__(self, folder, prefix):
        self.folder, self.prefix = folder, prefix

    def path(self, name):
        return self.folder / f"bench_{self.prefix}_{name}"

    def has(self, name):
        return self.path(name).exists()

    def run(self, name, *arguments):
        """Runs a program and returns the lines of JSON that it prints. Raises ProgramFailed when it fails: its figures
        would mean nothing."""
        return [json.loads(line) for line in self.output(name, *arguments).splitlines()]

    def output(self, name, *arguments):
        """Runs a program and returns what it prints. Raises ProgramFailed."""
        command = [str(self.path(name)), *map(str, arguments)]
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
    """Collects a benchmark's results in the form of its JSON file and why it failed, and counts the targets that were met."""

    def __init__(self):
        self.results = []
        self.reasons = []

    def fail(self, reason):
        """Says that this makes the run a failed one, whose figures cannot be kept, and notes it for the file."""
        if reason not in self.reasons:
            print(reason, flush=True)
            self.reasons.append(reason)

    @property
    def failed(self):
        """Why the run failed, in one text; empty for a good run."""
        return "; ".join(self.reasons)

    def written(self):
        """What the benchmark's file has of this: a failed run's has the key `failed`, by which kept.py refuses it."""
        return {"results": self.results, **({"failed": self.failed} if self.reasons else {})}

    def verdict(self):
        judged = {}
        for result in self.results:
            if result["met"] is not None:  # `results` has a figure once for each baseline
                judged[result["name"]] = judged.get(result["name"], True) and result["met"]
        missed = [name for name, met in judged.items() if not met]
        lines = [f"{len(judged) - len(missed)} of {len(judged)} targets met"]
        lines += [f"  missed: {name}" for name in missed]
        return "\n".join(lines + ["  bench/causes.toml says why, as far as it is known"] * bool(missed))


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


def command_line(arguments):
    """The benchmark's command as a person types it: without the options that say where the programs are and where the
    figures go."""
    kept, places = [], ("--build", "--json", "--out")
    for before, argument in zip(["", *arguments], arguments):
        if before not in places and argument not in places and not argument.startswith(tuple(f"{place}=" for place in places)):
            kept.append(argument)
    return shlex.join(["./dev", "bench", *kept])


def begin(root):
    """What write() needs to know of the moment before a benchmark: the tree may be changed while it runs."""
    return {"began": time.monotonic(), "machine": machine(), "commit": commit(root)}


def write(file, command, begun, facts, results):
    """Writes a benchmark's file: `command` as a person types it, `begun` of begin(), `facts` beside these (versions, say),
    `results` in the form that all benchmarks share."""
    written = {"machine": begun["machine"], "commit": begun["commit"], "command": command,
               "seconds": time.monotonic() - begun["began"], **facts, "results": results}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
    print(f"figures: {file}")
