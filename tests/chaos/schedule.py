"""What is done to the cluster, and when: a schedule is a pure function of its seed, and text that can be given back."""

import dataclasses
import random

MASTERS = ("master-1", "master-2")
GATEWAYS = ("gateway-1", "gateway-2")
WORKERS = ("worker-1", "worker-2")
HOSTS = tuple(f"host:{gateway}" for gateway in GATEWAYS)  # all driver hosts of a gateway
DAEMONS = MASTERS + GATEWAYS + WORKERS
READER = "reader"  # the second reader of all messages (ledger_reader.cc)
BROKER, ZOOKEEPER = "broker", "zookeeper"
BROKER_LINKS = tuple(f"{name}>{BROKER}" for name in GATEWAYS + WORKERS + (READER,))
ZOOKEEPER_LINKS = tuple(f"{name}>{ZOOKEEPER}" for name in DAEMONS)
LINKS = BROKER_LINKS + ZOOKEEPER_LINKS
GUESTS = tuple(f"guest-{number}" for number in (1, 2, 3))  # deployments that orders are about

BROKERS = ("rabbitmq", "kafka", "activemq")


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of fault: on which targets, and for how many seconds."""
    targets: tuple
    shortest: float
    longest: float
    weight: float = 1.0
    brokers: tuple = BROKERS


FAULTS = {
    "kill": Kind(DAEMONS + HOSTS + (READER, BROKER, ZOOKEEPER), 0.2, 6, 4),  # SIGKILL; started again at the end
    "freeze": Kind(DAEMONS + HOSTS + (READER, BROKER, ZOOKEEPER), 2, 20, 4),  # SIGSTOP
    "cut": Kind(LINKS, 1, 15, 2),  # nothing passes, nobody is told; what was sent comes afterwards
    "reset": Kind(LINKS, 0, 0, 1.5),  # every connection is reset, once
    "refuse": Kind(LINKS, 1, 10, 1.5),  # connections are reset, and new ones refused
    "half_open": Kind(LINKS, 1, 12, 1.5),  # the server's end is closed, the client is not told, ever
    "slow": Kind(LINKS, 2, 12, 1.5),  # 20 kB/s, 200 ms later
    "one_way_up": Kind(LINKS, 1, 12, 1),  # only from the client to the server
    "one_way_down": Kind(LINKS, 1, 12, 1),  # only from the server to the client
    "full": Kind(GATEWAYS, 2, 12, 1.5),  # the disk of the gateway's state folder, spools included; root only
    "clock_ahead": Kind(DAEMONS, 1, 15, 0.5),  # by an hour, and back
    "clock_back": Kind(DAEMONS, 1, 15, 0.5),
    "broken": Kind(GATEWAYS, 1, 10, 1),  # writing to its state folder, spools included, fails with EIO
    "forbid": Kind((BROKER,), 2, 10, 1, ("rabbitmq", "kafka")),  # nobody may write to the broker
    "empty": Kind((BROKER,), 0.5, 2, 0.5),  # killed, and started without its data
    "wipe": Kind((ZOOKEEPER,), 0.5, 2, 0.5),  # killed, and started without its data
}
CLOCK = {"clock_ahead": 3600, "clock_back": -3600}  # seconds
MACHINE = (*CLOCK, "broken")  # faults that a daemon believes in (machine.cc)
# What the tests of the project do: the README of this folder says what is left out, and why.
STEADY = ("kill", "freeze", "cut", "reset", "refuse", "slow", "one_way_up", "one_way_down")

ORDERS = ("deploy", "undeploy", "start", "stop", "update")


@dataclasses.dataclass(frozen=True)
class Action:
    """A fault or an order. Times in seconds from the begin of the faults."""
    begin: float
    kind: str
    target: str
    length: float = 0.0

    @property
    def is_order(self):
        return self.kind in ORDERS

    @property
    def end(self):
        return self.begin + self.length

    def line(self):
        return f"{self.begin:8.2f}  {self.kind:<12}  {self.target:<20}  {self.length:6.2f}"


def lanes(chooser, seconds, kinds, broker, targets):
    """Faults of two lanes; within a lane they follow one another, so at most two are under way."""
    usable = [kind for kind in kinds if broker in FAULTS[kind].brokers]
    weights = [FAULTS[kind].weight for kind in usable]
    made = []
    for _ in range(2):
        at = chooser.uniform(0.5, 3)
        while at < seconds:
            kind = chooser.choices(usable, weights)[0]
            choice = [target for target in FAULTS[kind].targets if not targets or target in targets]
            length = round(chooser.uniform(FAULTS[kind].shortest, FAULTS[kind].longest), 2)
            length = min(length, max(0.0, round(seconds - at, 2)))
            begin = round(at, 2)
            if choice and length >= min(FAULTS[kind].shortest, 0.2):
                target = chooser.choice(choice)
                action = Action(begin, kind, target, length)
                if not any(clash(action, other) for other in made):
                    made.append(action)
            at += length + chooser.uniform(1, 5)
    return made


def clash(one, other):
    """Whether two faults are of the same target and overlap, with a moment between them."""
    apart = 1.0
    return one.target == other.target and one.begin < other.end + apart and other.begin < one.end + apart


def orders(chooser, seconds):
    """Mostly such as make sense if those before were carried out."""
    made, at, state = [], chooser.uniform(1, 3), dict.fromkeys(GUESTS, "undeploy")
    sensible = {"undeploy": ["deploy"], "deploy": ["stop", "update", "undeploy"], "start": ["stop", "update", "undeploy"],
                "stop": ["start", "start", "undeploy"]}
    while at < seconds:
        guest = chooser.choice(GUESTS)
        kind = chooser.choice(sensible[state[guest]] if chooser.random() < 0.9 else ORDERS)
        made.append(Action(round(at, 2), kind, guest))
        if kind != "update":
            state[guest] = kind
        at += chooser.uniform(1.5, 4)
    return made


def generate(seed, seconds, broker="rabbitmq", kinds=None, targets=None):
    """The actions of a seed, in order of their begin. `kinds`: of faults, all without it; `targets`: only these, all
    without it. Nothing begins or ends after `seconds`."""
    kinds = tuple(kinds or FAULTS)
    for kind in kinds:
        if kind not in FAULTS:
            raise ValueError(f"there is no fault \"{kind}\"; there are: {', '.join(FAULTS)}")
    chooser = random.Random(f"{seed} {broker}")
    made = lanes(chooser, seconds, kinds, broker, targets) + orders(chooser, seconds)
    return sorted(made, key=lambda action: (action.begin, action.kind, action.target))


def text(actions, title=""):
    """A line for each action: begin in seconds, kind, target, length in seconds."""
    head = f"# {title}\n" if title else ""
    return head + "".join(action.line().rstrip() + "\n" for action in actions)


def parse(content):
    """The actions of text(). Raises ValueError that names the line."""
    made = []
    for number, line in enumerate(content.splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            begin, kind, target, length = words
            action = Action(float(begin), kind, target, float(length))
        except ValueError as error:
            raise ValueError(f"line {number}: \"{line}\" is no action: BEGIN KIND TARGET LENGTH") from error
        known = GUESTS if action.is_order else FAULTS[kind].targets if kind in FAULTS else ()
        if target not in known:
            raise ValueError(f"line {number}: there is no \"{kind}\" of \"{target}\"")
        made.append(action)
    return sorted(made, key=lambda action: (action.begin, action.kind, action.target))
