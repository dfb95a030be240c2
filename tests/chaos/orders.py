"""Orders by the command line while faults are done, and what must be true afterwards of what it answered.

The orders are about `guests`, instances of the ledger driver with a name of their own. After each order the set of states
in which its guest may be is known: one, if the answer was `done` or `pending` (the gateway is lost, and follows the order
when it comes back); otherwise also the ordered one. So is the set of plugins that it may run: after an update the new one
if the answer was `done`, the one before if it says that the guest is back on it, otherwise both.
"""

import json
import subprocess
import time

import schedule

ABSENT, ACTIVE, INACTIVE, FAILED = "absent", "active", "inactive", "failed"
TARGET = {"deploy": ACTIVE, "undeploy": ABSENT, "start": ACTIVE, "stop": INACTIVE}
LIMIT_S = 90  # the command line answers within this time, whatever is done to the cluster


NOT_THERE = "no driver instance is chosen"  # the command line's words for a selection of nothing
BACK = "back on "  # how the reason of an update begins that failed and was undone


class UntrueAnswer(Exception):
    """The text says what the command line answered, and what is so."""


def not_at_work(listed):
    """The gateways of the cluster that are not there, not ready, or frozen. `listed`: by the command line."""
    at_work = {gateway["gateway"] for gateway in listed if gateway["state"] == "ready" and not gateway["frozen"]}
    return [gateway for gateway in schedule.GATEWAYS if gateway not in at_work]


class Person:
    """Who operates the cluster: has a backup of what is ordered, and puts the registry right when it was wiped, because the
    gateways are frozen until somebody does. Tries again until all gateways are ready."""

    AGAIN_S = 1.0  # until a command that failed is tried again

    def __init__(self, cluster, told=print):
        self.cluster, self.told = cluster, told
        self.backup = cluster.out / "backup.json"
        self.to_do = []
        self.running = None  # (the command's words, its process, the file with what it prints)
        self.not_before = 0.0

    def keep_backup(self):
        self.cluster.cli("registry", "export", self.backup)

    def put_right(self):
        """The registry was wiped, and is there again."""
        self.to_do = [("registry", "import", self.backup), ("registry", "adopt", "--all"), ("gateways", "-o", "json")]

    @property
    def idle(self):
        return not self.to_do and not self.running

    def step(self):
        if self.running:
            words, process, out = self.running
            if process.poll() is None:
                return
            out.seek(0)
            printed = out.read()
            out.close()
            self.running = None
            self.learn(words, process.returncode, printed)
        if self.to_do and time.monotonic() >= self.not_before:
            out = open(self.cluster.out / "person.txt", "w+", encoding="utf-8")
            self.running = (self.to_do[0], subprocess.Popen(self.cluster.command(*self.to_do[0]), stdin=subprocess.DEVNULL,
                                                            stdout=out, stderr=subprocess.STDOUT), out)

    def learn(self, words, status, printed):
        if not self.to_do or words != self.to_do[0]:
            return  # the registry was wiped once more meanwhile
        if words[0] == "gateways":
            if status == 0 and not not_at_work(json.loads(printed)):
                self.to_do = []
            else:
                self.to_do = [("registry", "adopt", "--all"), words]
        elif words[1] == "adopt" or status == 0:
            self.to_do = self.to_do[1:]
        if words[0] == "registry":
            self.told(f"          iotcloud {words[0]} {words[1]}: status {status}: {' '.join(printed.split())[:150]}")
        self.not_before = time.monotonic() + self.AGAIN_S


class Guest:
    def __init__(self, name, gateway, plugins):
        self.name, self.gateway, self.plugins = name, gateway, plugins
        self.possible = {ABSENT}
        self.runs = set()  # plugins of which it runs one, if it is there
        self.ordered = plugins[0]  # by the order under way
        self.updates = 0
        self.void = False  # what the order under way says is worth nothing: the registry was wiped since it was given
        self.under_way = None  # (the action, the command line's process, when it began, the files with what it prints)

    def words(self, cluster, kind):
        if kind == "deploy":
            self.ordered = self.plugins[0]
            return ["deploy", self.ordered, "--gateway", self.gateway, "--name", self.name, "--property",
                    f"folder={cluster.books}", "--property", "kind=blocked", "--property", "rate=5", "--property",
                    f"shared={cluster.shared}"]
        if kind == "update":
            self.updates += 1
            self.ordered = self.plugins[self.updates % 2]
            return ["update", "--plugin", self.ordered, "--name", self.name]
        return [kind, "--name", self.name]

    def learn(self, kind, status, answer, printed=""):
        """`status`: of the command line; `answer`: its JSON, None when it gave none; `printed`: all it printed. Returns what
        the answer said. Raises UntrueAnswer when it says that a guest is not there that is, or when the exit status says
        something else than the outcome."""
        if NOT_THERE in printed and ABSENT not in self.possible:
            raise UntrueAnswer(f"iotcloud {kind} --name {self.name} found no such instance; it is "
                               f"{' or '.join(sorted(self.possible))}")
        told = answer.get("outcomes", []) if isinstance(answer, dict) else []
        outcomes = [each["outcome"] for each in told]
        said = outcomes[0] if len(outcomes) == 1 else f"status {status}"
        if (status == 0) != all(outcome == "done" for outcome in outcomes) and outcomes and status >= 0:
            raise UntrueAnswer(f"iotcloud {kind} --name {self.name} ended with status {status} and says {', '.join(outcomes)}")
        if self.void:
            return said
        if kind in ("deploy", "update"):
            self.learn_plugin(kind, said, told)
        if kind == "update":
            return said
        goal = TARGET[kind]
        if said in ("done", "pending"):
            self.possible = {goal}
        elif said == "unknown" or not outcomes:
            # A selection that selects nothing is refused; so is a deployment of what is there already.
            self.possible |= {goal}
        else:
            self.possible |= {goal, FAILED}
        return said

    def learn_plugin(self, kind, said, told):
        if said == "done" or (kind == "deploy" and said == "pending"):
            self.runs = {self.ordered}
        elif not (kind == "update" and said == "failed" and told[0].get("reason", "").startswith(BACK)):
            self.runs = self.runs | {self.ordered}


class Orders:
    """`actions`: a schedule's orders. An order to a guest whose last one is not answered yet is left out."""

    def __init__(self, cluster, actions, plugins, told=print):
        self.cluster, self.actions, self.told = cluster, list(actions), told
        self.guests = {name: Guest(name, schedule.GATEWAYS[number % 2], plugins)
                       for number, name in enumerate(schedule.GUESTS)}
        self.began = None
        self.given = 0
        self.violations = []

    def start(self):
        self.began = time.monotonic()

    @property
    def over(self):
        return not self.actions and not any(guest.under_way for guest in self.guests.values())

    def step(self):
        for guest in self.guests.values():
            if guest.under_way:
                self.look_after(guest)
        while self.actions and self.actions[0].begin <= time.monotonic() - self.began:
            action = self.actions.pop(0)
            guest = self.guests[action.target]
            if guest.under_way is None:
                self.give(guest, action)

    def registry_wiped(self):
        """The orders until now are gone."""
        for guest in self.guests.values():
            guest.possible = {ABSENT, ACTIVE, INACTIVE, FAILED}
            guest.runs = set(guest.plugins)
            guest.void = guest.under_way is not None

    def give(self, guest, action):
        guest.void = False
        command = self.cluster.command(*guest.words(self.cluster, action.kind), "-o", "json")
        self.given += 1
        # What an order waits for is told apart from the answer, which is JSON.
        out, told = (open(self.cluster.out / f"order-{self.given}.{end}", "w+", encoding="utf-8") for end in ("json", "txt"))
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=told)
        guest.under_way = (action, process, time.monotonic(), out, told)

    def look_after(self, guest):
        action, process, began, out, told = guest.under_way
        took = time.monotonic() - began
        if process.poll() is None:
            if took > LIMIT_S:
                process.kill()
                process.wait()
                self.violations.append(f"iotcloud {action.kind} --name {guest.name} did not answer within {LIMIT_S} s")
            else:
                return
        guest.under_way = None
        printed = ""
        for file in (out, told):
            file.seek(0)
            printed += file.read()
        out.seek(0)
        try:
            answer = json.load(out)
        except ValueError:
            answer = None
        out.close()
        told.close()
        try:
            said = guest.learn(action.kind, process.returncode, answer, printed)
        except UntrueAnswer as error:
            said = f"untrue: {error}"
            self.violations.append(str(error))
        self.told(f"{time.monotonic() - self.began:7.2f} s  iotcloud {action.kind} {guest.name}: {said} after {took:.1f} s")
        if process.returncode < 0:
            self.violations.append(f"iotcloud {action.kind} was ended by signal {-process.returncode}: {printed[-300:]}")

    def untrue(self, drivers):
        """What the command line answered and is not so. `drivers`: what it lists now."""
        wrong = []
        for guest in self.guests.values():
            listed = [driver for driver in drivers if driver["name"] == guest.name]
            state = listed[0]["state"] if listed else ABSENT
            if state not in guest.possible:
                wrong.append(f"{guest.name} is {state}" + (f" ({listed[0].get('reason', '')})" if listed else "") +
                             f"; after what the command line answered it is {' or '.join(sorted(guest.possible))}")
            elif state in (ACTIVE, INACTIVE) and listed[0]["plugin"]["file"] not in guest.runs:
                wrong.append(f"{guest.name} runs {listed[0]['plugin']['file']}; after what the command line answered it runs "
                             f"{' or '.join(sorted(guest.runs))}")
        return wrong

    def start_stopped(self):
        """Starts all guests that are stopped, because a topology does not read the channels of a stopped instance, and
        what it had accepted is to come. Returns what was wrong."""
        wrong = []
        for driver in self.cluster.json("drivers"):
            if driver["name"] in self.guests and driver["state"] == INACTIVE:
                answer = self.cluster.answer("start", driver["instance"])
                wrong += [f"{driver['name']} could not be started after the faults: {outcome}"
                          for outcome in answer["outcomes"] if outcome["outcome"] != "done"]
        return wrong
