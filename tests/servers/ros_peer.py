#!/usr/bin/python3
"""A ROS node that publishes topics of several types and says what it hears, for tests.

    ros_peer.py --dir DIR --program FILE --master URL

Runs the program ros_peer (tests/drivers/ros/peer_main.cc, which lists its topics) with its log below DIR. When it is
registered with the master it prints one line on stdout:

    READY /ros_peer

Then it obeys one command for each line of stdin, as zookeeper.py does: kill, start, pause, resume, stop. The end of stdin
means `stop`.
"""
import os
import xmlrpc.client

import private_server


class RosPeer(private_server.Server):
    name = "the peer"

    def __init__(self, given):
        super().__init__(given.dir)
        self.given = given

    def command(self):
        return [self.given.program]

    def environment(self):
        return {**os.environ, "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": self.given.master, "ROS_HOME": self.folder}

    def url(self):
        return "/ros_peer"

    def answers(self):
        """Its last topic is there, and it is that of the process that runs now."""
        try:
            master = xmlrpc.client.ServerProxy(self.given.master)
            published = {topic for topic, nodes in master.getSystemState("/private_server")[2][0] if self.url() in nodes}
            node = master.lookupNode("/private_server", self.url())[2]
            return "/last" in published and xmlrpc.client.ServerProxy(node).getPid("/private_server")[2] == self.process.pid
        except xmlrpc.client.Error:
            return False


def main():
    parser = private_server.options("A ROS node that publishes and listens")
    parser.add_argument("--program", required=True, help="the program ros_peer")
    parser.add_argument("--master", required=True, help="URL of the ROS master")
    given = parser.parse_args()
    private_server.run(lambda: RosPeer(given))


if __name__ == "__main__":
    main()
