"""A private system on loopback for the demo and the system tests: servers and daemons as children of this process.

Every child is stopped by its process id. The scripts of servers (rabbitmq.py, zookeeper.py) end at the end of their
standard input; the kernel sends other children a signal when this process ends. So nothing outlives a script that was
killed.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from private_server import die_with_parent, free_ports  # noqa: E402


# Options of a daemon that must stop in order however busy the machine is.
PATIENT_STOP = ("--stop-limit", "60")


class StartError(Exception):
    """Something did not start; the text names its log."""


class Unavailable(Exception):
    """A server cannot be had on this machine now; what needs it is skipped."""


def require(condition, text):
    """Ends the test with `text` unless the condition is true."""
    if not condition:
        sys.exit(f"wrong: {text}")


def wait_for(what, condition, limit=120):
    """Waits until `condition` is true; ends the test if that takes too long. A master or a page that does not answer yet
    is asked again."""
    deadline, problem = time.monotonic() + limit, ""
    while time.monotonic() < deadline:
        try:
            if condition():
                return
            problem = ""
        except (StartError, OSError) as error:
            problem = f"; {error}"
        time.sleep(0.1)
    sys.exit(f"not within {limit} s: {what}{problem}")


def answer_of(what, question):
    """The answer to a question that is asked again where wait_for() asks again: gateways and driver hosts that a busy machine
    lets answer too late have not answered."""
    answers = []
    wait_for(what, lambda: answers.append(question()) or True)
    return answers[0]


def children_of(process):
    """Ids of the children of a process."""
    found = []
    try:
        threads = os.listdir(f"/proc/{process}/task")
    except OSError:
        return []  # it has ended
    for thread in threads:
        try:
            found += map(int, Path(f"/proc/{process}/task/{thread}/children").read_text().split())
        except OSError:
            pass  # the thread has ended since it was listed; another one has its children
    return found


def echo_topology(spouts=1, bolts=1, more="", broker="rabbitmq"):
    """YAML of a topology that sends back what load generators send. `spouts`, `bolts`: parallelism; `more`: further
    lines; `broker`: that of the channels."""
    return f"""
zk.servers: ["{{zookeeper}}"]
topology.name: echo
{more}
spouts:
  receive: {{broker: {broker}, driver: loadgen, channel: data, fields: [data, driverID, time], parallelism: {spouts}}}
bolts:
  send:
    broker: {broker}
    driver: loadgen
    channel: echo
    fields: [data, driverID, time]
    parallelism: {bolts}
    inputs: [{{from: receive, grouping: fields, fields: [driverID]}}]
"""


def passing_topology(cluster, library, more=""):
    """The YAML file, in the cluster's folder with the library passing.so, of a topology that reads what load generators
    send. `more`: further lines."""
    shutil.copy(library, cluster.out / "passing.so")
    file = cluster.out / "echo.yaml"
    file.write_text(f"""
zk.servers: ["{cluster.zookeeper.removeprefix("zookeeper://")}"]
topology.name: echo
topology.library: passing.so
{more}
spouts:
  receive: {{broker: rabbitmq, driver: loadgen, channel: data, fields: [data, driverID, time]}}
bolts:
  pass: {{class: passing.Pass, inputs: [{{from: receive, grouping: fields, fields: [driverID]}}]}}
""")
    return file


def result_of(report):
    """A load generator's report, None until it is written (when everything is back)."""
    text = report.read_text() if report.exists() else ""
    return json.loads(text) if text.rstrip().endswith("}") else None


def free_port():
    return free_ports(1)[0]


class Children:
    """Processes with a log file each in `out`, stopped in reverse order at the end of the `with` block."""

    def __init__(self, out):
        self.out = Path(out).resolve()
        self.out.mkdir(parents=True, exist_ok=True)
        self.children = []  # (name, Popen), in starting order

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def log(self, name):
        return self.out / f"{name}.log"

    def spawn(self, name, command, log_mode="w", **options):
        """Starts a program, with options of Popen. From the main thread only: it ends with the thread that started it."""
        if "stdin" not in options:
            options = {"preexec_fn": die_with_parent, **options}
        with open(self.log(name), log_mode) as log:
            child = subprocess.Popen([str(word) for word in command], stderr=log, start_new_session=True, **options)
        self.children.append((name, child))
        return child

    def server(self, kind, *options):
        """Starts a private server ("rabbitmq", "kafka", ...: a script of this folder) and returns its URL. Its files are in out/kind."""
        child = self.spawn(kind, ["/usr/bin/python3", HERE / f"{kind}.py", "--dir", self.out / kind, *options],
                           stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        answer = child.stdout.readline().strip()
        if answer.startswith("SKIP "):
            raise Unavailable(f"{kind}: {answer.removeprefix('SKIP ')}")
        if not answer.startswith("READY "):
            raise StartError(f"{kind} did not start: {answer or 'no answer'}; see {self.log(kind)}")
        return answer.removeprefix("READY ")

    def tell(self, name, command):
        """Gives a server's script a command ("kill", "start", ...), and returns its answer."""
        child = dict(self.children)[name]
        child.stdin.write(command + "\n")
        child.stdin.flush()
        answer = child.stdout.readline().strip()
        if not answer or answer.startswith("ERROR"):
            raise StartError(f"{name}: {command}: {answer or 'no answer'}; see {self.log(name)}")
        return answer

    def descendants(self):
        """Ids of the children's processes, their children and so on."""
        found = [child.pid for _, child in self.children]
        for process in found:
            found += children_of(process)
        return found

    def dead(self):
        """Name of a child that ended although nobody stopped it; None when all live."""
        for name, child in self.children:
            if child.poll() is not None:
                return name
        return None

    def require_alive(self):
        name = self.dead()
        if name:
            raise StartError(f"{name} ended before its time with status {dict(self.children)[name].returncode}; the end of "
                             f"{self.log(name)}:\n{self.last_lines(name)}")

    def last_lines(self, name, count=20):
        """The last lines of a child's log."""
        return "\n".join(self.log(name).read_text(errors="replace").splitlines()[-count:])

    def stop(self, limit=10):
        while self.children:
            name, child = self.children.pop()
            if child.poll() is not None:
                continue
            if child.stdin:
                child.stdin.close()
            else:
                child.send_signal(signal.SIGTERM)
            try:
                child.wait(limit)
            except subprocess.TimeoutExpired:
                print(f"{name} did not stop within {limit} s and is killed; see {self.log(name)}")
                child.kill()
                child.wait()


class PrivateCluster(Children):
    """RabbitMQ, ZooKeeper, masters, gateways named gateway-1, gateway-2, ... and topology workers."""

    def __init__(self, out, bin_dir, plugin_dir):
        super().__init__(out)
        self.bin, self.plugins = Path(bin_dir).resolve(), Path(plugin_dir).resolve()
        # All by the daemons' names: the ports of the masters' two services and of the gateways' one, and the command
        # lines.
        self.apis, self.for_gateways, self.thrift_ports, self.commands = {}, {}, {}, {}
        self.workers = 0  # number of topology workers started so far

    def start(self, gateways=2, brokers=None, more="", masters=1, of_masters="", of_api=""):
        """`brokers`: lines of YAML below that key of the gateways' configuration; None: a private RabbitMQ. `more`: lines
        of that configuration beside. `masters`: one is named master, several master-1, master-2, ...; `of_masters`: lines
        of their configuration beside; `of_api`: more keys of its `api`, each behind a comma."""
        self.zookeeper = self.server("zookeeper")
        if brokers is None:
            self.rabbitmq = self.server("rabbitmq")
            brokers = [f'rabbitmq: {{type: rabbitmq, urls: ["{self.rabbitmq}"]}}']
        listed = "\n".join("  " + line for line in brokers)
        ports = iter(free_ports(2 * masters + gateways))  # ports that nobody takes while a daemon is dead
        for name in ["master"] if masters == 1 else [f"master-{number}" for number in range(1, masters + 1)]:
            self.apis[name], self.for_gateways[name] = next(ports), next(ports)
            self.daemon("iotcloud-master", name, f"""
id: private-{name}
registry: "{self.zookeeper}"
api: {{host: 127.0.0.1, port: {self.apis[name]}{of_api}}}
gateways: {{host: 127.0.0.1, port: {self.for_gateways[name]}}}
{of_masters}
""")
        self.api_port = next(iter(self.apis.values()))
        for number in range(1, gateways + 1):
            name = f"gateway-{number}"
            self.thrift_ports[name] = next(ports)
            self.daemon("iotcloud-gateway", name, f"""
id: {name}
registry: "{self.zookeeper}"
thrift: {{host: 127.0.0.1, port: {self.thrift_ports[name]}}}
plugins: "{self.plugins}"
state: "{self.out / 'state' / name}"
{more}
brokers:
{listed}
""")
        self.gateways = gateways

    def daemon(self, program, name, configuration, enter=(), options=()):
        """`enter`: the words before the program's own, which start it (in another network, say)."""
        file = self.out / f"{name}.yaml"
        file.write_text(configuration.lstrip())
        self.commands[name] = [*enter, self.bin / program, "--config", file, *options]
        return self.spawn(name, self.commands[name])

    def end(self, name, how):
        """Ends a daemon with a signal. It may be started again()."""
        child = dict(self.children)[name]
        child.send_signal(how)
        child.wait(120)
        self.children.remove((name, child))

    def again(self, name):
        """Starts a daemon again that was killed, with the same command line; its log is continued."""
        return self.spawn(name, self.commands[name], "a")

    def topology(self, name, configuration, options=()):
        """A worker; `configuration` is its YAML with the registry written as {zookeeper} in zk.servers."""
        servers = self.zookeeper.removeprefix("zookeeper://")
        self.workers += 1
        return self.daemon("iotcloud-topology", name, configuration.replace("{zookeeper}", servers), options=options)

    def command(self, *words):
        """A command line of the CLI, which knows all masters."""
        masters = ",".join(f"127.0.0.1:{port}" for port in self.apis.values() or [self.api_port])
        return [str(self.bin / "iotcloud"), "--master", masters, *map(str, words)]

    def run_cli(self, *words, limit=120):
        """Runs the CLI and returns its result. Raises StartError when it does not end in time."""
        try:
            return subprocess.run(self.command(*words), capture_output=True, text=True, timeout=limit)
        except subprocess.TimeoutExpired as error:
            raise StartError(f"iotcloud {' '.join(map(str, words))}: no answer within {error.timeout} s") from error

    def cli(self, *words):
        """What the CLI printed. Raises StartError with the CLI's error message when it fails."""
        done = self.run_cli(*words)
        if done.returncode:
            raise StartError(f"iotcloud {' '.join(map(str, words))}: {done.stderr.strip() or done.stdout.strip()}")
        return done.stdout

    def json(self, *words):
        """What the CLI printed, as data. Raises StartError as cli()."""
        return json.loads(self.cli(*words, "-o", "json"))

    def answer(self, *words, limit=120):
        """What became of an order: the JSON that the CLI prints whether it was done or not."""
        done = self.run_cli(*words, "-o", "json", limit=limit)
        if not done.stdout:
            raise StartError(f"iotcloud {' '.join(map(str, words))}: {done.stderr.strip()}")
        return json.loads(done.stdout)

    def gateway_record(self, name):
        """What the master says of a gateway; empty when it does not list it."""
        return next((gateway for gateway in self.json("gateways") if gateway["gateway"] == name), {})

    def wait_for_next_life(self, name, former):
        """Waits until a gateway that has ended is registered again: until then the record and the place of a killed one
        count as ready, and an order that is given while they change hands finds it lost. `former`: its gateway_record() of
        before."""
        def is_there():
            now = self.gateway_record(name)
            return now.get("state") == "ready" and now["since_ms"] > former["since_ms"]

        wait_for(f"{name} is registered again", is_there)

    def processes(self, are_meant):
        """Ids of those processes of the cluster whose command line, a list of words (bytes), `are_meant` says yes to."""
        found = []
        for process in self.descendants():
            try:
                words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
            except OSError:
                continue  # it has ended since it was listed
            if are_meant(words):
                found.append(process)
        return found

    def hosts_of(self, gateway):
        """Process ids of a gateway's driver hosts."""
        return self.processes(lambda words: words[0].endswith(b"iotcloud-driver-host") and gateway.encode() in words)

    def deploy(self, plugin, gateway, properties):
        self.cli("deploy", plugin, "--gateway", gateway, *(f"--property={k}={v}" for k, v in properties.items()))

    def undeploy_all(self):
        for driver in self.json("drivers"):
            self.cli("undeploy", driver["instance"])

    def wait_until_ready(self, limit=120):
        """Waits until all gateways are ready and, if a topology worker was started, a topology has a worker."""
        deadline = time.monotonic() + limit
        problem = ""
        while time.monotonic() < deadline:
            self.require_alive()
            try:
                gateways, topologies = self.json("gateways"), self.json("topologies")
                ready = [gateway for gateway in gateways if gateway["state"] == "ready"]
                at_work = any(topology["workers"] for topology in topologies)
                if len(ready) == self.gateways and (at_work or not self.workers):
                    return
                problem = f"{len(ready)} of {self.gateways} gateways are ready, {len(topologies)} topologies are there"
            except StartError as error:
                problem = str(error)
            time.sleep(0.2)
        raise StartError(f"the cluster was not ready within {limit} s: {problem}; logs are in {self.out}")


def cpu_seconds(marker):
    """CPU seconds used so far by each living process with `marker` in its command line: {pid: (command, seconds)}."""
    ticks = os.sysconf("SC_CLK_TCK")
    used = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if marker not in command:
                continue
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue  # it ended meanwhile
        used[int(entry.name)] = (command, (int(fields[11]) + int(fields[12])) / ticks)
    return used
