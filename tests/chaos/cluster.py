"""A private cluster to which faults are done: each link to the broker and to ZooKeeper goes through a proxy (proxy.py).

All of it happens on the main thread, because children end with the thread that started them. Servers take seconds to
start, so what is told to them is answered later: pump() has to be called often.
"""

import collections
import os
import select
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

import schedule  # noqa: E402
from private_cluster import PrivateCluster, StartError  # noqa: E402
from private_server import free_ports, wait_until_frozen  # noqa: E402

SESSION_S, HEARTBEAT_S = 6, 2
DISK_MB = 48  # of each gateway's state folder, when it is a disk of its own

TOPOLOGY = """
registry: "{registry}"
registry.session_timeout: {session}s
topology.name: chaos
topology.library: "{library}"
metrics: {{address: "127.0.0.1:{metrics}"}}
brokers:
  main: {{urls: ["{url}"], heartbeat: {heartbeat}s}}
conf: {{books: "{books}"}}
spouts:
{spouts}
bolts:
  enter:
    class: chaos.Ledger
    parallelism: 2
    inputs:
{inputs}
  command:
    broker: main
    driver: ledger
    channel: command
    fields: [data, driverID, time]
    parallelism: 2
    inputs: [{{from: enter, grouping: fields, fields: [driverID]}}]
"""


def ledger_topology(kinds=("spooled", "blocked"), **values):
    """YAML of the topology that enters what the ledger driver's channels send, and sends commands back. `values`: registry,
    metrics (a port), library, url (the broker's), books."""
    spouts = "\n".join(f"  {kind}: {{broker: main, driver: ledger, channel: {kind}, "
                       "fields: [data, driverID, time, redelivered], parallelism: 2}" for kind in kinds)
    inputs = "\n".join(f"      - {{from: {kind}, grouping: fields, fields: [driverID]}}" for kind in kinds)
    return TOPOLOGY.format(session=SESSION_S, heartbeat=HEARTBEAT_S, spouts=spouts, inputs=inputs, **values)


def copy_plugins(build, folder):
    """The ledger's plugins, and another version of the driver that does the same: bytes behind a library are never read."""
    shutil.copytree(build / "chaos/plugins", folder)
    first = folder / "chaos_ledger_driver.so"
    (folder / "chaos_ledger_driver-2.so").write_bytes(first.read_bytes() + b"2")


class Answers:
    """A server's script: commands are sent one after the other, without waiting for their answers."""

    def __init__(self, name, child):
        self.name, self.child = name, child
        self.waiting = collections.deque()  # commands to be sent, or functions to be called between them
        self.asked = None  # the command whose answer is due

    def say(self, *commands):
        self.waiting.extend(commands)
        self.pump()

    def pump(self):
        if self.asked and select.select([self.child.stdout], [], [], 0)[0]:
            answer = self.child.stdout.readline().strip()
            if not answer or answer.startswith("ERROR"):
                raise StartError(f"{self.name}: {self.asked}: {answer or 'no answer'}")
            self.asked = None
        while self.waiting and not self.asked:
            command = self.waiting.popleft()
            if callable(command):
                command()
                continue
            self.asked = command
            self.child.stdin.write(command + "\n")
            self.child.stdin.flush()

    @property
    def idle(self):
        return not self.asked and not self.waiting


class ChaosCluster(PrivateCluster):
    def __init__(self, build, out, broker="rabbitmq", deceived=False):
        """`deceived`: daemons, with their driver hosts, may be made to believe what machine.cc says."""
        self.build = Path(build).resolve()
        super().__init__(out, self.build / "bin", out / "plugins")
        self.broker = broker
        # Kafka carries shared channels only.
        self.shared = "true" if broker == "kafka" else "false"
        copy_plugins(self.build, self.plugins)
        self.books = self.out / "books"
        self.books.mkdir()
        self.scripts, self.metrics = {}, {}
        self.down = set()  # daemons that a fault has ended
        self.frozen = {}  # by target, the processes that a fault has stopped
        self.violations = []  # seen meanwhile
        self.disks = {}  # by gateway, the folder that is a disk of its own
        self.emptied = []  # when the broker lost its data
        self.outages = []  # when the broker was killed, and when it was started again
        self.deceived = deceived

    # -- start

    def server(self, kind, *options):
        url = super().server(kind, *options)
        name = {self.broker: schedule.BROKER}.get(kind, kind)
        self.scripts[name] = Answers(name, self.children[-1][1])
        return url

    def start(self, limit):
        """Servers, proxies and daemons; returns when the gateways are ready and both workers are known, for which there
        are `limit` seconds."""
        self.proxy = Answers("proxy", self.spawn("proxy", ["/usr/bin/python3", HERE / "proxy.py"], stdin=subprocess.PIPE,
                                                 stdout=subprocess.PIPE, text=True))
        self.direct_zookeeper = self.server("zookeeper")
        if self.broker == "kafka":
            ports = iter(free_ports(2 * len(schedule.BROKER_LINKS)))
            listeners = {link: (next(ports), next(ports)) for link in schedule.BROKER_LINKS}
            options = [word for pair in listeners.values() for word in ("--listener", f"{pair[0]}:{pair[1]}")]
            self.direct_broker = self.server("kafka", "--acls", "--partitions", "4", *options)
            self.ports = {link: self.link(link, f"127.0.0.1:{own}", advertised)
                          for link, (own, advertised) in listeners.items()}
        else:
            self.direct_broker = self.server(self.broker)
            self.ports = {link: self.link(link, address(self.direct_broker)) for link in schedule.BROKER_LINKS}
        for link in schedule.ZOOKEEPER_LINKS:
            self.ports[link] = self.link(link, address(self.direct_zookeeper))
        self.make_disks()
        self.start_daemons()
        self.wait_until_ready(limit)

    def link(self, name, target, port=""):
        """Makes a link of the proxy; returns its port."""
        child = self.proxy.child
        child.stdin.write(f"link {name} {target} {port}\n")
        child.stdin.flush()
        answer = child.stdout.readline().strip()
        if not answer.isdigit():
            raise StartError(f"the proxy: {answer}")
        return int(answer)

    def make_disks(self):
        """Gives each gateway's state folder a small disk of its own, if this process may mount one (chaos.py
        has made a space of mounts of its own)."""
        for gateway in schedule.GATEWAYS:
            folder = self.out / "state" / gateway
            folder.mkdir(parents=True)
            if os.environ.get("IOTCLOUD_CHAOS_HAS_ITS_SPACES") and subprocess.run(
                    ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m,mode=0755", "tmpfs", folder],
                    capture_output=True, check=False).returncode == 0:
                self.disks[gateway] = folder

    def url(self, name, server):
        direct = self.direct_broker if server == schedule.BROKER else self.direct_zookeeper
        return direct.replace(address(direct), f"127.0.0.1:{self.ports[f'{name}>{server}']}")

    def start_daemons(self):
        ports = iter(free_ports(3 * len(schedule.DAEMONS)))
        self.metrics = {name: next(ports) for name in schedule.DAEMONS}
        for name in schedule.MASTERS:
            self.apis[name], self.for_gateways[name] = next(ports), next(ports)
            self.daemon("iotcloud-master", name, self.common(name) + f"""
api: {{host: 127.0.0.1, port: {self.apis[name]}}}
gateways: {{host: 127.0.0.1, port: {self.for_gateways[name]}}}
""")
        for name in schedule.GATEWAYS:
            self.daemon("iotcloud-gateway", name, self.common(name) + f"""
thrift: {{host: 127.0.0.1, port: {next(ports)}}}
plugins: "{self.plugins}"
state: "{self.out / 'state' / name}"
host_debugging: true
host_environment: [LD_PRELOAD, CHAOS_MACHINE_FILE, CHAOS_DISK]
host_restart: {{first: 200ms, longest: 2s, give_up_after: 0}}
brokers:
  main: {{type: {self.broker}, urls: ["{self.url(name, schedule.BROKER)}"], heartbeat: {HEARTBEAT_S}s}}
""")
        self.gateways = len(schedule.GATEWAYS)
        for name in schedule.WORKERS:
            self.workers += 1
            self.daemon("iotcloud-topology", name, ledger_topology(
                registry=self.url(name, schedule.ZOOKEEPER), metrics=self.metrics[name],
                library=self.plugins / "chaos_ledger_bolt.so", url=self.url(name, schedule.BROKER), books=self.books))

    def daemon(self, program, name, configuration, enter=(), options=()):
        if self.deceived:
            self.deceive(name)
            enter = ["env", f"LD_PRELOAD={self.build / 'chaos/chaos_machine.so'}",
                     f"CHAOS_MACHINE_FILE={self.out / name}.machine", f"CHAOS_DISK={self.out / 'state' / name}", *enter]
        return super().daemon(program, name, configuration, enter, options)

    def deceive(self, name, ahead=0, broken=False):
        """From now on the daemon's time of the day is so many seconds ahead, and its disk is broken or not."""
        file = self.out / f"{name}.machine"
        with open(file, "r+" if file.exists() else "w", encoding="ascii") as state:
            state.write(f"{ahead:<15}\n{int(broken):<15}\n")

    def common(self, name):
        return f"""
id: {name}
registry: "{self.url(name, schedule.ZOOKEEPER)}"
registry.session_timeout: {SESSION_S}s
metrics: {{address: "127.0.0.1:{self.metrics[name]}"}}"""

    def start_reader(self, exchange, topics):
        self.commands[schedule.READER] = [
            self.build / "chaos/chaos_ledger_reader", self.books, self.url(schedule.READER, schedule.BROKER),
            1000 * HEARTBEAT_S, exchange, *topics]
        self.again(schedule.READER)

    # -- what is there

    def process(self, name):
        """The child of that name, None when it is down."""
        return next((child for known, child in self.children if known == name), None)

    def hosts(self, gateway=None):
        """Process ids of driver hosts, also of those whose gateway has died."""
        folder = self.out / "state" / (gateway or "")
        return [pid for pid, command in processes(folder) if "iotcloud-driver-host" in command.split(" ")[0]]

    def hosts_of_ledger(self, gateway):
        """Those of them that run the first version of the ledger driver."""
        folder = self.out / "state" / gateway
        return [pid for pid, command in processes(folder) if "iotcloud-driver-host" in command.split(" ")[0] and
                "ledger_driver-2" not in command]

    def page(self, name):
        """A daemon's metrics: (name with labels, value). OSError when it does not answer."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self.metrics[name]}/metrics", timeout=5) as answer:
            lines = answer.read().decode().splitlines()
        return [(key, float(value)) for key, _, value in (line.rpartition(" ") for line in lines if not line.startswith("#"))]

    def channels_read(self):
        """How many channels the topology's workers read."""
        pages = [self.page(worker) for worker in schedule.WORKERS]
        return sum(value for page in pages for name, value in page if name.startswith("iotcloud_spout_channels"))

    # -- meanwhile

    def pump(self):
        """Sends what servers are to be told, and starts daemons again that ended although nobody ended them."""
        for script in (*self.scripts.values(), self.proxy):
            script.pump()
        for name, child in list(self.children):
            if child.poll() is None or name in self.down:
                continue
            self.children.remove((name, child))
            if name not in self.commands:
                raise StartError(f"{name} ended before its time; see {self.log(name)}")
            self.violations.append(f"{name} ended by itself: {ended(child.returncode)}; its log is {self.log(name)}")
            self.again(name)

    def pause(self, seconds):
        """Sleeps, and pumps."""
        until = time.monotonic() + seconds
        while True:
            self.pump()
            left = until - time.monotonic()
            if left <= 0:
                return
            time.sleep(min(0.05, left))

    @property
    def idle(self):
        return all(script.idle for script in (*self.scripts.values(), self.proxy))

    # -- faults (faults.py says when)

    def kill(self, name):
        child = self.process(name)
        if child is None:
            return
        self.down.add(name)
        child.kill()
        child.wait()
        self.children.remove((name, child))

    def kill_hosts(self, gateway):
        signal_all(self.hosts(gateway), signal.SIGKILL)

    def bring_back(self, name):
        if name in self.down:
            self.down.discard(name)
            self.again(name)

    def freeze(self, target):
        if target.startswith("host:"):
            stopped = self.hosts(target.removeprefix("host:"))
            signal_all(stopped, signal.SIGSTOP)
        else:
            child = self.process(target)
            child.send_signal(signal.SIGSTOP)
            wait_until_frozen(child)
            stopped = [child.pid]
        self.frozen[target] = stopped

    def thaw(self, target):
        signal_all(self.frozen.pop(target, []), signal.SIGCONT)

    def broker_was_killed(self):
        self.outages.append((time.monotonic(), float("inf")))

    def broker_is_started(self):
        self.outages[-1] = (self.outages[-1][0], time.monotonic())

    def clear_data(self, server):
        """Removes the data of a server that is down."""
        folder = self.out / (self.broker if server == schedule.BROKER else server) / "data"
        shutil.rmtree(folder, ignore_errors=True)
        if server == schedule.ZOOKEEPER:
            folder.mkdir()

    # -- end

    def stop(self, limit=60):
        for target in list(self.frozen):
            self.thaw(target)
        for name, child in reversed(self.children):
            if name not in self.commands or child.poll() is not None:
                continue
            child.send_signal(signal.SIGTERM)
            try:
                child.wait(limit)
            except subprocess.TimeoutExpired:
                self.violations.append(f"{name} did not stop within {limit} s; its log is {self.log(name)}")
                child.kill()
                child.wait()
        super().stop(limit)
        for folder in self.disks.values():
            keep_files_of(folder)
        self.disks = {}


def address(url):
    """host:port of a URL."""
    return url.split("://")[1].split("@")[-1].split("/")[0]


def signal_all(pids, number):
    for pid in pids:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            pass


def keep_files_of(disk):
    """Takes away a small disk; its files stay, in the folder where it was."""
    kept = disk.with_name(disk.name + ".kept")

    def sockets(folder, names):
        return [name for name in names if Path(folder, name).is_socket()]

    try:
        shutil.copytree(disk, kept, symlinks=True, ignore=sockets)
    except (OSError, shutil.Error) as error:
        print(f"not all files of {disk} are kept: {error}", flush=True)
    unmount(disk)
    try:
        disk.rmdir()
        kept.rename(disk)
    except OSError as error:
        print(f"what was in {disk} is in {kept}: {error}", flush=True)


def unmount(disk):
    subprocess.run(["umount", "--lazy", disk], check=False)


def processes(folder):
    """(process id, command line) of each living process with a path below `folder` in its command line."""
    marker, found = f"{folder}/", []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if marker in command:
            found.append((int(entry.name), command))
    return found


def ended(status):
    return f"by signal {-status}" if status < 0 else f"with status {status}"
