#!/usr/bin/python3
"""A ROS node that publishes depth images, for tests: a fake, because it has what no library lets a test choose. Its node's
address is the same after each start, as happens to a real one once in a while, and its images come from another port.

    ros_camera.py --dir DIR --master URL

Publishes /camera/depth/image_raw (sensor_msgs/Image, 640x480, 16UC1, 20 a second). When it is registered with the master
it prints one line on stdout:

    READY URL OF THE NODE

Then it obeys one command for each line of stdin, as zookeeper.py does: kill, start, pause, resume, stop. The end of stdin
means `stop`. Its sources: the ROS wiki's pages "Slave API" and "TCPROS".
"""
import os
import socketserver
import struct
import sys
import threading
import time
import xmlrpc.client
import xmlrpc.server

import private_server

NAME = "/fake_camera"
TOPIC = "/camera/depth/image_raw"
TYPE = "sensor_msgs/Image"
TYPE_MD5 = "060021388200f6f0f447d0fcd9c64743"
WIDTH, HEIGHT, PIXEL_BYTES = 640, 480, 2
PERIOD_S = 0.05


class RosCamera(private_server.Server):
    name = "the camera"

    def __init__(self, given):
        super().__init__(given.dir)
        self.master = given.master
        self.port = private_server.free_ports(1)[0]

    def command(self):
        return [sys.executable, __file__, "--dir", self.folder, "--master", self.master, "--publish", str(self.port)]

    def url(self):
        return "http://127.0.0.1:%d/" % self.port

    def answers(self):
        try:
            return xmlrpc.client.ServerProxy(self.url()).getPid(NAME)[0] == 1
        except xmlrpc.client.Error:
            return False


def with_length(data):
    return struct.pack("<I", len(data)) + data


def connection_header():
    fields = {"callerid": NAME, "topic": TOPIC, "type": TYPE, "md5sum": TYPE_MD5, "latching": "0"}
    return with_length(b"".join(with_length(("%s=%s" % field).encode()) for field in fields.items()))


def image(number, stamp):
    header = struct.pack("<III", number, int(stamp), int(stamp % 1 * 1e9)) + with_length(b"camera")
    shape = struct.pack("<II", HEIGHT, WIDTH) + with_length(b"16UC1") + struct.pack("<BI", 0, WIDTH * PIXEL_BYTES)
    pixels = struct.pack("<H", 1000) * (WIDTH * HEIGHT)  # millimetres
    return with_length(header + shape + with_length(pixels))


class Subscription(socketserver.StreamRequestHandler):
    """One reader of the images."""

    def handle(self):
        self.rfile.read(struct.unpack("<I", self.rfile.read(4))[0])
        self.wfile.write(connection_header())
        number = 0
        try:
            while True:
                self.wfile.write(image(number, time.time()))
                number += 1
                time.sleep(PERIOD_S)
        except OSError:
            pass  # the reader has left


class Images(socketserver.ThreadingTCPServer):
    daemon_threads = True


def publish(master, port):
    """Publishes until the process is killed."""
    images = Images(("127.0.0.1", 0), Subscription)
    threading.Thread(target=images.serve_forever, daemon=True).start()
    node = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", port), logRequests=False, allow_none=True)
    address = ["TCPROS", "127.0.0.1", images.server_address[1]]
    node.register_function(lambda caller, topic, protocols: [1, "", address], "requestTopic")
    node.register_function(lambda caller: [1, "", os.getpid()], "getPid")
    registered = xmlrpc.client.ServerProxy(master).registerPublisher(NAME, TOPIC, TYPE, "http://127.0.0.1:%d/" % port)
    if registered[0] != 1:
        sys.exit("the ROS master does not take the camera: %s" % registered[1])
    node.serve_forever()


def main():
    parser = private_server.options("A ROS node that publishes depth images")
    parser.add_argument("--master", required=True, help="URL of the ROS master")
    parser.add_argument("--publish", type=int, metavar="PORT", help="be the node itself, at this port")
    given = parser.parse_args()
    if given.publish:
        publish(given.master, given.publish)
    private_server.run(lambda: RosCamera(given))


if __name__ == "__main__":
    main()
