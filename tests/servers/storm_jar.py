#!/usr/bin/python3
"""Builds topology/storm/java with Maven, once: the classes for Storm's workers, into build/storm/iotcloud-storm.jar.

    storm_jar.py

`./dev test` calls it while it builds, so that no test's time-out pays for the download.
"""
import shutil
import sys
from pathlib import Path

from maven_build import build_once, package
from private_server import Unavailable, require_label

ROOT = Path(__file__).resolve().parent.parent.parent
NAME = "topology/storm/java"
PROJECT = ROOT / NAME
FOLDER = ROOT / "build" / "storm"


def build():
    """Returns the jar. Raises Unavailable when Maven Central cannot be reached, RuntimeError when the build fails."""
    require_label("java")
    return build_once([PROJECT / "pom.xml", *(PROJECT / "src").rglob("*.java")], FOLDER, make) / "iotcloud-storm.jar"


def make(folder):
    shutil.rmtree(folder / "target", ignore_errors=True)
    package(PROJECT, NAME, folder)


def main():
    try:
        print(build())
    except (Unavailable, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
