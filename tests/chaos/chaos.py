#!/usr/bin/python3
"""Random faults in a whole private system, and what must be true afterwards: tests/chaos/README.md.

usage: chaos.py BUILD_DIR [--seed N] [--minutes N] [--broker rabbitmq|kafka|activemq] [--runs N] [--again]
       [--faults KIND,...] [--targets TARGET,...] [--schedule FILE] [--shrink RUNS] [--patience SECONDS] [--print]

A violation is followed by at most 10 runs of smaller schedules, and prints the smallest that shows one too; --shrink 0
leaves them out.
"""

import argparse
import datetime
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "servers")]

import checks  # noqa: E402
import ledger  # noqa: E402
import schedule  # noqa: E402
from cluster import ChaosCluster  # noqa: E402
from faults import Faults  # noqa: E402
from orders import Orders, Person  # noqa: E402
from private_cluster import StartError, Unavailable  # noqa: E402
from shrink import shrink  # noqa: E402

RATE = 25  # messages a second of each instance
INSTANCES = 2  # of each kind on each gateway
QUIET_S = 2  # for so long who is not to send must be seen to be silent
PLUGIN, NEXT_PLUGIN = "chaos_ledger_driver.so", "chaos_ledger_driver-2.so"
SKIPPED = 77
SPACES = "IOTCLOUD_CHAOS_HAS_ITS_SPACES"
COLUMNS = ("seed", "broker", "minutes", "faults", "result", "actions", "messages", "duplicates", "converged_s", "took_s",
           "commit", "when", "first violation", "commands", "drops", "targets", "schedule", "patience", "left out")
SHRINKING = 10  # runs after a violation, unless told otherwise


def log(text):
    print(text, flush=True)


class Run:
    """One run of a schedule. `violations` says what was wrong."""

    def __init__(self, build, out, broker, actions, patience_s=60):
        self.build, self.out, self.broker, self.actions = Path(build), Path(out), broker, actions
        self.patience_s = patience_s  # until all must be well after the faults
        self.violations, self.messages, self.commands, self.duplicates, self.converged_s = [], 0, 0, 0, None
        self.left_out = ""  # faults of the schedule that could not be made here
        self.drops = {}  # by reason, as the daemons that lived in the end counted them

    def run(self):
        shutil.rmtree(self.out, ignore_errors=True)
        deceived = any(action.kind in schedule.MACHINE for action in self.actions)
        with ChaosCluster(self.build, self.out, self.broker, deceived) as cluster:
            try:
                self.run_in(cluster)
            except StartError as error:
                self.violations.append(str(error))
        self.violations += cluster.violations
        self.violations += checks.crashed(cluster) + checks.left_over(cluster, self.patience_s)
        self.violations = list(dict.fromkeys(self.violations))
        return self

    def run_in(self, cluster):
        began = time.monotonic()
        cluster.start(self.patience_s)
        instances = self.deploy(cluster)
        log(f"the cluster runs after {time.monotonic() - began:.1f} s; its files are in {self.out}")
        if not cluster.disks and any(action.kind == "full" for action in self.actions):
            self.left_out = "no full disks: this process may not mount any"
            log(self.left_out)
        orders = Orders(cluster, [action for action in self.actions if action.is_order], (PLUGIN, NEXT_PLUGIN), log)
        self.load(cluster, True)
        self.wait("every instance's messages come", cluster, lambda: all(
            ledger.lines(cluster.books / f"{instance}.{end}") for instance in instances
            for end in ("came", "read", "heard")), self.patience_s)
        cluster.pause(1)
        before = checks.all_figures(cluster)

        person = Person(cluster, log)
        person.keep_backup()
        faults = Faults(cluster, [action for action in self.actions if not action.is_order], log, orders.registry_wiped,
                        person.put_right)
        faults.start()
        orders.start()
        while not (faults.over and cluster.idle):
            faults.step()
            orders.step()
            person.step()
            cluster.pause(0.02)
        self.wait_for_person(cluster, person, orders)
        healed = time.monotonic()
        log(f"{faults.passed():7.2f} s  all faults are over")

        self.violations += self.converge(cluster, instances, orders, healed)
        self.violations += self.senders(cluster, self.patience_s)
        self.violations += checks.stays_grown(cluster, before, healed + self.patience_s - time.monotonic())
        self.load(cluster, False)
        self.violations += orders.violations + self.told(orders.start_stopped)
        accounts, wrong = self.judge_messages(cluster, instances, healed + self.patience_s)
        self.converged_s = time.monotonic() - healed
        self.violations += wrong
        self.violations += checks.spinning(cluster, self.patience_s)
        there = set(instances) | {driver["instance"] for driver in cluster.json("drivers")}
        self.drops, wrong = checks.uncounted(cluster, accounts, there, self.patience_s)
        self.violations += wrong
        self.messages = sum(len(run.sent) for account in accounts for run in account.runs)
        self.commands = sum(len(ledger.commands(account).runs[0].sent) for account in accounts if account.heard is not None)
        self.duplicates = sum(ledger.duplicates(account.came) for account in accounts)
        self.violations += self.told(lambda: self.undeploy(cluster))

    def wait_for_person(self, cluster, person, orders):
        """A registry that was wiped last of all is to be put right."""
        deadline = time.monotonic() + self.patience_s
        while not person.idle:
            person.step()
            orders.step()
            cluster.pause(0.02)
            if time.monotonic() > deadline:
                raise StartError(f"not within {self.patience_s} s: the registry is put right after it was wiped")

    def converge(self, cluster, instances, orders, healed):
        """Waits until the cluster is as it is to be, and new messages come everywhere: a broker that lost its data before has
        every reader's queue again. Returns what is not so in the end."""
        deadline = healed + self.patience_s
        while True:
            cluster.pause(0.2)
            orders.step()
            why = checks.not_converged(cluster, instances, orders) if orders.over else ["an order is not answered"]
            if not why:
                why = ledger.silent(accounts_of(cluster, instances), healed)
            if not why:
                return []
            if time.monotonic() > deadline:
                return [f"not within {self.patience_s} s: {reason}" for reason in why]

    @staticmethod
    def senders(cluster, limit):
        """Waits until the books say that those instances send which the command line lists as active, guests included, and
        no others. Returns what is not so in the end."""
        deadline, since = time.monotonic() + limit, ledger.accepted(cluster.books)
        while True:
            try:
                active = [driver["instance"] for driver in cluster.json("drivers") if driver["state"] == "active"]
                before = ledger.accepted(cluster.books)
                cluster.pause(QUIET_S)
                wrong = ledger.otherwise_than_listed(active, since, before, ledger.accepted(cluster.books))
            except StartError as error:
                wrong = [str(error)]
            if not wrong:
                return []
            if time.monotonic() > deadline:
                return [f"not within {limit} s: {reason}" for reason in wrong]
            cluster.pause(0.1)

    @staticmethod
    def told(check):
        """What a check found; a command line that fails is a finding, too."""
        try:
            return check()
        except StartError as error:
            return [str(error)]

    @staticmethod
    def undeploy(cluster):
        for driver in cluster.json("drivers"):
            cluster.cli("undeploy", driver["instance"])
        return []

    def deploy(self, cluster):
        """Deploys the instances that stay; returns their kind by id."""
        found = {}
        for gateway in schedule.GATEWAYS:
            for kind in (ledger.SPOOLED, ledger.BLOCKED):
                answer = cluster.answer("deploy", PLUGIN, "--gateway", gateway, "--name", f"ledger-{kind}", "--count",
                                        INSTANCES, "--property", f"folder={cluster.books}", "--property", f"kind={kind}",
                                        "--property", f"rate={RATE}", "--property", f"shared={cluster.shared}")
                for outcome in answer["outcomes"]:
                    if outcome["outcome"] != "done":
                        raise StartError(f"an instance could not be deployed: {outcome}")
                    found[outcome["instance"]] = (gateway, kind)
        if cluster.shared == "true":
            topics = [f"{gateway}.ledger.{kind}" for gateway in schedule.GATEWAYS for kind in (ledger.SPOOLED, ledger.BLOCKED)]
        else:
            topics = [f"{gateway}.ledger.{instance}.{kind}" for instance, (gateway, kind) in found.items()]
        cluster.start_reader("ledger.durable", topics)
        self.wait("the second reader reads", cluster, (cluster.books / "reading").exists, self.patience_s)
        self.wait("the topology reads", cluster, lambda: cluster.channels_read() >= len(topics), self.patience_s)
        cluster.pause(1)  # a reader is counted a moment before its queue is there
        return {instance: kind for instance, (_, kind) in found.items()}

    @staticmethod
    def load(cluster, on):
        if on:
            (cluster.books / "go").touch()
        else:
            (cluster.books / "go").unlink()

    def wait(self, what, cluster, condition, limit):
        deadline = time.monotonic() + limit
        while not condition():
            if time.monotonic() > deadline:
                raise StartError(f"not within {limit} s: {what}")
            cluster.pause(0.1)

    @staticmethod
    def judge_messages(cluster, instances, deadline):
        """Waits until the books balance, those of guests included."""
        while True:
            cluster.pause(0.5)
            guests = sorted({book.stem for book in cluster.books.glob("*.sent")} - set(instances))
            accounts = accounts_of(cluster, instances)
            accounts += [ledger.account(cluster.books, instance, ledger.BLOCKED, False) for instance in guests]
            ledger.mark_killed(accounts, {str(pid) for gateway in schedule.GATEWAYS for pid in cluster.hosts(gateway)})
            wrong = ledger.check(accounts, cluster.emptied, cluster.outages)
            if not wrong or time.monotonic() > deadline:
                return accounts, wrong


def accounts_of(cluster, instances):
    """Of the instances that stay, which both readers read."""
    return [ledger.account(cluster.books, instance, kind, True) for instance, kind in instances.items()]


def commit(root=ROOT):
    """Of the sources; with "-dirty" behind it when some are not committed."""
    def git(*words):
        return subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False).stdout.strip()
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("-dirty" if git("status", "--porcelain") else "")


def in_own_spaces():
    """Runs this script again with mounts and processes of its own: small disks may be mounted, and all processes end with
    this script, however it ends. Where that is not possible there are no small disks, and this says so."""
    if os.environ.get(SPACES):
        return
    enter = ["unshare", *([] if os.geteuid() == 0 else ["--map-root-user"]), "--mount", "--pid", "--fork", "--kill-child",
             "--mount-proc"]
    if not shutil.which("unshare") or subprocess.run([*enter, "true"], capture_output=True, check=False).returncode:
        log("no mounts and processes of its own here: disks are not filled")
        return
    sys.stdout.flush()
    os.execvpe(enter[0], [*enter, sys.executable, HERE / "init.py", sys.executable, *sys.argv], {**os.environ, SPACES: "1"})


class Results:
    """A line for each seed, by which a series goes on where it was interrupted."""

    def __init__(self, file):
        self.file = Path(file)

    def known(self):
        """Lines of an earlier version lack the last columns."""
        if not self.file.exists():
            return []
        lines = [line.split("\t") for line in self.file.read_text().splitlines()[1:]]
        return [dict(zip(COLUMNS, line)) for line in lines]

    def has(self, **key):
        """Never of changes that are not committed: nobody knows whether they are the same."""
        return not key["commit"].endswith("-dirty") and any(
            all(line.get(name) == str(value) for name, value in key.items()) for line in self.known())

    def add(self, **line):
        self.file.parent.mkdir(parents=True, exist_ok=True)
        if not self.file.exists():
            self.file.write_text("\t".join(COLUMNS) + "\n")
        with open(self.file, "a", encoding="utf-8") as file:
            file.write("\t".join(str(line.get(name, "")).replace("\t", " ").replace("\n", " ") for name in COLUMNS) + "\n")


def one(given, seed, actions, name):
    """Runs a schedule and prints what was wrong; returns the run."""
    began = time.monotonic()
    run = Run(given.build, given.out / name, given.broker, actions, given.patience).run()
    run.took_s = time.monotonic() - began
    if run.violations:
        log(f"\nVIOLATED, seed {seed}, {given.broker}:")
        for text in run.violations:
            log(f"  {text}")
        log(f"  drops that were counted: {told(run.drops)}")
        log(f"its schedule, which --schedule takes:\n{schedule.text(actions)}")
    else:
        log(f"seed {seed}, {given.broker}: {len(actions)} faults and orders; {run.messages} messages accepted and "
            f"{run.commands} commands sent back, none lost, {run.duplicates} messages came twice; all was well "
            f"{run.converged_s:.1f} s after the faults; {run.took_s:.0f} s in all")
        log(f"  drops that were counted: {told(run.drops)}")
    return run


def told(drops):
    return ", ".join(f"{count} {reason}" for reason, count in sorted(drops.items())) or "none"


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("build", type=Path)
    options.add_argument("--seed", type=int, default=None, help="of the schedule; default: one of the time")
    options.add_argument("--minutes", type=float, default=1.0, help="of faults (default: 1)")
    options.add_argument("--broker", choices=schedule.BROKERS, default="rabbitmq")
    options.add_argument("--runs", type=int, default=1, help="that many seeds, from --seed on; those that build/chaos/"
                         "results.tsv has of this commit are passed over; none with changes that are not committed")
    options.add_argument("--again", action="store_true", help="pass over none")
    options.add_argument("--faults", default="", help=f"only these, joined by commas: {', '.join(schedule.FAULTS)}; or "
                         "`steady`: those of ./dev test")
    options.add_argument("--targets", default="", help="only faults of these targets, joined by commas")
    options.add_argument("--schedule", type=Path, help="a file with a schedule, instead of a seed's")
    options.add_argument("--shrink", type=int, default=SHRINKING, metavar="RUNS", help="make a schedule that shows a "
                         f"violation smaller, by at most so many runs (default: {SHRINKING}; 0: leave it as it is)")
    options.add_argument("--patience", type=int, default=60, metavar="SECONDS", help="how soon after the faults all must be "
                         "well (default: 60)")
    options.add_argument("--print", action="store_true", help="only print the schedule")
    options.add_argument("--out", type=Path, default=None, help="default: BUILD_DIR/chaos-runs")
    options.add_argument("--results", type=Path, default=ROOT / "build/chaos/results.tsv")
    given = options.parse_args()
    given.build = given.build.resolve()
    given.out = (given.out or given.build / "chaos-runs").resolve()
    kinds = schedule.STEADY if given.faults == "steady" else [word for word in given.faults.split(",") if word]
    targets = [word for word in given.targets.split(",") if word]
    first = given.seed if given.seed is not None else int(time.time())
    results, failed, took = Results(given.results), 0, []
    if not given.print:
        in_own_spaces()
    for seed in range(first, first + given.runs):
        try:
            actions = schedule.parse(given.schedule.read_text()) if given.schedule else schedule.generate(
                seed, 60 * given.minutes, given.broker, kinds, targets)
        except ValueError as error:
            options.error(str(error))
        title = f"{given.schedule}, {given.broker}" if given.schedule else \
            f"seed {seed}, {given.minutes:g} minutes, {given.broker}" + (f", {given.faults}" if given.faults else "")
        if given.print:
            print(schedule.text(actions, title), end="")
            continue
        key = {"seed": seed, "broker": given.broker, "minutes": f"{given.minutes:g}", "faults": given.faults,
               "targets": given.targets, "schedule": identity(given.schedule), "patience": given.patience, "commit": commit()}
        if given.runs > 1 and not given.again and results.has(**key):
            log(f"seed {seed}: {results.file} has its result already")
            continue
        log(title + place_in_series(seed - first, given.runs, took))
        name = f"{given.broker}-{seed}"
        try:
            run = one(given, seed, actions, name)
        except Unavailable as error:
            print(f"SKIPPED chaos: {error}")
            sys.exit(SKIPPED)
        took.append(run.took_s)
        results.add(**key, result="violated" if run.violations else "well", actions=len(actions), messages=run.messages,
                    duplicates=run.duplicates, commands=run.commands, converged_s=f"{run.converged_s or 0:.1f}",
                    took_s=f"{run.took_s:.0f}", when=datetime.datetime.now().isoformat(timespec="seconds"),
                    drops=told(run.drops), **{"left out": run.left_out,
                                              "first violation": run.violations[0] if run.violations else ""})
        if run.violations:
            failed += 1
            if given.shrink:
                smaller(given, seed, actions)
    sys.exit(1 if failed else 0)


def place_in_series(done, runs, took):
    """What a run's title says of the series: which run it is, and about how long all still take. `took`: seconds of runs so far."""
    if runs == 1:
        return ""
    left = f", about {(runs - done) * sum(took) / len(took) / 60:.1f} min left" if took else ""
    return f"; run {done + 1} of {runs}{left}"


def identity(file):
    """Of a schedule's file: its name, and a sum of its bytes, because it may be edited. Without a file it is empty."""
    return f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()[:12]}" if file else ""


def smaller(given, seed, actions):
    file = given.out / f"{given.broker}-{seed}.schedule"

    def keep(part, runs):
        file.write_text(schedule.text(part, f"seed {seed}, {given.broker}, after {runs} runs"))

    part = shrink(actions, lambda part: bool(one(given, seed, part, "shrink").violations), given.shrink, keep)
    log(f"seed {seed}, {given.broker}: the smallest schedule that was found ({file}):\n{schedule.text(part)}")


if __name__ == "__main__":
    main()
