#!/usr/bin/python3
"""Fetches the packages of the console's page and of its tests, which package-lock.json locks, with npm, once, into
build/npm. None of their scripts runs, so playwright-core fetches no browser.

usage: npm_packages.py     (prints the folder with package.json and node_modules)
"""
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "master/console/page"
LOCKED = ("package.json", "package-lock.json")
LIMIT_S = 600


class Unavailable(Exception):
    """The packages cannot be fetched; the text says why."""


def packages():
    """The folder in which they are. Raises Unavailable."""
    folder = ROOT / "build/npm"
    version = hashlib.sha256(b"".join((PAGE / name).read_bytes() for name in LOCKED)).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    with open(ROOT / "build/npm.lock", "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        complete = folder / "complete"
        if not complete.exists() or complete.read_text() != version:
            complete.unlink(missing_ok=True)
            for name in LOCKED:
                shutil.copy(PAGE / name, folder)
            fetch(folder)
            complete.write_text(version)
    return folder


def fetch(folder):
    npm = shutil.which("npm")
    if npm is None:
        raise Unavailable("there is no npm; install nodejs and npm (Debian's packages of these names)")
    try:
        done = subprocess.run([npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"], cwd=folder, text=True,
                              capture_output=True, timeout=LIMIT_S, env={**os.environ, "PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD": "1"})
    except subprocess.TimeoutExpired as error:
        raise Unavailable(f"npm ci did not end within {LIMIT_S} s") from error
    if done.returncode:
        raise Unavailable(f"npm ci failed: {(done.stderr or done.stdout).strip()[-2000:]}")


if __name__ == "__main__":
    try:
        print(packages())
    except Unavailable as problem:
        sys.exit(str(problem))
