"""What must be true of the cluster after the faults, beside the messages (ledger.py) and the orders (orders.py)."""

import collections
import re
import signal
import time
from pathlib import Path

import schedule
from cluster import processes, signal_all
from orders import not_at_work
from private_cluster import StartError

SPIN = 0.5  # of a processor, of a process that has nothing to do but its timers
MORE = {"descriptors": 16, "threads": 8}
GROWTH_MB, GROWTH = 40, 1.0  # anonymous memory: what was held back meanwhile leaves holes in the heap
CRASHES = re.compile(r"\bsignal (4|6|7|8|11|31)\b|Sanitizer|terminate called|Assertion|stack smashing")


def not_converged(cluster, instances, orders):
    """Why the cluster is not as it is to be yet; empty when it is. `instances`: ids of those that are never undeployed."""
    why = []
    try:
        if idle := not_at_work(cluster.json("gateways")):
            why.append(f"not ready, or frozen: {', '.join(idle)}")
        listed = cluster.json("topologies")
        workers = len(listed[0]["workers"]) if listed else 0
        if workers != len(schedule.WORKERS):
            why.append(f"the topology has {workers} workers")
        drivers = cluster.json("drivers")
        states = {driver["instance"]: driver["state"] for driver in drivers}
        why += [f"{instance[:8]} is {states.get(instance, 'not there')}" for instance in instances
                if states.get(instance) != "active"]
        why += orders.untrue(drivers)
        known = {instance for instance in instances} | {driver["instance"] for driver in drivers
                                                       if driver["name"] in orders.guests}
        why += [f"there is an instance that nobody deployed: {instance}" for instance in states if instance not in known]
    except StartError as error:
        why.append(str(error))
    return why


def figures(process):
    """Of a living process; None when it is gone."""
    folder = Path("/proc", str(process))
    try:
        anonymous = next(line for line in (folder / "status").read_text().splitlines() if line.startswith("RssAnon:"))
        return {"descriptors": len(list((folder / "fd").iterdir())), "threads": len(list((folder / "task").iterdir())),
                "memory MB": int(anonymous.split()[1]) / 1024}
    except (OSError, StopIteration):
        return None


def all_figures(cluster):
    """By name of daemon; of a gateway's hosts together as host:GATEWAY."""
    found = {}
    for name in schedule.DAEMONS:
        child = cluster.process(name)
        found[name] = figures(child.pid) if child else None
    for gateway in schedule.GATEWAYS:
        hosts = cluster.hosts_of_ledger(gateway)
        found[f"host:{gateway}"] = figures(hosts[0]) if len(hosts) == 1 else None
    return found


def grown(before, after):
    wrong = []
    for name, figure, now in ((name, figure, now) for name, values in after.items() if values and before.get(name)
                              for figure, now in values.items()):
        was = before[name][figure]
        allowed = MORE.get(figure, max(GROWTH_MB, GROWTH * was))
        if now - was > allowed:
            wrong.append(f"{name} has {now:.4g} {figure}, before the faults it had {was:.4g}")
    return wrong


def cpu_seconds(folder):
    used = {}
    for pid, command in processes(folder):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        used[pid] = (command, (int(fields[11]) + int(fields[12])) / 100)
    return used


def spinning(cluster, limit):
    """Our own processes that compute all the time although no message flows; those that do so for a moment are not meant."""
    deadline = time.monotonic() + limit
    while wrong := busy(cluster):
        if time.monotonic() > deadline:
            return wrong
    return []


def busy(cluster, seconds=2.0):
    before, began = cpu_seconds(cluster.out), time.monotonic()
    cluster.pause(seconds)
    passed = time.monotonic() - began
    return [f"a process uses {(used - before[pid][1]) / passed:.0%} of a processor without any load: {command}"
            for pid, (command, used) in cpu_seconds(cluster.out).items()
            if "iotcloud-" in command.split(" ")[0] and pid in before and used - before[pid][1] > SPIN * passed]


def crashed(cluster):
    """Lines of logs that tell of a crash."""
    wrong = []
    for log in sorted(cluster.out.rglob("*.log")):
        if log.parent != cluster.out and "state" not in log.parts:
            continue  # of a server
        for line in log.read_text(errors="replace").splitlines():
            if CRASHES.search(line):
                wrong.append(f"{log.name}: {line[:300]}")
                break
    return wrong


def uncounted(cluster, accounts, limit):
    """Messages of `blocked` channels that a driver host which still lives has accepted, and does not count under any
    outcome. Each instance's runs name their process. A gateway asks its hosts for their counts now and then."""
    accepted = collections.Counter()
    for account in accounts:
        if account.kind == "blocked":
            for run in account.runs:
                accepted[int(run.name.split(".")[0])] += len(run.sent)
    deadline = time.monotonic() + limit
    while wrong := [text for gateway in schedule.GATEWAYS for text in miscounted(cluster, gateway, accepted)]:
        if time.monotonic() > deadline:
            return wrong
        cluster.pause(0.5)
    return []


def miscounted(cluster, gateway, accepted):
    counted = collections.Counter()
    try:
        for key, value in cluster.page(gateway):
            if key.startswith("iotcloud_driver_messages_total") and 'channel="blocked"' in key:
                counted[re.search(r'outcome="(\w+)"', key)[1]] += int(value)
    except OSError as error:
        return [f"{gateway} does not show its metrics: {error}"]
    expected = sum(accepted[pid] for pid in cluster.hosts(gateway))
    total = sum(count for outcome, count in counted.items() if outcome != "would_block")
    return [f"{gateway}'s hosts accepted {expected} messages of blocked channels and count the outcomes {dict(counted)}"
            ] if total != expected else []


def left_over(cluster, limit):
    """Processes of a cluster that was stopped. They are ended."""
    deadline = time.monotonic() + limit
    while (left := processes(cluster.out)) and time.monotonic() < deadline:
        time.sleep(0.1)
    signal_all([pid for pid, _ in left], signal.SIGKILL)
    return [f"process {pid} was left: {command}" for pid, command in left]
