#!/usr/bin/python3
"""Builds the Java programs of this folder with Maven, once: java/ into build/interop. What they need comes from Maven
Central, and the original's records from its definition by Thrift's compiler.

    java_programs.py

`./dev test` calls it while it builds, so that no test's time-out pays for the download.
"""

import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent / "servers"))

from maven_build import build_once, package  # noqa: E402
from private_server import Unavailable  # noqa: E402

PROJECT = HERE / "java"
DEFINITIONS = (ROOT / "tests/master/originals/original.thrift", HERE / "envelope.thrift")
FOLDER = ROOT / "build" / "interop"


def build():
    """Returns the class path. Raises Unavailable when Maven Central cannot be reached, RuntimeError when the build
    fails."""
    sources = [PROJECT / "pom.xml", *DEFINITIONS, *(PROJECT / "src").rglob("*.java")]
    return str(build_once(sources, FOLDER, make) / "jars" / "*")


def make(folder):
    shutil.rmtree(folder)
    folder.mkdir()
    generate(folder)
    package(PROJECT, "tests/interop/java", folder)


def generate(folder):
    for definition in DEFINITIONS:
        copy = folder / definition.name  # the original's definition names no package
        copy.write_text("namespace java interop.original\n" + definition.read_text())
        (folder / "generated").mkdir(exist_ok=True)
        subprocess.run(["thrift", "-gen", "java:generated_annotations=suppress", "-out", folder / "generated", copy],
                       check=True)


def main():
    try:
        build()
    except (Unavailable, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
