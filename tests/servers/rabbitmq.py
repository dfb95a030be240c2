#!/usr/bin/python3
"""A private RabbitMQ for tests and demos, on loopback only, that leaves nothing behind.

    rabbitmq.py --dir DIR [--port N] [--tls] [--channel-max N] [--users FILE] [--revocation]

Runs one node with its data, logs and Erlang cookie below DIR, with its own port mapper (epmd), on free ports. When the
node takes connections it prints one line on stdout:

    READY amqp://guest:guest@127.0.0.1:PORT/

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the node                    KILLED
    start   starts it again, same port and data    READY amqp://...
    pause   SIGSTOP to the node: it hangs          PAUSED
    resume  SIGCONT                                RESUMED
    alarm   memory alarm: it takes no messages     ALARM
    clear   ends the alarm                         CLEAR
    forbid  the user `guest` may not write         FORBIDDEN   (a channel may go on until it is closed)
    banish  it may not use the virtual host, and
            all its connections are closed (530)   BANISHED
    permit  it may do everything again             PERMITTED
    cap     no queue takes more than 5 messages
            that nobody has read (reject-publish)  CAPPED
    uncap   ends that                              UNCAPPED
    reread  reads certificates again, and closes
            all connections                        REREAD
    clients the user, and holder and days of the
            certificate, of each connection        CLIENTS user CN=holder from - to; ...
    disk MB      from now on it finds itself on a disk of so many megabytes, which its data
            alone fill; below 50 MB it takes no messages   DISK
    forget USER  deletes a user                    FORGOTTEN
    renew FILE   gives the user `workers` the password of these definitions of users, as
            `./dev cluster passwords renew` does   RENEWED
    stop    ends everything                        STOPPED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept: durable queues come back.

With --tls the URL is amqps://localhost:PORT/: the server wants a client certificate, and user and password
(certificates.py; the files are in DIR). --channel-max limits the channels of a connection. --users: definitions of users,
who are then the only ones. --revocation: it refuses clients whose certificate is in a list of DIR/revoked (whose files
have the names that `openssl rehash` gives), or whose authority has none there.
"""
import glob
import os
import re
import shutil
import subprocess
import sys

import certificates
import private_server

PROGRAMS = "/usr/lib/rabbitmq/bin"  # those in /usr/sbin switch to another user, which cannot use private folders
CLUSTER = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", "deploy", "cluster"))
# In the place of `df`, which the node asks how much of its disk is free.
DISK = """#!/bin/sh
used=$(du -sk '{data}' 2>/dev/null | cut -f1)
echo Filesystem 1024-blocks Used Available Capacity Mounted on
echo disk {size} "$used" $(( {size} > used ? {size} - used : 0 )) 0% /
"""
PATIENCE_S = 300  # for an answer of rabbitmqctl, whose own virtual machine starts first


def make_small_home(folder):
    """Makes `folder` a RabbitMQ without the plugins that nobody has enabled: links to its own applications, and copies of its
    scripts, which look for applications beside themselves. Erlang looks for each of a thousand modules in one application
    after the other: with all plugins a node takes twice as long to start."""
    home = os.path.dirname(os.path.dirname(os.path.realpath(PROGRAMS + "/rabbitmq-server")))
    found = {os.path.basename(file)[:-len(".app")]: file for file in glob.glob(home + "/plugins/*/ebin/*.app")}
    needed, left = set(), ["rabbit", "rabbitmq_prelaunch"]
    while left:
        application = left.pop()
        if application in needed or application not in found:  # those not found are Erlang's own
            continue
        needed.add(application)
        with open(found[application], encoding="utf-8") as text:
            listed = re.search(r"{applications,\s*\[([^]]*)]", text.read())
        left += re.findall(r"\w+", listed[1]) if listed else []
    os.makedirs(folder + "/plugins", exist_ok=True)
    for application in needed:
        place = os.path.dirname(os.path.dirname(found[application]))
        link = os.path.join(folder, "plugins", os.path.basename(place))
        if not os.path.lexists(link):
            os.symlink(place, link)
    shutil.copytree(home + "/sbin", folder + "/sbin", dirs_exist_ok=True)


class PortMapper(private_server.Server):
    """epmd, the process from which Erlang's nodes get each other's ports."""

    name = "the port mapper"

    def __init__(self, folder):
        super().__init__(folder)
        self.port = private_server.free_ports(1)[0]

    def command(self):
        return ["epmd", "-address", "127.0.0.1", "-port", str(self.port)]

    def log(self):
        return self.path("epmd.log")

    def url(self):
        return "epmd://127.0.0.1:%d" % self.port

    def answers(self):
        with self.connect(self.port):
            return True


class RabbitMq(private_server.Server):
    """One node. The nodes of a cluster share a port mapper and `home`, the folder with the Erlang cookie; `peers` has
    the names of all of them."""

    name = "RabbitMQ"
    grace_s = 10

    def __init__(self, folder, port=0, tls=False, mapper=None, home=None, channel_max=None,
                 users="", revocation=False):
        super().__init__(folder)
        free_port, self.distribution_port = private_server.free_ports(2)
        self.port = port or free_port
        self.node_name = "iotcloud%d@localhost" % self.port
        self.mapper = mapper or PortMapper(folder)
        self.home = home or self.folder
        self.peers = []
        self.channel_max = channel_max
        self.users, self.revocation = users, revocation
        if tls:
            self.certificates = certificates.Certificates(self.folder)
        self.write("enabled_plugins", ["[]."])

    def configure(self):
        listeners = self.security() if self.certificates else ["listeners.tcp.1 = 127.0.0.1:%d" % self.port]
        cluster = ["cluster_formation.classic_config.nodes.%d = %s" % pair for pair in enumerate(self.peers, 1)]
        if cluster:
            cluster += ["cluster_formation.peer_discovery_backend = classic_config",
                        # A node that hung is removed from the cluster, and joins it again by itself.
                        "cluster_partition_handling = pause_minority"]
        channels = ["channel_max = %d" % self.channel_max] if self.channel_max else []
        channels += ["load_definitions = " + self.users] if self.users else []
        self.write("rabbitmq.conf", [
            "num_acceptors.tcp = 2", "num_acceptors.ssl = 2", "log.file.level = info",
            # A test's disk may be nearly full; an alarm would block every publisher.
            "disk_free_limit.absolute = 50MB", *listeners, *cluster, *channels])

    def security(self):
        path = self.certificates.path
        if self.revocation:  # these options are in the place of those in the other file
            self.write("advanced.config", [
                '[{rabbit, [{ssl_options, [{cacertfile, "%s"}, {certfile, "%s"}, {keyfile, "%s"}, {verify, verify_peer},'
                % (path("ca.pem"), path("server.pem"), path("server.key")),
                '{fail_if_no_peer_cert, true}, {crl_check, peer},',
                '{crl_cache, {ssl_crl_hash_dir, {internal, [{dir, "%s"}]}}}]}]}].' % path("revoked")])
        users = [] if self.users else [
            "default_user = " + certificates.USER, "default_pass = " + certificates.PASSWORD]
        return ["listeners.tcp = none", "listeners.ssl.1 = 127.0.0.1:%d" % self.port,
                "ssl_options.cacertfile = " + path("ca.pem"), "ssl_options.certfile = " + path("server.pem"),
                "ssl_options.keyfile = " + path("server.key"), "ssl_options.verify = verify_peer",
                "ssl_options.fail_if_no_peer_cert = true", *users]

    def environment(self):
        env = {key: value for key, value in os.environ.items()
               if not key.startswith(("RABBITMQ_", "ERL_", "ELIXIR_")) and key != "NOTIFY_SOCKET"}
        env.update({
            "HOME": self.home,  # the Erlang cookie
            "PATH": self.path("bin") + os.pathsep + env["PATH"],  # disk()
            "LC_ALL": "C.UTF-8",
            "ERL_EPMD_ADDRESS": "127.0.0.1",
            "ERL_EPMD_PORT": str(self.mapper.port),
            "ERL_CRASH_DUMP": self.path("erl_crash.dump"),
            "RABBITMQ_ALLOW_INPUT": "1",  # the script becomes the node: no shell between it and its process id
            "RABBITMQ_NODENAME": self.node_name,
            "RABBITMQ_DIST_PORT": str(self.distribution_port),
            "RABBITMQ_MNESIA_BASE": self.path("data"),
            "RABBITMQ_LOG_BASE": self.path("log"),
            "RABBITMQ_LOGS": self.path("log", "rabbit.log"),
            "RABBITMQ_PID_FILE": self.path("rabbit.pid"),
            "RABBITMQ_GENERATED_CONFIG_DIR": self.path("generated"),
            "RABBITMQ_CONFIG_FILE": self.path("rabbitmq.conf"),
            "RABBITMQ_CONF_ENV_FILE": "/dev/null",
            "RABBITMQ_ADVANCED_CONFIG_FILE": self.path("advanced.config"),
            "RABBITMQ_ENABLED_PLUGINS_FILE": self.path("enabled_plugins"),
            "RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS":
                "-noinput +S 2:2 +A 8 -start_epmd false -kernel inet_dist_use_interface {127,0,0,1} net_ticktime 8",
        })
        return env

    def command(self):
        return [self.path("program", "sbin", "rabbitmq-server")]

    def log(self):
        return self.path("log", "console.log")

    def url(self):
        return ("amqps://localhost:%d/" if self.certificates else "amqp://guest:guest@127.0.0.1:%d/") % self.port

    def launch(self):
        os.makedirs(self.path("log"), exist_ok=True)
        make_small_home(self.path("program"))
        self.configure()
        if not self.mapper.runs():
            self.mapper.start()
        super().launch()

    def answers(self):
        """The node opens its port last, and greets when it is ready."""
        with self.connect(self.port) as probe:
            probe.sendall(b"AMQP\x00\x00\x09\x01")
            return probe.recv(1) == b"\x01"  # a method frame: connection.start

    def control(self, *arguments):
        """Has rabbitmqctl do this, and returns what it printed."""
        # Erlang takes a node for one that is down when it does not greet within 7 s; one of a busy machine needs longer.
        env = self.environment() | {"ERL_FLAGS": "-kernel net_setuptime 120"}
        return subprocess.run([PROGRAMS + "/rabbitmqctl", "-n", self.node_name, "-q", *arguments], env=env,
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, check=True, timeout=PATIENCE_S,
                              preexec_fn=private_server.become_child).stdout

    def alarm(self):
        self.control("set_vm_memory_high_watermark", "0")
        return "ALARM"

    def clear(self):
        self.control("set_vm_memory_high_watermark", "0.4")
        return "CLEAR"

    def forbid(self):
        self.control("set_permissions", "guest", ".*", "", ".*")
        return "FORBIDDEN"

    def banish(self):
        self.control("clear_permissions", "guest")
        self.control("close_all_connections", "a test wants it")
        return "BANISHED"

    def cap(self):
        self.control("set_policy", "--apply-to", "queues", "cap", ".*", '{"max-length": 5, "overflow": "reject-publish"}')
        return "CAPPED"

    def uncap(self):
        self.control("clear_policy", "cap")
        return "UNCAPPED"

    def permit(self):
        self.control("set_permissions", "guest", ".*", ".*", ".*")
        return "PERMITTED"

    def reread(self):
        self.control("eval", "ssl:clear_pem_cache().")
        self.control("close_all_connections", "a test wants it")
        return "REREAD"

    def disk(self, megabytes):
        os.makedirs(self.path("bin"), exist_ok=True)
        self.write(os.path.join("bin", "df"), [DISK.format(data=self.path("data"), size=int(megabytes) * 1024)])
        os.chmod(self.path("bin", "df"), 0o755)
        self.control("eval", "rabbit_disk_monitor:set_max_check_interval(200), rabbit_disk_monitor ! update.")
        return "DISK"

    def forget(self, user):
        self.control("delete_user", user)
        return "FORGOTTEN"

    def renew(self, file):
        sys.path.insert(0, CLUSTER)
        import revocation  # pylint: disable=import-outside-toplevel
        for _, *words in revocation.commands_for_passwords():
            self.control(*(file if word == "/run/secrets/users.json" else word for word in words))
        return "RENEWED"

    def clients(self):
        return "CLIENTS " + "; ".join(
            self.control("list_connections", "user", "peer_cert_subject", "peer_cert_validity").splitlines()[1:])  # after the headers

    def queues(self):
        """How many durable queues there are."""
        return f"QUEUES {self.control('list_queues', 'durable').split().count('true')}"

    def stop(self):
        answer = super().stop()
        self.mapper.stop()
        return answer

    def commands(self):
        return {**super().commands(), "alarm": self.alarm, "clear": self.clear, "forbid": self.forbid,
                "permit": self.permit, "banish": self.banish, "cap": self.cap, "uncap": self.uncap, "queues": self.queues, "reread": self.reread,
                "clients": self.clients, "disk": self.disk, "forget": self.forget, "renew": self.renew}


def main():
    parser = private_server.options("A private RabbitMQ")
    private_server.add_client_options(parser)
    parser.add_argument("--channel-max", type=int, help="channels of a connection; default: the server's")
    parser.add_argument("--users", default="", help="a file with definitions of users")
    parser.add_argument("--revocation", action="store_true", help="ask the lists in DIR/revoked")
    given = parser.parse_args()
    private_server.run(lambda: RabbitMq(given.dir, given.port, given.tls, channel_max=given.channel_max, users=given.users,
                                        revocation=given.revocation))


if __name__ == "__main__":
    main()
