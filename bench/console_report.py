"""The figures of `./dev bench console`: what open pages of the console cost the fleet and its master, how soon the overview is
painted, and how large the page is."""

import gzip
import json
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

from brokers_report import Report
from fleet_report import LOADED, RATE, SIZE, Fleet

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT / "tests/servers"), str(ROOT / "tests/master/console")]
import npm_packages  # noqa: E402
from private_cluster import StartError, cpu_seconds, free_port, result_of, wait_for  # noqa: E402

PAGES = 10
PROBE_RATE, PROBE_S = 50, 20
PAINTS = 9
NOISE = 1.25  # the largest ratio of two p99 of the same load, with a little room
CPU_LIMIT_PERCENT, PAINT_LIMIT_MS, PAGE_LIMIT_KB = 5, 300, 300
# What the console's pages ask for: most people keep the overview open.
STREAMS = ("", "", "", "", "", "", "?rows=1", "?rows=1", "?topology=echo", "?topology=echo")


class Pages:
    """The streams of open pages, without browsers, which would need more of this machine than all that is measured."""

    def __init__(self, url, streams):
        self.open = [urllib.request.urlopen(f"{url}api/live{stream}", timeout=60) for stream in streams]
        self.bytes = 0
        for stream in self.open:
            threading.Thread(target=self.read, args=(stream,), daemon=True).start()

    def read(self, stream):
        try:
            while part := stream.read1(1 << 16):
                self.bytes += len(part)
        except (OSError, ValueError, AttributeError):
            pass  # closed below

    def close(self):
        for stream in self.open:
            stream.close()


class ConsoleFleet(Fleet):
    def begin(self):
        port = free_port()
        self.url = f"http://127.0.0.1:{port}/"
        self.start(gateways=2, of_masters=f'console: {{address: "127.0.0.1:{port}"}}')
        self.worker()
        self.wait_until_ready()
        self.deploy_all(LOADED // 2, {"size": SIZE, "rate": RATE, "shared": "true"})
        wait_for("all that is sent comes through", lambda: self.carried() > 0.9 * LOADED * RATE, 60)

    def master_cpu(self):
        return sum(seconds for command, seconds in cpu_seconds(str(self.out)).values() if "iotcloud-master" in command)

    def turn(self, streams):
        """p99 of a driver's round trip in us, beside all others, and the master's CPU in percent of a core, meanwhile."""
        pages = Pages(self.url, streams)
        report = self.out / f"probe-{time.monotonic_ns()}.json"
        before, began = self.master_cpu(), time.monotonic()
        instance = self.json("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", f"rate={PROBE_RATE}", "--property",
                             f"count={PROBE_RATE * PROBE_S}", "--property", "warm_up=100", "--property",
                             f"report={report}")["outcomes"][0]["instance"]
        wait_for("the probe's messages are back", lambda: result_of(report), 120)
        cpu = 100 * (self.master_cpu() - before) / (time.monotonic() - began)
        pages.close()
        self.cli("undeploy", instance)
        return result_of(report)["latency_us"]["p99"], cpu, pages.bytes


def paints(url):
    """How soon Chromium paints the figures of the overview, in ms."""
    try:
        packages = npm_packages.packages()
    except npm_packages.Unavailable as problem:
        raise StartError(str(problem)) from problem
    done = subprocess.run(["node", HERE / "console_paints.mjs", packages / "node_modules", url, str(PAINTS)], capture_output=True, text=True,
                          timeout=300)
    if done.returncode:
        raise StartError(done.stderr.strip()[-1000:])
    return json.loads(done.stdout)


def run_console(given):
    report, rounds = Report(), given.rounds or (2 if given.quick else 5)
    report.print_head()
    size = sum(len(gzip.compress(file.read_bytes())) for file in (ROOT / "master/console/page/built").iterdir())
    report.compare("the page, gzipped", "KB", [size / 1000], at_most=PAGE_LIMIT_KB)
    with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
        try:
            with ConsoleFleet(Path(folder) / "fleet", given.build / "bin", given.build / "plugins") as fleet:
                fleet.begin()
                none, some = [], []
                for _ in range(rounds):
                    none.append(fleet.turn(()))
                    some.append(fleet.turn(STREAMS))
                title = f"{LOADED} at {RATE}/s, {PAGES} pages open"
                report.compare(f"{title}: p99 round trip", "us", [p99 for p99, _, _ in some], "no page", [p99 for p99, _, _ in none],
                               ratio_at_most=NOISE)
                report.compare(f"{title}: master", "% CPU", [cpu for _, cpu, _ in some], "no page", [cpu for _, cpu, _ in none],
                               at_most=CPU_LIMIT_PERCENT)
                report.compare(f"{title}: sent to pages", "KB/s", [sent / 1000 / PROBE_S for _, _, sent in some])
                report.compare("first paint of the overview", "ms", paints(fleet.url), at_most=PAINT_LIMIT_MS)
                fleet.require_alive()
        except (StartError, SystemExit) as failure:  # wait_for() ends a test
            report.fail(f"GIVEN UP: {failure}")
    return report, report.verdict()
