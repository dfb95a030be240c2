"""A Nimbus that the test plays: it answers the calls of `iotcloud-storm` by Thrift (framed, binary) as a test says, and notes
them."""
import socketserver
import struct
import threading

CALL, REPLY, EXCEPTION = 0x80010001, 0x80010002, 0x80010003
STOP = b"\0"
BOOL, I32, STRING, STRUCT, LIST = 2, 8, 11, 12, 15
INTERNAL_ERROR = 6


def text(value):
    value = value.encode() if isinstance(value, str) else value
    return struct.pack(">I", len(value)) + value


def field(kind, number, value):
    return struct.pack(">BH", kind, number) + value


def i32(number, value):
    return field(I32, number, struct.pack(">i", value))


class Fails(Exception):
    """As a Nimbus answers whose code threw: that of one that does not lead says no more, either."""


class FalseNimbus:
    """Listens on a free port of loopback, until the end of the `with` block. `leads`: HOST:PORT that it names as the leader; its
    own address at first. `version`: of Storm. `topologies`: the names of those that run. `calls`: the names of all calls that it
    got. `uploaded`: how many bytes of jars it got. `failing`: a call's name, and what is done before it fails."""

    def __init__(self, version="2.8.3"):
        self.version, self.topologies, self.calls, self.uploaded, self.failing = version, [], [], 0, {}
        nimbus = self

        class Connection(socketserver.StreamRequestHandler):
            def handle(self):
                while len(head := self.rfile.read(4)) == 4:
                    answer = nimbus.answer(self.rfile.read(struct.unpack(">I", head)[0]))
                    self.wfile.write(struct.pack(">I", len(answer)) + answer)

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True

        self.server = Server(("127.0.0.1", 0), Connection)
        self.address = "127.0.0.1:%d" % self.server.server_address[1]
        self.leads = self.address
        self.thread = threading.Thread(target=self.server.serve_forever)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()

    def answer(self, call):
        size = struct.unpack_from(">I", call, 4)[0]
        name, number, arguments = call[8:8 + size], call[8 + size:12 + size], call[12 + size:]
        try:
            kind, body = REPLY, self.result_of(name.decode(), arguments) + STOP
        except Fails as error:
            kind, body = EXCEPTION, field(STRING, 1, text(str(error))) + i32(2, INTERNAL_ERROR) + STOP
        return struct.pack(">I", kind) + text(name) + number + body

    def result_of(self, name, arguments):
        self.calls.append(name)
        if name in self.failing:
            self.failing[name]()
            raise Fails("Internal error processing " + name)
        if name == "getLeader":
            host, port = self.leads.split(":")
            return field(STRUCT, 0, field(STRING, 1, text(host)) + i32(2, int(port)) + field(BOOL, 4, b"\1") +
                         field(STRING, 5, text(self.version)) + STOP)
        if name == "getTopologySummaries":
            rows = [field(STRING, 1, text(topology + "-1-1")) + field(STRING, 2, text(topology)) +
                    b"".join(i32(number, 1) for number in (3, 4, 5, 6)) + field(STRING, 7, text("ACTIVE")) + STOP
                    for topology in self.topologies]
            return field(LIST, 0, struct.pack(">BI", STRUCT, len(rows)) + b"".join(rows))
        if name == "beginFileUpload":
            return field(STRING, 0, text("/inbox/of-%s.jar" % self.address))
        if name == "uploadChunk":
            place = 3 + 4 + struct.unpack_from(">I", arguments, 3)[0]  # after the first argument, the location
            self.uploaded += struct.unpack_from(">I", arguments, place + 3)[0]
        if name == "submitTopologyWithOpts" and self.address.encode() not in arguments:
            raise Fails("the jar is not here")
        return b""
