#!/usr/bin/python3
"""The built page in the tree is what its sources make, byte by byte, and small.

usage: bundle_test.py [--write]     (--write: builds it into the tree)
"""
import gzip
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import npm_packages

MOST_GZIPPED = 300_000  # bytes, of all files together


def build(out):
    """Builds the page in a folder beside its packages, because esbuild looks for them there."""
    folder = npm_packages.packages()
    with tempfile.TemporaryDirectory(prefix="page-", dir=folder) as copy:
        for name in ("src", "build.mjs", "package.json", "tsconfig.json"):
            source = npm_packages.PAGE / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, Path(copy) / name)
        checked = subprocess.run([folder / "node_modules/.bin/tsc", "--noEmit"], cwd=copy, capture_output=True, text=True)
        if checked.returncode:
            sys.exit(f"wrong: TypeScript says of the page's sources:\n{checked.stdout}{checked.stderr}")
        subprocess.run(["node", "build.mjs", out], cwd=copy, check=True)


def main():
    tree = npm_packages.PAGE / "built"
    with tempfile.TemporaryDirectory(prefix="iotcloud-page-") as folder:
        made = Path(folder)
        build(made)
        if sys.argv[1:] == ["--write"]:
            shutil.rmtree(tree, ignore_errors=True)
            shutil.copytree(made, tree)
            return
        names = {file.name for file in made.iterdir()} | {file.name for file in tree.iterdir()}
        for name in sorted(names):
            ours, theirs = tree / name, made / name
            if not ours.exists() or not theirs.exists() or ours.read_bytes() != theirs.read_bytes():
                sys.exit(f"wrong: master/console/page/built/{name} is not what the sources make; ./dev console builds it")
        size = sum(len(gzip.compress(file.read_bytes())) for file in made.iterdir())
        if size > MOST_GZIPPED:
            sys.exit(f"wrong: the page has {size} bytes gzipped, more than {MOST_GZIPPED}")
        print(f"the page has {size} bytes gzipped")


if __name__ == "__main__":
    try:
        main()
    except npm_packages.Unavailable as problem:
        sys.exit(str(problem))
