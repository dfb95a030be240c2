#!/usr/bin/python3
"""`iotcloud run --view` has the TurtleBot's page, as the build and an installation have it, and those of `--pages`.

usage: run_pages_test.py IOTCLOUD_RUN TOPOLOGY PLUGIN
"""
import json
import re
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

LIMIT_S = 60


def get(url):
    with urllib.request.urlopen(url, timeout=LIMIT_S) as answer:
        return answer.headers, answer.read().decode()


def check(what, holds):
    if not holds:
        sys.exit(f"wrong: {what}")


def main():
    program, topology, plugin = sys.argv[1:4]
    with tempfile.TemporaryDirectory(prefix="iotcloud-pages-") as folder:
        (Path(folder) / "own.js").write_text('// iotcloud page: {"title": "My own", "driver": "loadgen"}\n')
        (Path(folder) / "none.js").write_text("alert(1)\n")
        with subprocess.Popen([program, topology, "--plugin", plugin, "--view", "127.0.0.1:0", "--pages", folder],
                              stdout=subprocess.PIPE, text=True) as run:
            try:
                url = next(found[1] for line in run.stdout if (found := re.match(r"console: (http\S+)", line)))
                pages = {page["name"]: page for page in json.loads(get(f"{url}api/pages")[1])["pages"]}
                check("the TurtleBot's page is there", pages["turtlebot"]["driver"] == "turtle" and not pages["turtlebot"]["problem"])
                check("a page of one's own is there", pages["own"]["title"] == "My own" and not pages["own"]["problem"])
                check("what is none is listed with the reason", "its first line is to be" in pages["none"]["problem"])
                headers, text = get(f"{url}page/turtlebot")
                check("its frame has an origin of its own", "sandbox allow-scripts" in headers["Content-Security-Policy"])
                check("it has the script", "iotcloud page:" in text)
            finally:
                run.terminate()


if __name__ == "__main__":
    main()
