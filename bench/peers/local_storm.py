"""Apache Storm as a peer: builds bench/peers/storm with Maven, and runs one of its topologies in a JVM of its own."""

import functools
import hashlib
import itertools
import json
import os
import selectors
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent.parent / "tests" / "servers"))
from maven_jars import UNREACHABLE  # noqa: E402
from private_cluster import StartError, Unavailable  # noqa: E402
from private_server import die_with_parent, freeze, java_environment  # noqa: E402

PROJECT = HERE / "storm"
BUILD = HERE.parent.parent / "build" / "bench" / "storm"
BUILD_LIMIT_S, START_LIMIT_S, ANSWER_LIMIT_S = 600, 100, 30


def build(folder=BUILD):
    """Builds the project if it is not built yet, and returns its class path. Raises Unavailable, with Maven's reason,
    when that fails."""
    digest = hashlib.sha256()
    for file in sorted([PROJECT / "pom.xml", *(PROJECT / "src").rglob("*")]):
        if file.is_file():
            digest.update(str(file.relative_to(PROJECT)).encode() + b"\0" + file.read_bytes())
    complete = folder / f"complete-{digest.hexdigest()}"
    if not complete.exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        package(folder)
        complete.touch()
    return str(folder / "jars" / "*")


def package(folder):
    command = ["mvn", "-B", "-q", "-Dstyle.color=never", "-f", str(PROJECT / "pom.xml"),
               f"-Dfolder={folder.resolve()}", "package"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, timeout=BUILD_LIMIT_S)
    except FileNotFoundError:
        raise Unavailable("mvn is missing; install Debian's packages maven and openjdk-17-jdk-headless") from None
    except subprocess.TimeoutExpired:
        raise Unavailable(f"Maven did not build bench/peers/storm within {BUILD_LIMIT_S} s") from None
    (folder / "maven.log").write_text(done.stdout)
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines() or ["nothing"]
    cause = "Maven Central cannot be reached" if any(sign in done.stdout for sign in UNREACHABLE) else "Maven failed"
    raise Unavailable(f"{cause}: {said[0]}; all it said is in {folder / 'maven.log'}")


def cpu_seconds_of(process):
    """CPU seconds that a process has used since it began, by the process's CPU clock (clock_getcpuclockid())."""
    return time.clock_gettime(~process << 3 | 2)


numbers = itertools.count(1)  # numbers of the JVMs, for their logs and their nodes in ZooKeeper


class Storm:
    """A JVM with Storm and one topology. It is stopped (SIGSTOP) while it is not its turn, so that its idle threads
    take no CPU from others."""

    def __init__(self, children, class_path, jvm, topology, options, settings):
        """Starts the JVM. `children` end it; `options` are those of Main.java, `settings` those of Storm."""
        self.name = f"storm-{topology}-{next(numbers)}"
        scratch = children.out / self.name
        scratch.mkdir()
        words = [word for option in options for word in map(str, option)]
        words += [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
        command = ["java", *jvm, f"-Djava.io.tmpdir={scratch}", "-Dlog4j2.configurationFile=classpath:bench-log4j2.xml",
                   "-cp", class_path, "iotcloud.bench.storm.Main", topology, "--root", f"/{self.name}", *words]
        self.log = children.log(self.name)
        self.children = children
        killed = functools.partial(die_with_parent, signal.SIGKILL)  # SIGKILL also ends a stopped process
        self.process = children.spawn(self.name, command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                                      env=java_environment(), cwd=scratch, preexec_fn=killed)
        try:
            if not self.answer(START_LIMIT_S)["ready"]:
                self.fail("its topology did nothing within its limit")
        except BaseException:
            self.end()
            raise

    @property
    def pid(self):
        return self.process.pid

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        """Ends this JVM; other processes of `children` go on."""
        self.go_on()
        self.process.stdin.close()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.children.children.remove((self.name, self.process))

    def stand_still(self):
        freeze(self.process)

    def go_on(self):
        self.process.send_signal(signal.SIGCONT)

    def answer(self, limit):
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            if not selector.select(limit):
                self.fail(f"no answer within {limit} s")
        line = self.process.stdout.readline()
        if not line:
            self.fail("it ended")
        return json.loads(line)

    def fail(self, what):
        """Raises an error with the first error in the log, because the log is removed with the benchmark's folder."""
        errors = [line for line in self.log.read_text(errors="replace").splitlines() if " ERROR " in line or "Caused" in line]
        raise StartError(f"Storm: {what}{': ' if errors else ''}{' / '.join(errors[:3])}")

    def ask(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.answer(ANSWER_LIMIT_S)

    def rate(self, seconds):
        """Measures for `seconds`. Returns the results per second, and the CPU seconds that the JVM took per second."""
        before, cpu = self.ask("count"), cpu_seconds_of(self.pid)
        time.sleep(seconds)
        after, cpu = self.ask("count"), cpu_seconds_of(self.pid) - cpu
        took = (after["at_ns"] - before["at_ns"]) / 1e9
        return {"per_second": (after["results"] - before["results"]) / took, "cpus": cpu / took, "seconds": took}

    def check_complete(self):
        """Stops sending, and checks that all that was sent has arrived."""
        end = self.ask("drain")
        if end["results"] != end["expected"] or end["failed"]:
            raise StartError(f"Storm: {end['results']} of {end['expected']} results arrived, {end['failed']} failed")
