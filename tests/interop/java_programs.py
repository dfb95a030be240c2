#!/usr/bin/python3
"""Builds the Java programs of this folder with Maven, once: java/ into build/interop. What they need comes from Maven
Central, and the original's records from its definition by Thrift's compiler.

    java_programs.py

`./dev test` calls it while it builds, so that no test's time-out pays for the download.
"""

import fcntl
import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent / "servers"))

from maven_jars import UNREACHABLE  # noqa: E402
from private_server import Unavailable, become_child  # noqa: E402

PROJECT = HERE / "java"
DEFINITIONS = (ROOT / "tests/master/originals/original.thrift", HERE / "envelope.thrift")
FOLDER = ROOT / "build" / "interop"
LIMIT_S = 600


def build():
    """Returns the class path. Raises Unavailable when Maven Central cannot be reached, RuntimeError when the build
    fails."""
    digest = hashlib.sha256()
    for file in sorted([PROJECT / "pom.xml", *DEFINITIONS, *(PROJECT / "src").rglob("*.java")]):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    FOLDER.mkdir(parents=True, exist_ok=True)
    folder = FOLDER.resolve()
    with open(folder.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        complete = folder / f"complete-{digest.hexdigest()}"
        if not complete.exists():
            shutil.rmtree(folder)
            folder.mkdir()
            generate(folder)
            package(folder)
            complete.touch()
    return str(folder / "jars" / "*")


def generate(folder):
    for definition in DEFINITIONS:
        copy = folder / definition.name  # the original's definition names no package
        copy.write_text("namespace java interop.original\n" + definition.read_text())
        (folder / "generated").mkdir(exist_ok=True)
        subprocess.run(["thrift", "-gen", "java:generated_annotations=suppress", "-out", folder / "generated", copy],
                       check=True)


def package(folder):
    command = ["mvn", "-B", "-q", "-Dstyle.color=never", "-f", str(PROJECT / "pom.xml"), f"-Dfolder={folder}", "package"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, timeout=LIMIT_S, preexec_fn=become_child)
    except FileNotFoundError:
        raise RuntimeError("mvn is missing; install Debian's packages maven and openjdk-17-jdk-headless") from None
    except subprocess.TimeoutExpired:
        raise Unavailable(f"Maven did not build tests/interop/java within {LIMIT_S} s") from None
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines() or ["nothing"]
    text = f"Maven cannot build tests/interop/java: {said[0]}"
    if any(sign in done.stdout for sign in UNREACHABLE):
        raise Unavailable(text)
    raise RuntimeError(f"{text}\n{done.stdout}")


def main():
    try:
        build()
    except (Unavailable, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
