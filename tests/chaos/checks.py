"""What must be true of the cluster after the faults, beside the messages (ledger.py) and the orders (orders.py)."""

import collections
import re
import signal
import time
from pathlib import Path

import ledger
import schedule
from cluster import processes, signal_all
from orders import not_at_work
from private_cluster import StartError

PROC = Path("/proc")
SPIN = 0.5  # of a processor, of a process that has nothing to do but its timers
CLIENTS = "librdkafka clients"  # a worker has one for each number of a partition that it reads: one to four
OF_A_CLIENT = {"descriptors": 10, "threads": 4}
MORE = {"descriptors": 16, "threads": 8, CLIENTS: 3}
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
        why += [f"{instance[:8]} is listed {times} times" for instance, times in
                collections.Counter(driver["instance"] for driver in drivers).items() if times > 1]
        why += orders.untrue(drivers)
        known = {instance for instance in instances} | {driver["instance"] for driver in drivers
                                                       if driver["name"] in orders.guests}
        why += [f"there is an instance that nobody deployed: {instance}" for instance in states if instance not in known]
    except StartError as error:
        why.append(str(error))
    return why


def figures(process):
    """Of a living process; None when it is gone."""
    folder = PROC / str(process)
    try:
        anonymous = next(line for line in (folder / "status").read_text().splitlines() if line.startswith("RssAnon:"))
        threads = [(task / "comm").read_text().strip() for task in (folder / "task").iterdir()]
        return {"descriptors": len(list((folder / "fd").iterdir())), "threads": len(threads),
                CLIENTS: threads.count("rdk:main"), "memory MB": int(anonymous.split()[1]) / 1024}
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
    for name, values in after.items():
        was = before.get(name)
        if not values or not was:
            continue
        more_clients = max(0, values[CLIENTS] - was[CLIENTS])
        for figure, now in values.items():
            allowed = MORE.get(figure, max(GROWTH_MB, GROWTH * was[figure])) + OF_A_CLIENT.get(figure, 0) * more_clients
            if now - was[figure] > allowed:
                wrong.append(f"{name} has {now:.4g} {figure}, before the faults it had {was[figure]:.4g}")
    return wrong


def stays_grown(cluster, before, limit):
    """What has grown and has not ended within `limit` seconds: a broker's library may need a while to end the clients of
    readers that moved."""
    deadline = time.monotonic() + limit
    while wrong := grown(before, all_figures(cluster)):
        if time.monotonic() > deadline:
            return wrong
        cluster.pause(0.5)
    return []


def cpu_seconds(folder):
    used = {}
    for pid, command in processes(folder):
        try:
            fields = (PROC / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()
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


# How often a bolt drops a tuple for these reasons it fails the tuple, and the message is tried again.
TRIED_AGAIN = ("fenced", "unknown", "refused", "closed", "held_back")
# Why a worker, or a driver host, gives up a command whose instance is not there in time.
NOT_THERE = {"iotcloud_bolt_lost_total": ("not_started", "inactive", "no_channel"),
             "iotcloud_driver_lost_total": ("no_instance", "not_started", "gateway_away")}
COUNTERS = {"iotcloud_driver_messages_total", "iotcloud_driver_lost_total", "iotcloud_bolt_lost_total",
            "iotcloud_bolt_unknown_driver_total"}
LABEL = re.compile(r'(\w+)="([^"]*)"')


def counters(page):
    """Of a page of metrics, those of COUNTERS: (name, channel or component, outcome, reason) -> their sum."""
    found = collections.Counter()
    for key, value in page:
        name, _, labels = key.partition("{")
        if name in COUNTERS:
            label = dict(LABEL.findall(labels))
            found[name, label.get("channel") or label.get("component", ""), label.get("outcome", ""),
                  label.get("reason", "")] += int(value)
    return found


def drops(pages):
    """What all daemons count as dropped, or as without a known outcome: "blocked unknown closed" -> how often."""
    found = collections.Counter()
    for page in pages.values():
        for (name, where, outcome, reason), count in counters(page).items():
            if outcome not in ("confirmed", "would_block"):
                reason = "unknown driver" if name == "iotcloud_bolt_unknown_driver_total" else reason
                found[" ".join(word for word in (where, outcome, reason) if word)] += count
    return +found


def uncounted(cluster, accounts, there, limit):
    """What the books say of drops and the metrics do not, or the other way round. `there`: instances that are there in
    the end. A gateway asks its hosts for their counts now and then, so this waits until they agree. Returns the drops
    that are counted, by reason, and sentences about what is wrong."""
    deadline = time.monotonic() + limit
    while True:
        try:
            pages = {name: cluster.page(name) for name in (*schedule.GATEWAYS, *schedule.WORKERS)}
        except OSError as error:
            pages, wrong = {}, [f"a daemon does not show its metrics: {error}"]
        else:
            wrong = [text for gateway in schedule.GATEWAYS
                     for text in miscounted(gateway, counters(pages[gateway]), set(map(str, cluster.hosts(gateway))), accounts,
                                            there, cluster.emptied)]
            wrong += dropped_commands(pages, accounts, cluster.books)
        if not wrong or time.monotonic() > deadline:
            return drops(pages), wrong
        cluster.pause(0.5)


def miscounted(gateway, counted, hosts, accounts, there, emptied):
    """Of the messages that driver hosts which live have accepted. `hosts`: their process ids; each instance's runs name
    their process. A message of a blocked channel has one outcome that is counted; what never came is among those that
    were not confirmed; what was refused or dropped never came. No message of a spool is refused or dropped."""
    by_outcome, why = collections.Counter(), collections.Counter()
    wrong = []
    for (name, channel, outcome, reason), count in counted.items():
        if name != "iotcloud_driver_messages_total" or outcome in ("would_block", ""):
            continue
        if channel == ledger.BLOCKED:
            by_outcome[outcome] += count
            if outcome != "confirmed":
                why[f"{outcome} {reason}".strip()] += count
        elif outcome in ("refused", "dropped") and count:
            wrong.append(f"{gateway}'s hosts count {count} messages of {channel} channels as {outcome}: {reason}")
    blocked = [account for account in accounts if account.kind == ledger.BLOCKED]
    accepted = gone = unexcused = 0
    for account in blocked:
        lives = [run for run in account.runs if run.name.split(".")[0] in hosts]
        accepted += sum(len(run.sent) for run in lives)
        every = ledger.absent(account, account.came)
        gone += sum(len(every[run.name]) for run in lives)
        if account.instance in there:
            left = ledger.absent(account, account.came, ledger.lost_spans(account, account.came, emptied))
            unexcused += sum(len(left[run.name]) for run in lives)
    if sum(by_outcome.values()) != accepted:
        wrong.append(f"{gateway}'s hosts accepted {accepted} messages of blocked channels and count the outcomes "
                     f"{dict(by_outcome)}")
    surely = by_outcome["refused"] + by_outcome["dropped"]
    if surely > gone:
        wrong.append(f"{gateway}'s hosts count {surely} messages of blocked channels as refused or dropped ({dict(why)}), and "
                     f"{gone} never came")
    if unexcused > surely + by_outcome["unknown"]:
        wrong.append(f"{unexcused} messages of {gateway}'s blocked channels never came, and its hosts count {dict(why)} as "
                     "not confirmed")
    return wrong


def dropped_commands(pages, accounts, books):
    """Commands are dropped for guests that are not there (in time), and for no other reason."""
    guests = [account for account in accounts if account.heard is None]
    came = sum(len(account.came) for account in guests)
    unheard = came - sum(ledger.heard_of_guest(books, account.instance) for account in guests)
    wrong, by_workers, by_hosts = [], 0, 0
    for daemon, page in pages.items():
        for (name, where, _, reason), count in counters(page).items():
            not_there = name == "iotcloud_bolt_unknown_driver_total" or reason in NOT_THERE.get(name, ())
            if not_there and name == "iotcloud_driver_lost_total":
                by_hosts += count
            elif not_there:
                by_workers += count
            elif name in NOT_THERE and count and reason not in TRIED_AGAIN:
                wrong.append(f"{daemon} dropped {count} messages of {where} for the reason \"{reason}\", which nothing here has")
    if by_workers > unheard:
        wrong.append(f"workers dropped {by_workers} commands for drivers that are not there; guests lack {unheard}")
    if by_hosts > came:
        wrong.append(f"driver hosts dropped {by_hosts} commands for instances that are not there; guests were sent {came}")
    return wrong


def left_over(cluster, limit):
    """Processes of a cluster that was stopped. They are ended."""
    deadline = time.monotonic() + limit
    while (left := processes(cluster.out)) and time.monotonic() < deadline:
        time.sleep(0.1)
    signal_all([pid for pid, _ in left], signal.SIGKILL)
    return [f"process {pid} was left: {command}" for pid, command in left]
