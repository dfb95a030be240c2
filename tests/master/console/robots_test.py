#!/usr/bin/python3
"""Pages of robots and the map in a browser, Debian's Chromium, on a console over a fleet that is made up (stand.cc): the
TurtleBot's page shows a simulated robot that moves; a page that is not signed is not shown; a signed one that attacks reaches neither
the session nor the API, nor another site.

usage: robots_test.py CONSOLE_STAND IOTCLOUD
"""
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import browser
from stand_test import Stand

HERE = Path(__file__).resolve().parent
TURTLEBOT = HERE.parents[2] / "examples/turtlebot_follower/page/turtlebot.js"
INSTANCES = 2000
HOSTILE = '// iotcloud page: {"title": "<img src=x onerror=window.hacked=1>", "driver": "meter"}'


def main():
    program, cli = sys.argv[1:3]
    with tempfile.TemporaryDirectory(prefix="iotcloud-console-") as name:
        folder = Path(name)
        pages = folder / "pages"
        pages.mkdir()

        def iotcloud(*words):
            return subprocess.run([cli, *map(str, words)], check=True, capture_output=True, text=True).stdout.strip()

        tokens = {who: iotcloud("token", "add", who, "--role", role, "--file", folder / "tokens")
                  for who, role in (("anna", "admin"), ("vera", "viewer"))}
        iotcloud("keys", "new", folder / "lab")
        shutil.copy(TURTLEBOT, pages / "turtlebot.js")
        shutil.copy(TURTLEBOT, pages / "unsigned.js")
        shutil.copy(HERE / "attack_page.js", pages / "attack.js")
        shutil.copy(HERE / "leaving_page.js", pages / "leaving.js")
        (pages / "hostile.js").write_text("\n".join([HOSTILE, *TURTLEBOT.read_text().split("\n")[1:]]))
        for page in ("turtlebot", "attack", "leaving", "hostile"):
            iotcloud("sign", pages / f"{page}.js", "--key", folder / "lab.key")
        stand = Stand([program, folder / "tokens", INSTANCES, "--pages", pages, folder / "lab.pub"])
        try:
            browser.run_script("robots.mjs", {"url": stand.url, "tokens": tokens, "instances": INSTANCES}, lambda _: stand.all_orders())
        finally:
            stand.end()


if __name__ == "__main__":
    main()
