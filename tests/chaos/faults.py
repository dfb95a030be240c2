"""Does the faults of a schedule to the cluster, and undoes them."""

import time

import schedule

SERVERS = (schedule.BROKER, schedule.ZOOKEEPER)
FILL = "full.of.nothing"  # the file that fills a disk


class Faults:
    """`actions`: a schedule's, without its orders. step() has to be called often, on the main thread. `on_wiped` is called
    when the registry has lost its data, `on_empty` when it serves again."""

    def __init__(self, cluster, actions, told=print, on_wiped=lambda: None, on_empty=lambda: None):
        self.cluster, self.told, self.on_wiped, self.on_empty = cluster, told, on_wiped, on_empty
        self.moments = sorted([(action.begin, 1, number, action) for number, action in enumerate(actions)] +
                              [(action.end, 2, number, action) for number, action in enumerate(actions)])
        self.began = None

    def start(self):
        self.began = time.monotonic()

    def passed(self):
        return time.monotonic() - self.began

    @property
    def over(self):
        return not self.moments

    def step(self):
        while self.moments and self.moments[0][0] <= self.passed():
            _, which, _, action = self.moments.pop(0)
            if which == 1:
                self.told(f"{self.passed():7.2f} s  {action.kind} {action.target}" +
                          (f" for {action.length:.2f} s" if action.length else ""))
            (self.begin if which == 1 else self.end)(action)

    def begin(self, action):
        cluster, kind, target = self.cluster, action.kind, action.target
        if kind in ("kill", "empty", "wipe") and target in SERVERS:
            cluster.scripts[target].say("kill")
            if target == schedule.BROKER:
                cluster.scripts[target].say(cluster.broker_was_killed)
            if kind == "empty":
                cluster.scripts[target].say(lambda: cluster.emptied.append(time.monotonic()))
            if kind != "kill":
                cluster.scripts[target].say(lambda: cluster.clear_data(target))
            if kind == "wipe":
                cluster.scripts[target].say(self.on_wiped)
        elif kind == "kill" and target.startswith("host:"):
            cluster.kill_hosts(target.removeprefix("host:"))
        elif kind == "kill":
            cluster.kill(target)
        elif kind == "freeze" and target in SERVERS:
            cluster.scripts[target].say("pause")
        elif kind == "freeze":
            cluster.freeze(target)
        elif kind == "full":
            self.fill(target)
        elif kind in schedule.MACHINE:
            cluster.deceive(target, schedule.CLOCK.get(kind, 0), kind == "broken")
        elif kind == "forbid":
            cluster.scripts[target].say("forbid")
        else:
            cluster.proxy.say(f"{kind} {target}")

    def end(self, action):
        cluster, kind, target = self.cluster, action.kind, action.target
        if kind in ("kill", "empty", "wipe") and target in SERVERS:
            if target == schedule.BROKER:
                cluster.scripts[target].say(cluster.broker_is_started)
            cluster.scripts[target].say("start")
            if kind == "wipe":
                cluster.scripts[target].say(self.on_empty)
        elif kind == "kill" and target.startswith("host:"):
            pass  # its gateway starts it again
        elif kind == "kill":
            cluster.bring_back(target)
        elif kind == "freeze" and target in SERVERS:
            cluster.scripts[target].say("resume")
        elif kind == "freeze":
            cluster.thaw(target)
        elif kind == "full":
            if target in cluster.disks:
                (cluster.disks[target] / FILL).unlink(missing_ok=True)
        elif kind in schedule.MACHINE:
            cluster.deceive(target)
        elif kind == "forbid":
            cluster.scripts[target].say("permit")
        elif kind != "reset":
            cluster.proxy.say(f"pass {target}")

    def fill(self, gateway):
        folder = self.cluster.disks.get(gateway)
        if folder is None:
            self.told(f"          {gateway} has no disk of its own here: left out")
            return
        with open(folder / FILL, "wb", buffering=0) as file:
            block = bytes(1 << 16)
            while True:
                try:
                    if file.write(block) < len(block):
                        return
                except OSError:
                    return
