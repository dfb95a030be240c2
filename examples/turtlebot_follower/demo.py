#!/usr/bin/env python3
"""Runs the TurtleBot follower and reports how well it followed: called by `./dev demo`. With `--robots N` each robot has
a room, a person and a seed of its own, and one topology serves all robots.

Local mode runs everything in one process on the embedded broker and registry. `--cluster` runs RabbitMQ, ZooKeeper, a
master, two gateways and a topology worker as processes, private to this run, and deploys the driver with the CLI.
`--engine storm` runs the same cluster with Apache Storm in place of the worker.
The figures come from the traces that the turtle driver writes (drivers/turtle/README.md), one row for each frame.
"""

import argparse
import fcntl
import json
import os
import signal
import sys
import time
import webbrowser
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import modes  # noqa: E402
import report  # noqa: E402


SKIPPED = 77  # exit status when a server is unavailable
MOST_ROBOTS = 32
MOST_START_S = 120


def fleet(options, out):
    """The robots, on two gateways in turn."""
    common = {"clock": "lockstep" if options.lockstep else "realtime"}
    if options.robots > 1:
        common["rate"] = 10
    if options.broker == "kafka":  # Kafka has no exclusive channels
        common |= {"channel.kinect.shared": "true", "channel.control.shared": "true"}
    robots = []
    for number in range(options.robots):
        name = "trace.csv" if options.robots == 1 else f"trace-{number + 1}.csv"
        own = {"seed": options.seed + number, "trace": out / name}
        robots.append(modes.Robot(f"gateway-{1 + number % 2}", {**common, **own}))
    return robots


def arguments():
    parser = argparse.ArgumentParser(prog="./dev demo", description="The TurtleBot follows a person.")
    parser.add_argument("--cluster", action="store_true", help="real parts, each its own process")
    parser.add_argument("--engine", choices=["storm"], metavar="NAME",
                        help="storm: the cluster's topology runs on a private Apache Storm")
    parser.add_argument("--seconds", type=float, default=20, metavar="N", help="how long to follow (default 20)")
    parser.add_argument("--robots", type=int, default=1, metavar="N",
                        help="so many robots at 10 Hz each, on two gateways (default 1, at 30 Hz)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the simulated room and person (default 1); the next robots' are the next numbers")
    parser.add_argument("--broker", choices=["embedded", "rabbitmq", "kafka", "activemq"], metavar="NAME",
                        help="embedded, or a private rabbitmq, kafka or activemq (default: embedded; of a cluster"
                             " rabbitmq)")
    parser.add_argument("--view", action="store_true",
                        help="shows all of it, while it runs, on a page for browsers, whose address is printed")
    parser.add_argument("--json", metavar="FILE", help="write the report there too")
    parser.add_argument("--lockstep", action="store_true",
                        help="the world moves on with each answer, not with time: for slow machines")
    parser.add_argument("--build", type=Path, default=Path("build/release"), help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("build/demo"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not 2 <= options.seconds <= 3600:
        parser.error("--seconds: between 2 and 3600")
    if not 1 <= options.robots <= MOST_ROBOTS:
        parser.error(f"--robots: between 1 and {MOST_ROBOTS}")
    options.cluster = options.cluster or options.engine is not None
    if options.view and options.engine:
        parser.error("--view: the page does not show Apache Storm's topologies; Storm has a UI of its own")
    if options.broker is None:
        options.broker = "rabbitmq" if options.cluster else "embedded"
    if options.cluster and options.broker != "rabbitmq":
        parser.error(f"--broker {options.broker} is for one process; the cluster's is rabbitmq")
    return options


def await_answers(robots, alive):
    """Waits until each robot has had its first command: a server and a topology take a while to start. Returns whether
    they had it."""
    limit = time.monotonic() + MOST_START_S
    while alive() and time.monotonic() < limit:
        if all(any(row.answered for row in report.read_trace(robot.trace)) for robot in robots):
            return True
        time.sleep(0.1)
    return False


def progress(robots):
    """How the newest frames of all robots went, as text; None before the first frame."""
    newest = [rows for rows in (report.read_trace(robot.trace, last=30) for robot in robots) if rows]
    if not newest:
        return None
    rows = [row for some in newest for row in some]
    answered = [row for row in rows if row.answered]
    latency = report.percentile([row.latency_ms for row in answered], 50)
    distances = [some[-1].distance for some in newest]
    distance = f"{min(distances):.2f}" + (f" to {max(distances):.2f}" if len(distances) > 1 else "")
    frames = sum(some[-1].seq + 1 for some in newest)
    return (f"frames {frames}   distance {distance} m   latency {latency:.2f} ms   "
            f"answered {len(answered)} of the last {len(rows)}")


class WallClock:
    """How long the robots have been following."""

    def __init__(self):
        self.begin = time.monotonic()

    def elapsed(self):
        return time.monotonic() - self.begin

    def stands_still(self):
        return False


class WorldClock:
    """The same in the time of simulated worlds that wait for commands, which may be slower: that of the slowest."""

    def __init__(self, robots):
        self.traces = [robot.trace for robot in robots]
        self.begin = [report.read_trace(trace)[0].seconds for trace in self.traces]
        self.newest = (0.0, time.monotonic())

    def elapsed(self):
        last = [report.read_trace(trace, last=1)[0].seconds for trace in self.traces]
        elapsed = min(end - begin for begin, end in zip(self.begin, last))
        if elapsed > self.newest[0]:
            self.newest = (elapsed, time.monotonic())
        return elapsed

    def stands_still(self):
        return time.monotonic() - self.newest[1] > MOST_START_S


def follow_progress(robots, seconds, clock, alive):
    """Prints one live line while the robots follow; returns when the time is over or a process died."""
    tty = sys.stdout.isatty()
    next_line = 0.0
    while (elapsed := clock.elapsed()) < seconds:
        if not alive() or clock.stands_still():
            break
        time.sleep(0.2)
        if not tty and elapsed < next_line:
            continue
        next_line = elapsed + 5
        if text := progress(robots):
            line = f"{elapsed:5.1f} / {seconds:.0f} s   {text}"
            print(f"\r{line}\033[K" if tty else line, end="" if tty else "\n", flush=True)
    if tty:
        print()


def take_folder(out):
    """Makes the folder of this run. Returns its lock, which lasts as long as the file is open: two runs would write the
    same trace."""
    out.mkdir(parents=True, exist_ok=True)
    lock = open(out / "lock", "w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit(f"another demo writes into {out} right now: wait for its end, or give this one another folder (--out)")
    return lock


def show(address):
    """Prints where the page is, and opens it in a browser when there is a display."""
    print(f"it is shown at {address}", flush=True)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def main():
    options = arguments()
    out = options.out.resolve()
    _lock = take_folder(out)
    robots = fleet(options, out)
    for old in out.glob("trace*.csv"):
        old.unlink()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    mode = modes.Storm if options.engine else modes.Cluster if options.cluster else modes.OneProcess
    try:
        with mode(options.build, out, options.broker) as running:
            running.view = options.view
            running.begin(robots)
            if options.view:
                show(running.page)
            else:
                print("to see it while it runs: ./dev demo --view")
            answers = await_answers(robots, lambda: running.dead() is None)
            clock = WorldClock(robots) if options.lockstep and answers else WallClock()
            follow_progress(robots, options.seconds, clock, lambda: running.dead() is None)
            measured = running.finish()
    except modes.Unavailable as error:
        print(f"left out: {error}", file=sys.stderr)
        return SKIPPED
    except modes.StartError as error:
        sys.exit(f"the demo could not run: {error}")
    except KeyboardInterrupt:
        sys.exit(130)

    traces = [report.read_trace(robot.trace) for robot in robots]
    result = report.make_report(robots, traces, options, measured)
    text = json.dumps(result, indent=2) + "\n"
    (out / "report.json").write_text(text)
    if options.json:
        Path(options.json).write_text(text)
    report.draw(traces, out)
    report.print_summary(result, out)
    return 0 if result["followed"] else 1


if __name__ == "__main__":
    sys.exit(main())
