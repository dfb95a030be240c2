#!/usr/bin/python3
"""A TCP proxy on loopback whose links can be made bad, for faults in networks that have none.

    proxy.py

It obeys one command for each line of stdin, and answers each with one line on stdout:

    link NAME HOST:PORT [PORT]   makes a link to that address; it listens on PORT, or on a free one     PORT
    pass NAME           the link is as good as loopback again         PASSES
    cut NAME            nothing passes, and nobody is told; what was sent passes afterwards, in order   CUT
    reset NAME          each connection is reset; new ones are made as before    RESET
    refuse NAME         each connection is reset, and new ones are refused       REFUSES
    half_open NAME      the server's end of each connection is closed, and the client is not told, also not after `pass`;
                        new connections reach nobody                             HALF_OPEN
    slow NAME           20 kB/s each way, 200 ms later                           SLOW
    one_way_up NAME     what the server sends waits                              ONE_WAY_UP
    one_way_down NAME   what the client sends waits                              ONE_WAY_DOWN

The end of stdin ends it. A command that fails answers `ERROR text`.
"""

import asyncio
import contextlib
import os
import socket
import struct
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "servers"))

import private_server  # noqa: E402

MODES = ("pass", "cut", "reset", "refuse", "half_open", "slow", "one_way_up", "one_way_down")
SLOW_BYTES_S, SLOW_LATER_S = 20_000, 0.2
CHUNK = 64 * 1024


class Connection:
    """One client's connection and its counterpart to the server."""

    def __init__(self, link, client):
        self.link, self.client, self.server = link, client, None  # (reader, writer)
        self.dead = False  # half open: the client is not told that the server's end is closed

    async def run(self):
        try:
            await self.link.allowed("up")
            if self.dead:
                await self.swallow()
                return
            self.server = await asyncio.open_connection(*self.link.target)
            no_delay(self.server[1])
            ways = [asyncio.create_task(self.carry("up", self.client[0], self.server[1])),
                    asyncio.create_task(self.carry("down", self.server[0], self.client[1]))]
            try:
                await asyncio.gather(*ways)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.wait(ways)
        except OSError:
            pass
        finally:
            if self.dead:
                with contextlib.suppress(OSError):
                    await self.swallow()
            self.close()
            self.link.connections.discard(self)

    async def carry(self, way, reader, writer):
        while True:
            data = await reader.read(CHUNK if self.link.mode != "slow" else SLOW_BYTES_S // 20)
            await self.link.allowed(way)
            if self.dead:
                raise ConnectionResetError
            if self.link.mode == "slow":
                await asyncio.sleep(SLOW_LATER_S if len(data) < 200 else max(0.05, len(data) / SLOW_BYTES_S))
                await self.link.allowed(way)
                if self.dead:
                    raise ConnectionResetError
            if not data:
                if writer.can_write_eof():
                    writer.write_eof()
                return
            writer.write(data)
            await writer.drain()

    async def swallow(self):
        """Reads on for a client that believes in its connection, until it gives it up."""
        while await self.client[0].read(CHUNK):
            pass

    def half_open(self):
        self.dead = True
        if self.server:
            abort(self.server[1])

    def reset(self):
        abort(self.client[1])
        if self.server:
            abort(self.server[1])

    def close(self):
        for end in (self.client, self.server):
            if end:
                end[1].close()


class Link:
    def __init__(self, target, port):
        self.target, self.port = target, port
        self.mode = "pass"
        self.changed = asyncio.Event()
        self.connections, self.listener = set(), None

    async def listen(self):
        self.listener = await asyncio.start_server(self.accept, "127.0.0.1", self.port)

    async def accept(self, reader, writer):
        no_delay(writer)
        connection = Connection(self, (reader, writer))
        connection.dead = self.mode == "half_open"
        self.connections.add(connection)
        await connection.run()

    async def allowed(self, way):
        """Waits until what goes this way may pass."""
        while self.mode == "cut" or (self.mode == "one_way_up" and way == "down") or \
                (self.mode == "one_way_down" and way == "up"):
            await self.changed.wait()

    async def become(self, mode):
        if mode in ("reset", "refuse"):
            for connection in list(self.connections):
                connection.reset()
        if mode == "half_open":
            for connection in self.connections:
                connection.half_open()
        if mode == "refuse" and self.listener:
            self.listener.close()
            self.listener = None
        if mode != "refuse" and not self.listener:
            await self.listen()
        self.mode = "pass" if mode == "reset" else mode
        self.changed.set()
        self.changed = asyncio.Event()


def no_delay(writer):
    writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def abort(writer):
    """Closes with a reset."""
    with contextlib.suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


async def obey(links, words):
    if words[0] == "link" and len(words) in (3, 4):
        host, port = words[2].rsplit(":", 1)
        link = Link((host, int(port)), int(words[3]) if len(words) == 4 else private_server.free_ports(1)[0])
        await link.listen()
        links[words[1]] = link
        return str(link.port)
    if words[0] in MODES and len(words) == 2 and words[1] in links:
        await links[words[1]].become(words[0])
        return {"pass": "PASSES", "refuse": "REFUSES"}.get(words[0], words[0].upper())
    raise RuntimeError(f"no such command: {' '.join(words)}")


async def main():
    loop, links = asyncio.get_running_loop(), {}
    commands = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    while line := await commands.readline():
        try:
            private_server.say(await obey(links, line.decode().split() or [""]))
        except (OSError, RuntimeError, ValueError) as error:
            private_server.say(f"ERROR {error}")
    os._exit(0)  # its connections end with it


if __name__ == "__main__":
    private_server.die_with_parent()
    asyncio.run(main())
