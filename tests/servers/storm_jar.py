#!/usr/bin/python3
"""Builds topology/storm/java with Maven, once: the classes for Storm's workers, into build/storm/iotcloud-storm.jar.

    storm_jar.py

`./dev test` calls it while it builds, so that no test's time-out pays for the download.
"""
import fcntl
import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

from maven_jars import UNREACHABLE
from private_server import Unavailable, become_child, require_label

ROOT = Path(__file__).resolve().parent.parent.parent
PROJECT = ROOT / "topology" / "storm" / "java"
FOLDER = ROOT / "build" / "storm"
LIMIT_S = 600


def build():
    """Returns the jar. Raises Unavailable when Maven Central cannot be reached, RuntimeError when the build fails."""
    require_label("java")
    digest = hashlib.sha256()
    for file in sorted([PROJECT / "pom.xml", *(PROJECT / "src").rglob("*.java")]):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    FOLDER.mkdir(parents=True, exist_ok=True)
    folder = FOLDER.resolve()
    with open(folder.with_suffix(".lock"), "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        complete = folder / "complete"
        if not complete.exists() or complete.read_text() != digest.hexdigest():
            package(folder)
            complete.write_text(digest.hexdigest())
    return folder / "iotcloud-storm.jar"


def package(folder):
    shutil.rmtree(folder / "target", ignore_errors=True)
    command = ["mvn", "-B", "-q", "-Dstyle.color=never", "-f", str(PROJECT / "pom.xml"), "-Dfolder=%s" % folder, "package"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, timeout=LIMIT_S, preexec_fn=become_child)
    except FileNotFoundError:
        raise RuntimeError("mvn is missing; install Debian's packages maven and openjdk-17-jdk-headless") from None
    except subprocess.TimeoutExpired:
        raise Unavailable("Maven did not build topology/storm/java within %d s" % LIMIT_S) from None
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines() or ["nothing"]
    text = "Maven cannot build topology/storm/java: %s" % said[0]
    if any(sign in done.stdout for sign in UNREACHABLE):
        raise Unavailable(text)
    raise RuntimeError("%s\n%s" % (text, done.stdout))


def main():
    try:
        print(build())
    except (Unavailable, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
