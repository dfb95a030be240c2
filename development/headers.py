#!/usr/bin/python3
"""Prints the targets that compile public headers alone, for those that a change may have broken.

usage: headers.py BUILD_FOLDER [--since COMMIT]      BUILD_FOLDER: configured with CMAKE_VERIFY_INTERFACE_HEADER_SETS

With --since: the headers that changed, or that include a file which changed, also through others; those of a folder whose
CMakeLists.txt changed; and all, when something changed that all depend on. Without: all. Each header takes more than a
second, so all of them take minutes.
"""
import argparse
import re
import subprocess
import sys
from pathlib import Path

from lint import changed_files

INCLUDE = re.compile(r"^\s*#\s*include\s*[<\"]iotcloud/([^>\"]+)[>\"]", re.MULTILINE)
OF_ALL = re.compile(r"^cmake/|\.thrift$|^CMake(Lists\.txt|Presets\.json)$")
TARGET = re.compile(r"^(\S+_verify_interface_header_sets/iotcloud/(\S+)\.cxx\.o):", re.MULTILINE)


class Includes:
    """What each file includes, directly or through others."""

    def __init__(self, tree):
        self.tree, self.known = Path(tree), {}

    def of(self, file):
        """The file and all that it includes."""
        found, waiting = set(), [file]
        while waiting:
            file = waiting.pop()
            if file not in found:
                found.add(file)
                waiting += self.direct(file)
        return found

    def direct(self, file):
        if file not in self.known:
            path = self.tree / file
            self.known[file] = INCLUDE.findall(path.read_text(encoding="utf-8")) if path.exists() else []
        return self.known[file]


def affected(headers, changed, includes):
    """Those of the headers that the changed files may have broken."""
    if any(map(OF_ALL.search, changed)):
        return headers
    folders = tuple(file.removesuffix("CMakeLists.txt") for file in changed if file.endswith("/CMakeLists.txt"))
    return [header for header in headers if header.startswith(folders) or not includes.of(header).isdisjoint(changed)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("--since")
    given = parser.parse_args()
    listed = subprocess.run(["ninja", "-C", str(given.build), "-t", "targets", "all"], capture_output=True, text=True,
                            check=True).stdout
    targets = {header: target for target, header in TARGET.findall(listed)}
    if not targets:
        sys.exit(f"headers.py: {given.build} has no targets that compile headers alone")
    headers = sorted(targets)
    if given.since is not None:
        headers = affected(headers, set(changed_files(given.since)), Includes("."))
    print(*(targets[header] for header in headers))


if __name__ == "__main__":
    main()
