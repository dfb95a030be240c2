#!/usr/bin/python3
"""Runs a benchmark, prints a table and writes build/bench/NAME.json.

usage: ./dev bench runtime [--quick] [--before PROGRAM] [--keep-noisy] [--build DIR] [--json FILE]
                         (it builds what this needs, and runs this file)
       ./dev bench brokers [--quick] [--only BROKER] [--figures REGEX] [--rounds N] [--keep-noisy] [--build DIR]
                           [--json FILE]
       ./dev bench discovery [--quick] [--rounds N] [--instances N] [--build DIR] [--json FILE]
       ./dev bench fleet [--quick] [--rounds N] [--instances N] [--build DIR] [--json FILE]
       ./dev bench devices [--quick] [--rounds N] [--build DIR] [--json FILE]
       ./dev bench console [--quick] [--rounds N] [--build DIR] [--json FILE]
       ./dev bench paper [--quick | --full] [--figure NAME]... [--broker NAME]... [--points REGEX] [--rounds N]
                         [--build DIR] [--out FOLDER]
       ./dev bench storm [--quick | --full] [--points REGEX] [--rounds N] [--keep-noisy] [--build DIR] [--out FOLDER]
                         as paper --figure storm
       ./dev bench storm --turtlebot [--quick] [--rounds N] [--build DIR] [--out FOLDER]
       ./dev bench codec [--quick] [--rounds N] [--frames FOLDER]... [--build DIR] [--json FILE]
       ./dev bench follower [--quick] [--rounds N] [--frames FOLDER]... [--build DIR] [--json FILE]
       ./dev bench soak [--minutes N] [--seed N] [--build DIR] [--json FILE]
       ./dev bench page      writes build/bench/report.html and plots/*.svg again, of all JSON files there; measures nothing

The programs take turns, round by round. A ratio is the median, over the rounds, of the ratio within one round.
Whether a target is met is computed.
"""

import argparse
import contextlib
import json
import os
import signal
import sys
import time
from pathlib import Path

import page
from brokers_report import BROKERS, run_brokers
from codec_report import run_codec, run_follower
from console_report import run_console
from devices_report import run_devices
from discovery_report import run_discovery
from figures import ProgramFailed, command_line, commit, machine
from fleet_report import run_fleet
from heartbeat import Heartbeat, seconds_of_last_run
from paper.report import add_options as add_paper_options, run_paper
from runtime_report import run_runtime, run_soak
from storm_report import add_options as add_storm_options


def main():
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that processes that were started end with this one
    root = Path(__file__).resolve().parent.parent
    if sys.argv[1:] == ["page"]:
        print(page.write(root / "build/bench"))
        return
    options = argparse.ArgumentParser(prog="./dev bench", description=__doc__.split("\n")[0])
    commands = options.add_subparsers(dest="what", required=True)
    names = ("runtime", "soak", "brokers", "discovery", "fleet", "devices", "console", "codec", "follower", "paper", "storm")
    runtime, soak, brokers, discovery, fleet, devices, console, codec, follower, paper, storm = map(commands.add_parser, names)
    for command in (runtime, soak, brokers, discovery, fleet, devices, console, codec, follower, paper, storm):
        command.add_argument("--build", type=Path, default=root / "build/release")
        if command not in (paper, storm):  # paper and storm write a file for each figure
            command.add_argument("--json", type=Path)
    add_paper_options(paper, root)
    add_storm_options(storm, root)
    runtime.add_argument("--quick", action="store_true", help="fewer and shorter rounds, no latency of the wider DAGs")
    runtime.add_argument("--before", type=Path, metavar="PROGRAM", help="bench_runtime_iotcloud of an earlier build, to run beside")
    runtime.add_argument("--keep-noisy", action="store_true", help="rounds in which other processes took much CPU count, too")
    soak.add_argument("--minutes", type=float, default=10)
    soak.add_argument("--seed", type=int, help="to disturb it in the same way again")
    brokers.add_argument("--quick", action="store_true", help="fewer sizes and rates, three rounds")
    brokers.add_argument("--only", choices=BROKERS, action="append", help="this broker; may be given several times")
    brokers.add_argument("--figures", metavar="REGEX", help="those in whose name this is found, as in '1000 x 5/s'")
    brokers.add_argument("--rounds", type=int, help="default: 7, with --quick 3")
    brokers.add_argument("--keep-noisy", action="store_true", help="rounds with company count too (the table says so)")
    discovery.add_argument("--quick", action="store_true", help="one round, 50 new drivers")
    discovery.add_argument("--rounds", type=int, help="default: 3, with --quick 1")
    discovery.add_argument("--instances", type=int, default=10_000, help="driver instances, of two channels each")
    fleet.add_argument("--quick", action="store_true", help="one round")
    fleet.add_argument("--rounds", type=int, help="default: 3, with --quick 1")
    fleet.add_argument("--instances", type=int, default=10_000, help="idle driver instances in one host")
    devices.add_argument("--quick", action="store_true", help="one short round")
    devices.add_argument("--rounds", type=int, help="default: 3, with --quick 1")
    console.add_argument("--quick", action="store_true", help="two rounds")
    console.add_argument("--rounds", type=int, help="default: 5, with --quick 2")
    for command in (codec, follower):
        command.add_argument("--quick", action="store_true", help="three rounds over fewer frames")
        command.add_argument("--rounds", type=int, help="default: 7, with --quick 3")
        command.add_argument("--frames", type=Path, action="append", default=[], metavar="FOLDER",
                             help="depth images (.pgm or .pgm.gz, 16 bits, mm) to measure with, too")
    given = options.parse_args()

    facts = machine()
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average_before']:.2f}", flush=True)
    if facts["load_average_before"] > 0.5:
        print("THE MACHINE IS NOT QUIET: the tails of latencies, and what needs all cores, are worse than they are")
    began = time.monotonic()
    benchmarks = {"runtime": run_runtime, "soak": run_soak, "brokers": run_brokers, "discovery": run_discovery,
                  "fleet": run_fleet, "devices": run_devices, "console": run_console, "codec": run_codec,
                  "follower": run_follower, "paper": run_paper, "storm": run_paper}
    file = getattr(given, "json", None) or root / f"build/bench/{given.what}.json"
    command = command_line(sys.argv[1:])
    tells_by_itself = given.what in ("brokers", "paper", "storm")  # these tell by themselves how much time is left
    try:
        with contextlib.nullcontext() if tells_by_itself else Heartbeat(given.what, seconds_of_last_run(file, command)):
            report, verdict = benchmarks[given.what](given)
    except ProgramFailed as failure:
        sys.exit(str(failure))
    if given.what in ("paper", "storm"):
        print(f"{verdict}\n{time.monotonic() - began:.0f} s; the figures are in {given.out}")
        sys.exit(1 if report.failed else 0)
    facts["load_average_after"] = os.getloadavg()[0]
    file.parent.mkdir(parents=True, exist_ok=True)
    written = {"machine": facts, "commit": commit(root), "command": command, "seconds": time.monotonic() - began,
               **report.written()}
    file.write_text(json.dumps(written, indent=1) + "\n")
    print(f"{verdict}\n{time.monotonic() - began:.0f} s; all figures are in {file}")
    sys.exit(1 if report.failed else 0)


if __name__ == "__main__":
    main()
