"""Captures the packets to and from one port on the loopback interface, with the kernel's time stamps. The processes
that are measured do not take part in it."""

import ctypes
import socket
import struct
import threading
import time

_HEAD = 2048  # bytes of each packet that are kept
_EVERY_S = 0.25  # pause between two reads of what the kernel has captured
_BUFFER = 64 << 20
_SO_ATTACH_FILTER, _SO_TIMESTAMPNS, _SO_RCVBUFFORCE = 26, 35, 33
_OUTGOING = 4  # a packet on loopback is seen twice, when it leaves and when it arrives


class Packet:
    """A packet. `at_ns`: when, by the monotonic clock; `to_broker`: its direction; `peer`: the port of the other end;
    `size`: bytes of its payload; `head`: the payload's first bytes."""

    def __init__(self, at_ns, to_broker, peer, size, head):
        self.at_ns, self.to_broker, self.peer, self.size, self.head = at_ns, to_broker, peer, size, head


def filter_of(port):
    """A filter for the kernel: takes TCP over IPv4 from or to this port, each packet once, and only its first bytes."""
    load_half, load_byte, load_word, equal, done = 0x28, 0x30, 0x20, 0x15, 0x06
    packet_type = 0xFFFFF000 + 4
    rules = [(load_word, 0, 0, packet_type), (equal, 8, 0, _OUTGOING), (load_half, 0, 0, 12), (equal, 0, 6, 0x0800),
             (load_byte, 0, 0, 23), (equal, 0, 4, socket.IPPROTO_TCP), (load_half, 0, 0, 34), (equal, 3, 0, port),
             (load_half, 0, 0, 36), (equal, 1, 0, port), (done, 0, 0, 0), (done, 0, 0, _HEAD)]
    return b"".join(struct.pack("HBBI", *rule) for rule in rules)


def parse(frame, port):
    """Returns (to_broker, peer, size, head) of an Ethernet frame; None when it has no payload."""
    network = frame[14:]
    header = (network[0] & 15) * 4
    whole = struct.unpack_from("!H", network, 2)[0]
    source, destination = struct.unpack_from("!HH", network, header)
    begin = header + (network[header + 12] >> 4) * 4
    if whole <= begin:
        return None
    to_broker = destination == port
    return to_broker, source if to_broker else destination, whole - begin, network[begin:]


class Tap:
    """Captures packets; a context manager. Raises PermissionError without CAP_NET_RAW."""

    def __init__(self, port):
        self.port, self.packets, self.lost = port, [], 0
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)  # receives nothing before it is bound
        rules = filter_of(port)
        self._rules = ctypes.create_string_buffer(rules)
        program = struct.pack("HL", len(rules) // 8, ctypes.addressof(self._rules))
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.socket.setblocking(False)
        self.socket.bind(("lo", 0x0003))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self._take()
        # The kernel's counts: (all packets, packets that it had no room for).
        self.lost = struct.unpack("II", self.socket.getsockopt(263, 6, 8))[1]
        self.socket.close()

    def _listen(self):
        while not self._ended.wait(_EVERY_S):
            self._take()

    def _take(self):
        # The kernel's time stamps are of the wall clock.
        to_monotonic = time.clock_gettime_ns(time.CLOCK_MONOTONIC) - time.clock_gettime_ns(time.CLOCK_REALTIME)
        while True:
            try:
                frame, about, _, _ = self.socket.recvmsg(_HEAD, 64)
            except BlockingIOError:
                return
            parsed = parse(frame, self.port)
            if parsed is None or not about:
                continue
            seconds, nanoseconds = struct.unpack("qq", about[0][2][:16])
            self.packets.append(Packet(seconds * 1_000_000_000 + nanoseconds + to_monotonic, *parsed))
