"""Runs a script of this folder in node, with playwright-core and Debian's Chromium. A line that the script prints and that
begins with "DO " is for the test, which answers when it has done that."""
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import npm_packages

HERE = Path(__file__).resolve().parent


def run_script(name, options, do):
    """Ends the test when the script fails. `do`: called with the words of each "DO ..."; what it returns is the answer, JSON."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("there is no Chromium; install Debian's package chromium")
    try:
        packages = npm_packages.packages()
    except npm_packages.Unavailable as problem:
        sys.exit(str(problem))
    pictures = npm_packages.ROOT / "build/console"
    pictures.mkdir(parents=True, exist_ok=True)
    settings = {**options, "chromium": chromium, "packages": str(packages / "node_modules"), "pictures": str(pictures),
                "root": os.geteuid() == 0}
    with subprocess.Popen(["node", HERE / name, json.dumps(settings)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as script:
        for line in script.stdout:
            if not line.startswith("DO "):
                print(line, end="", flush=True)
                continue
            script.stdin.write(json.dumps(do(line.split()[1:])) + "\n")
            script.stdin.flush()
    if script.returncode:
        sys.exit(f"wrong: {name} ended with {script.returncode}")
