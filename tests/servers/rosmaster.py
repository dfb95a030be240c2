#!/usr/bin/python3
"""A private ROS master for tests, on loopback only, that leaves nothing behind.

    rosmaster.py --dir DIR [--port N]

Runs Debian's `rosmaster --core` with its log below DIR, on a free port, and no rosout (which would listen on all
addresses). When it answers it prints one line on stdout:

    READY http://127.0.0.1:PORT

Then it obeys one command for each line of stdin, as zookeeper.py does: kill, start (the same port; it has forgotten all
nodes), pause, resume, stop; and

    shutdown NAME   what `rosnode kill` does, to all nodes whose names begin so    DONE

The end of stdin means `stop`. Without ROS on this machine it says SKIP.
"""
import os
import shutil
import xmlrpc.client

import private_server


class RosMaster(private_server.Server):
    name = "the ROS master"  # it has no data

    def __init__(self, folder, port=0):
        super().__init__(folder)
        if not shutil.which("rosmaster"):
            raise private_server.Unavailable("there is no rosmaster here; install Debian's package python3-rosmaster")
        self.port = port or private_server.free_ports(1)[0]

    def command(self):
        return ["rosmaster", "--core", "-p", str(self.port)]

    def environment(self):
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS_")}
        return {**kept, "ROS_IP": "127.0.0.1", "ROS_HOME": self.folder, "ROS_MASTER_URI": self.url()}

    def url(self):
        return "http://127.0.0.1:%d" % self.port

    def answers(self):
        try:
            return xmlrpc.client.ServerProxy(self.url()).getPid("/private_server")[0] == 1
        except xmlrpc.client.Error:
            return False

    def shutdown(self, name):
        master = xmlrpc.client.ServerProxy(self.url())
        topics = [topic for part in master.getSystemState("/private_server")[2] for topic in part]
        for node in {node for _, nodes in topics for node in nodes if node.startswith(name)}:
            xmlrpc.client.ServerProxy(master.lookupNode("/private_server", node)[2]).shutdown("/private_server", "a test")
        return "DONE"

    def commands(self):
        return {**super().commands(), "shutdown": self.shutdown}


def main():
    parser = private_server.options("A private ROS master")
    parser.add_argument("--port", type=int, default=0, help="default: a free one")
    given = parser.parse_args()
    private_server.run(lambda: RosMaster(given.dir, given.port))


if __name__ == "__main__":
    main()
