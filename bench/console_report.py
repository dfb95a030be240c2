"""The figures of `./dev bench console`: what open pages of the console cost the fleet and its master, how soon the overview is
painted, and how large the page is."""

import gzip
import http.client
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from brokers_report import Report
from fleet_report import LOADED, ORDER_LIMIT_S, RATE, SIZE, Fleet

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT / "tests/servers"), str(ROOT / "tests/master/console")]
import npm_packages  # noqa: E402
from private_cluster import StartError, cpu_seconds, free_port, result_of, wait_for  # noqa: E402

PAGES = 10
PROBE_RATE, PROBE_S, WARM_UP = 100, 20, 100
PAINTS, PAINTS_LIMIT_S = 9, 300
ROWS = 5000  # instances on the fleet's page
NOISE = 1.25  # the largest ratio of two p99 of the same load, with a little room; the line "no page, twice" has that of this run
CPU_LIMIT_PERCENT, PAINT_LIMIT_MS, PAGE_LIMIT_KB = 5, 300, 300
# What the console's pages ask for: most people keep the overview open.
STREAMS = ("", "", "", "", "", "", "?rows=1", "?rows=1", "?topology=echo", "?topology=echo")


class Pages:
    """The streams of open pages, without browsers, which would need more of this machine than all that is measured."""

    def __init__(self, port, streams):
        self.ended, self.closing, self.bytes, self.sockets = 0, False, 0, []
        for stream in streams:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            connection.connect()
            self.sockets.append(connection.sock)  # the connection forgets it when the answer has begun
            connection.request("GET", f"/api/live{stream}", headers={"Accept": "text/event-stream"})
            answer = connection.getresponse()
            if answer.status != 200:
                raise StartError(f"the console does not open a page: {answer.status} {answer.read(1000).decode(errors='replace')}")
            threading.Thread(target=self.read, args=(answer,), daemon=True).start()

    def read(self, answer):
        try:
            while part := answer.read1(1 << 16):
                self.bytes += len(part)
        except (OSError, http.client.HTTPException):
            pass  # counted as an end
        if not self.closing:
            self.ended += 1

    def close(self):
        """Raises StartError when one had ended by itself: then fewer pages were measured."""
        self.closing = True
        for one in self.sockets:
            one.shutdown(socket.SHUT_RDWR)  # wakes its reader, which close() would wait for
            one.close()
        if self.ended:
            raise StartError(f"{self.ended} of {len(self.sockets)} pages lost the console meanwhile")


class ConsoleFleet(Fleet):
    def begin(self):
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        self.start(gateways=2, of_masters=f'console: {{address: "127.0.0.1:{self.port}"}}')
        self.worker()
        self.wait_until_ready()
        self.deploy_all(LOADED // 2, {"size": SIZE, "rate": RATE, "shared": "true"})
        wait_for("all that is sent comes through", lambda: self.carried() > 0.9 * LOADED * RATE, 60)

    def master_cpu(self):
        return sum(seconds for command, seconds in cpu_seconds(str(self.out)).values() if "iotcloud-master" in command)

    def turn(self, streams):
        """p99 of a driver's round trip in us, beside all others; the master's CPU meanwhile in percent of a core; KB/s that the
        pages got."""
        pages = Pages(self.port, streams)
        report = self.out / f"probe-{time.monotonic_ns()}.json"
        before, began = self.master_cpu(), time.monotonic()
        instance = self.json("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", f"rate={PROBE_RATE}", "--property",
                             f"count={WARM_UP + PROBE_RATE * PROBE_S}", "--property", f"warm_up={WARM_UP}", "--property",
                             f"report={report}")["outcomes"][0]["instance"]
        wait_for("the probe's messages are back", lambda: result_of(report), 120)
        took = time.monotonic() - began
        cpu = 100 * (self.master_cpu() - before) / took
        pages.close()
        self.cli("undeploy", instance)
        result = result_of(report)
        if result["lost"] or result["damaged"]:
            raise StartError(f"the probe lost messages: {result}")
        return result["latency_us"]["p99"], cpu, pages.bytes / 1000 / took


def paints(url, *fleet):
    """What new profiles of Chromium take until they have painted, in ms: lists by what (console_paints.mjs)."""
    try:
        packages = npm_packages.packages()
    except npm_packages.Unavailable as problem:
        raise StartError(str(problem)) from problem
    try:
        done = subprocess.run(["node", HERE / "console_paints.mjs", packages / "node_modules", url, str(PAINTS), *map(str, fleet)],
                              capture_output=True, text=True, timeout=PAINTS_LIMIT_S)
    except subprocess.TimeoutExpired as late:
        raise StartError(f"the console's pages were not painted {PAINTS} times within {late.timeout} s") from late
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
                none, some = [fleet.turn(())], []
                for _ in range(rounds):
                    some.append(fleet.turn(STREAMS))
                    none.append(fleet.turn(()))
                title = f"{LOADED} at {RATE}/s, {PAGES} pages open"
                report.compare(f"{title}: p99 round trip", "us", [p99 for p99, _, _ in some], "no page", [p99 for p99, _, _ in none[1:]],
                               ratio_at_most=NOISE)
                report.compare(f"{LOADED} at {RATE}/s, no page, twice: p99", "us", [p99 for p99, _, _ in none[1:]], "no page",
                               [p99 for p99, _, _ in none[:-1]])
                report.compare(f"{title}: master", "% CPU", [cpu for _, cpu, _ in some], "no page", [cpu for _, cpu, _ in none[1:]],
                               at_most=CPU_LIMIT_PERCENT)
                report.compare(f"{title}: sent to pages", "KB/s", [sent for _, _, sent in some])
                report.compare(f"first paint of the overview, {LOADED} at {RATE}/s", "ms", paints(fleet.url)["overview"])
                fleet.cli("stop", "--all", "--wait", ORDER_LIMIT_S)
                report.compare(f"first paint of the overview, {LOADED} at rest", "ms", paints(fleet.url)["overview"], at_most=PAINT_LIMIT_MS)
                fleet.deploy_all((ROWS - LOADED) // 2, {"size": SIZE, "rate": 0.01, "shared": "true"})
                times = paints(fleet.url, ROWS, 'gateway == "gateway-2"', f"{ROWS // 2} instances")
                for what, of in (("all rows known, the first painted", "rows"), ("a jump within them", "scroll"), ("the half, filtered", "filter")):
                    report.compare(f"{ROWS} instances on the fleet's page: {what}", "ms", times[of])
                fleet.require_alive()
        except (StartError, SystemExit, OSError) as failure:  # wait_for() ends a test
            report.fail(f"GIVEN UP: {failure}")
    return report, report.verdict()
