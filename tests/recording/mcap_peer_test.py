#!/usr/bin/python3
"""Recordings are exchanged with PyPI's mcap in both directions: it reads what our writer wrote, whole, with all checksums, and our
reader reads what it writes now.

usage: mcap_peer_test.py BUILD_DIR   (exit status 77: PyPI cannot be reached)
"""

import json
import subprocess
import sys
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
SKIPPED = 77
READ = """
import json, sys
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    messages = [[channel.topic, message.sequence, message.log_time, message.publish_time, message.data.hex()]
                for _, channel, message in reader.iter_messages()]
with open(sys.argv[1], "rb") as file:
    streamed = sum(type(record).__name__ == "Message" for record in StreamReader(file, validate_crcs=True).records)
print(json.dumps({"messages": messages, "streamed": streamed, "statistics": summary.statistics.message_count,
                  "chunks": len(summary.chunk_indexes), "channels": len(summary.channels)}))
"""


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"wrong: {' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def by_time(message):
    return message[2], message[1]


def peer(folder):
    """The Python that has PyPI's mcap."""
    python = folder / "bin/python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    done = subprocess.run([python, "-m", "pip", "install", "--quiet", "mcap==1.6.0"], capture_output=True, text=True)
    if done.returncode:
        print(f"PyPI's mcap cannot be had here:\n{done.stderr}")
        sys.exit(SKIPPED)
    return python


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "mcap_peer"
    work.mkdir(exist_ok=True)
    python = peer(work / "python")
    for compression in ("none", "lz4", "zstd"):
        file = work / f"ours-{compression}.mcap"
        file.unlink(missing_ok=True)
        written = json.loads(run(build / "bin/recording_files", "write", compression, file))
        read = json.loads(run(python, "-c", READ, file))
        if read["messages"] != written["messages"]:
            sys.exit(f"wrong: {file}: the peer reads {len(read['messages'])} messages, not those that were written")
        for key in ("streamed", "statistics"):
            if read[key] != len(written["messages"]):
                sys.exit(f"wrong: {file}: {key} {read[key]}, not {len(written['messages'])}")
        if read["chunks"] < 2 or read["channels"] != 2:
            sys.exit(f"wrong: {file}: {read['chunks']} chunks of {read['channels']} channels")
    run(python, HERE / "write_files.py", work)
    for name in ("none", "lz4", "zstd", "loose"):
        file = work / f"{name}.mcap"
        ours = json.loads(run(build / "bin/recording_files", "read", file))
        theirs = json.loads(run(python, "-c", READ, file))["messages"] if name != "loose" else ours
        # Messages of the same time may come in any order.
        if sorted(ours, key=by_time) != sorted(theirs, key=by_time) or len(ours) != 30:
            sys.exit(f"wrong: {file}: our reader and the peer's read different messages")
        kept = json.loads(run(build / "bin/recording_files", "read", HERE / f"files/{name}.mcap"))
        if kept != ours:
            sys.exit(f"wrong: files/{name}.mcap is not what write_files.py writes")
    print("both read what the other wrote")


if __name__ == "__main__":
    main()
