#!/usr/bin/python3
"""Writes the recordings in files/ with PyPI's mcap (`pip install mcap`), which has nothing of ours. mcap_peer_test.py makes such an
installation; the files in the tree were written by version 1.6.0.

usage: write_files.py FOLDER
"""

import sys
from pathlib import Path

from mcap.writer import CompressionType, Writer

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
MESSAGES = 30


def write(path, **how):
    with open(path, "wb") as out:
        writer = Writer(out, chunk_size=256, **how)
        writer.start(profile="test", library="peer")
        schema = writer.register_schema("Reading", "jsonschema", b'{"type": "object"}')
        meters = [writer.register_channel(f"/meter/{i}", "json", schema, {"place": f"room {i}"}) for i in (1, 2)]
        raw = writer.register_channel("/raw", "", 0)
        for i in range(MESSAGES):
            # Every third message comes late: chunks overlap, and their messages are not in order.
            time = 1_700_000_000_000_000_000 + i * 1_000_000 - (5_000_000 if i % 3 == 2 else 0)
            channel = raw if i % 5 == 4 else meters[i % 2]
            data = bytes(range(i)) if channel == raw else f'{{"value": {i}}}'.encode()
            writer.add_message(channel, time, data, time - 1000, i)
        writer.add_attachment(7, 7, "notes.txt", "text/plain", b"an attachment")
        writer.add_metadata("site", {"city": "Bloomington"})
        writer.finish()


def main():
    folder = Path(sys.argv[1])
    for name, compression in COMPRESSIONS.items():
        write(folder / f"{name}.mcap", compression=compression)
    write(folder / "loose.mcap", use_chunking=False)


if __name__ == "__main__":
    main()
