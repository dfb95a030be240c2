"""A Nimbus that the test plays: it says of topologies what the test wants, and notes what it was told. It speaks Thrift's binary
protocol in frames, as far as topology/storm/nimbus/storm.thrift uses it."""
import socketserver
import struct
import threading

BOOL, DOUBLE, I32, I64, STRING, STRUCT, MAP, SET, LIST = 2, 4, 8, 10, 11, 12, 13, 14, 15
REPLY, EXCEPTION, INTERNAL_ERROR = 0x80010002, 0x80010003, 6
FORMATS = {BOOL: ">?", 3: ">b", DOUBLE: ">d", 6: ">h", I32: ">i", I64: ">q"}


def packed(kind, value):
    """The bytes of a value. A struct is {id: (kind, value)}; a list (kind, values); a map (kind, kind, {key: value})."""
    if kind in FORMATS:
        return struct.pack(FORMATS[kind], value)
    if kind == STRING:
        text = value.encode()
        return struct.pack(">i", len(text)) + text
    if kind == STRUCT:
        return b"".join(struct.pack(">bh", of, number) + packed(of, field)
                        for number, (of, field) in value.items()) + b"\0"
    if kind == LIST:
        of, values = value
        return struct.pack(">bi", of, len(values)) + b"".join(packed(of, each) for each in values)
    of_key, of_value, pairs = value
    return struct.pack(">bbi", of_key, of_value, len(pairs)) + b"".join(
        packed(of_key, key) + packed(of_value, each) for key, each in pairs.items())


class Reader:
    """Reads values of any kinds: a struct as {id: value}."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        self.at += count
        return self.data[self.at - count:self.at]

    def unpack(self, form):
        return struct.unpack(form, self.take(struct.calcsize(form)))

    def text(self):
        return self.take(self.unpack(">i")[0])

    def value(self, kind):
        if kind in FORMATS:
            return self.unpack(FORMATS[kind])[0]
        if kind == STRING:
            return self.text()
        if kind == STRUCT:
            fields = {}
            while (of := self.unpack(">b")[0]) != 0:
                number = self.unpack(">h")[0]
                fields[number] = self.value(of)
            return fields
        if kind == MAP:
            of_key, of_value, count = self.unpack(">bbi")
            return [(self.value(of_key), self.value(of_value)) for _ in range(count)]
        of, count = self.unpack(">bi")
        return [self.value(of) for _ in range(count)]


def error_info(text, at_s, host, port):
    return {1: (STRING, text), 2: (I32, at_s), 3: (STRING, host), 4: (I32, port)}


class Fails(Exception):
    """As a Nimbus answers whose code threw: that of one that does not lead says no more, either."""


class FakeNimbus:
    """Listens on a free port of loopback from its construction until stop(), or the end of the `with` block.
    Topologies, each a dict: name, status, workers; executors, of (component, first task, last task, host, port, uptime in
    seconds, whether it has told of itself); errors, of (component, text, seconds since 1970, host, port); spouts and bolts: what
    each did, by name. `leads`: HOST:PORT that it names as the leader, its own address at first. `version`: of Storm. `calls`: the
    names of all calls that it got. `told`: (method, arguments) of the orders. `uploaded`: how many bytes of jars it got.
    `failing`: a call's name, and what is done before it fails."""

    def __init__(self, *topologies, version="2.8.3"):
        self.topologies = {topology["name"]: topology for topology in topologies}
        self.version, self.calls, self.told, self.uploaded, self.failing = version, [], [], 0, {}
        nimbus = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self):
                while head := self.request.recv(4, 0x100):  # MSG_WAITALL
                    call = Reader(self.request.recv(struct.unpack(">i", head)[0], 0x100))
                    call.unpack(">I")
                    method, (number,) = call.text(), call.unpack(">i")
                    arguments = call.value(STRUCT)
                    answer = nimbus.reply(method, number, arguments)
                    self.request.sendall(struct.pack(">i", len(answer)) + answer)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = daemon_threads = True

        self.server = Server(("127.0.0.1", 0), Handler)
        self.address = self.leads = "127.0.0.1:%d" % self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        self.server.shutdown()
        self.server.server_close()

    def reply(self, method, number, arguments):
        """The message that answers a call."""
        try:
            kind, fields = REPLY, self.answer(method.decode(), arguments)
        except Fails as error:
            kind, fields = EXCEPTION, {1: (STRING, str(error)), 2: (I32, INTERNAL_ERROR)}
        return struct.pack(">Ii", kind, len(method)) + method + struct.pack(">i", number) + packed(STRUCT, fields)

    def answer(self, method, arguments):
        """The fields of a call's result."""
        self.calls.append(method)
        if method in self.failing:
            self.failing[method]()
            raise Fails("Internal error processing " + method)
        if asked := getattr(self, "_" + method, None):
            return asked(arguments)
        self.told.append((method, arguments))
        name = arguments.get(1, b"").decode()
        if method == "submitTopologyWithOpts":
            if arguments[2].decode() != self.jar():
                raise Fails("the jar is not here")
            self.submitted(name)
        elif method == "uploadChunk":
            self.uploaded += len(arguments[2])
        elif method == "killTopologyWithOpts":
            self.topologies.pop(name)
        elif method in ("activate", "deactivate") and name in self.topologies:
            self.topologies[name]["status"] = "ACTIVE" if method == "activate" else "INACTIVE"
        return {0: (STRING, self.jar())} if method == "beginFileUpload" else {}

    def jar(self):
        """Where what is sent lies."""
        return "/inbox/of-%s.jar" % self.address

    def submitted(self, name):
        """A topology runs as soon as it is submitted; a test may say otherwise."""
        self.topologies[name] = topology(name)

    def _getLeader(self, _):
        host, port = self.leads.split(":")
        return {0: (STRUCT, {1: (STRING, host), 2: (I32, int(port)), 4: (BOOL, True), 5: (STRING, self.version)})}

    def _getTopologySummaries(self, _):
        return {0: (LIST, (STRUCT, [
            {1: (STRING, each["name"] + "-1"), 2: (STRING, each["name"]), 3: (I32, 4), 4: (I32, 4), 5: (I32, each["workers"]),
             6: (I32, 60), 7: (STRING, each["status"])} for each in self.topologies.values()]))}

    def _getTopologyInfoByName(self, arguments):
        of = self.topologies[arguments[1].decode()]
        executors = [{1: (STRUCT, {1: (I32, first), 2: (I32, last)}), 2: (STRING, component), 3: (STRING, host), 4: (I32, port),
                      5: (I32, uptime), **({7: (STRUCT, {4: (DOUBLE, 1.0)})} if reported else {})}
                     for component, first, last, host, port, uptime, reported in of["executors"]]
        errors = {}
        for component, *error in of["errors"]:
            errors.setdefault(component, []).append(error_info(*error))
        return {0: (STRUCT, {
            1: (STRING, of["name"] + "-1"), 2: (STRING, of["name"]), 3: (I32, 60), 4: (LIST, (STRUCT, executors)),
            5: (STRING, of["status"]),
            6: (MAP, (STRING, LIST, {component: (STRUCT, each) for component, each in errors.items()}))})}

    def _getTopologyPageInfo(self, arguments):
        of = self.topologies[arguments[1].decode().removesuffix("-1")]

        def stats(did, own):
            last = next((error for component, *error in of["errors"] if component == did["component"]), None)
            return {2: (STRUCT, {1: (I32, 2), 2: (I32, 2), 3: (I64, did["emitted"]), 4: (I64, did["emitted"]),
                                 5: (I64, did["acked"]), 6: (I64, did["failed"])}),
                    3: (STRUCT, own), **({4: (STRUCT, error_info(*last))} if last else {})}
        spouts = {did["component"]: stats(did, {2: (STRUCT, {1: (DOUBLE, 2.5)})}) for did in of["spouts"]}
        bolts = {did["component"]: stats(did, {1: (STRUCT, {1: (DOUBLE, 0.5), 2: (DOUBLE, 0.75), 3: (I64, did["executed"]),
                                                            4: (DOUBLE, 0.25)})}) for did in of["bolts"]}
        return {0: (STRUCT, {1: (STRING, of["name"] + "-1"), 9: (MAP, (STRING, STRUCT, spouts)),
                             10: (MAP, (STRING, STRUCT, bolts))})}


def topology(name, **other):
    """A topology that runs on two workers."""
    return {"name": name, "status": "ACTIVE", "workers": 2, "errors": [],
            "executors": [("in", 1, 2, "lab1", 6700, 60, True), ("count", 3, 4, "lab2", 6701, 50, True)],
            "spouts": [{"component": "in", "emitted": 10, "acked": 9, "failed": 1}],
            "bolts": [{"component": "count", "emitted": 5, "executed": 10, "acked": 10, "failed": 0}], **other}
