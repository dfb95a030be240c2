#!/usr/bin/python3
"""Writes README.md: every key of the daemons' configuration files, as the daemons themselves list them.

usage: write.py BUILD_DIR [--check]      (./dev reference; --check: only say whether README.md is up to date)

Each daemon reads its default file of the folder above with all that is commented out there taken in, and lists the keys
that it asked for (--list-keys): names, kinds, defaults and limits come from the code that reads them. What a key means
comes from the comment above it in that file, or from the tables of a README; a key of which neither says anything is an
error. What depends on the file's own values (the default of `tasks`, of a field's name, the names of brokers, `driver` or `sensor`) comes from
two more files that differ in these. The keys of `conf` that our classes take, with all that is said of them, come from where the classes declare them
(ConfKey in topology/conf_keys.h), by the program list_conf_keys.
"""

import argparse
import difflib
import getpass
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = HERE / "README.md"
KEY_LINE = re.compile(r"^(\s*)([a-z_][\w.]*):(?: (.*))?$")
# In a comment: prose may have a colon, too, but no value of one word, in quotes or in brackets behind it.
OPTION = re.compile(r"^ *[a-z_][\w.]*:( *| \S+| [\[{\"].*)( +#.*)?$")
USER = getpass.getuser() if os.geteuid() else "nobody"
# What a file of another machine names, and stands in for it here.
STAND_INS = {"iotcloud-drivers": USER, "iotcloud-worker": USER,
             "my_components.so": "turtlebot_follower.so", "my.Work": "turtlebot.Decoder"}

DAEMONS = (
    ("iotcloud-gateway", "gateway.yaml", None),
    ("iotcloud-master", "master.yaml", None),
    ("iotcloud-topology", "topology.yaml", "topology/definition/README.md"),
    ("iotcloud-topology --pool", "pool.yaml", None),
)
# A name of the user's choice in the default file that iotcloud-topology lists as it stands there, because a URL may be below it, too.
CHOSEN = re.compile(r"^brokers\.rabbitmq\.")
# What the first cell of that README's second table stands for.
OWNERS = {"all": ["spouts.<name>.", "bolts.<name>."], "spouts": ["spouts.<name>."], "bolts": ["bolts.<name>."],
          "inputs": ["bolts.<name>.inputs[]."]}

# A topology whose own values show in what the daemon lists of spouts and bolts, and two sets of such values.
PROBE = """\
registry: "embedded://probe"
topology.name: probe
brokers: {{{broker}: "amqp://127.0.0.1/"}}
spouts: {{read: {{broker: {broker}, {driver}: probe, channel: in, fields: [data, driverID, {{property: {property}}}],
                parallelism: {parallelism}}}}}
bolts: {{send: {{broker: {broker}, {driver}: probe, channel: out, fields: [data, driverID, {{property: {property}}}],
                parallelism: {parallelism}, inputs: [{{from: read}}]}}}}
"""
PROBES = ({"broker": "lab-broker", "driver": "driver", "property": "battery", "parallelism": 17},
          {"broker": "hall-broker", "driver": "sensor", "property": "site", "parallelism": 19})
# Classes of ours that read `conf`: what they are, how their keys begin, what tells of each; by their names in list_conf_keys.
CLASSES = {
    "windows": ("Windowed bolts", "window.", "topology/windows/README.md"),
    "state": ("Bolts with state", "state.", "topology/state/README.md"),
    "follower": ("The follower's bolt turtlebot.Follow", "", "examples/turtlebot_follower/README.md"),
}

HEAD = """\
# Configuration reference

`./dev reference` makes this page from the keys that the daemons read, from the comments in the default files, and from what our
classes declare of `conf`; a test compares it with them. `<name>` is a name of your choice, `[]` an item of a sequence. Durations have a unit (`250ms`, `10s`,
`5m`, `1h`). **required**: the key must be there if its mapping is (for a spout or bolt: if it faces a broker). What a
key without a meaning is stands in the default file, beside the key or on a neighbour of it. A daemon refuses any other key, and names the nearest one of these.
[fleet.yaml](../../config/fleet.yaml) explains the manifest of `iotcloud apply`.
"""


def taken_in(text):
    """The file with what is commented out there. A mapping that stands there twice is the one with more in it."""
    lines = []
    for line in text.splitlines():
        inner = re.match(r"^(\s*)# ?(.*)$", line)
        if inner and OPTION.match(inner[2]):
            line = inner[1] + inner[2]
        lines.append(line)
    last = {match[2]: number for number, line in enumerate(lines) if (match := KEY_LINE.match(line)) and not match[1]}
    kept = [line for number, line in enumerate(lines)
            if not ((match := KEY_LINE.match(line)) and not match[1] and last[match[2]] != number)]
    return "\n".join(kept) + "\n"


def furnished(text, folder, binaries):
    """The same for this machine: what the file names exists, in `folder`."""
    for name, stand_in in STAND_INS.items():
        text = text.replace(name, stand_in)
    names = sorted(set(re.findall(r"/etc/iotcloud/([\w.-]+)", text)))
    text = text.replace("/etc/iotcloud/", f"{folder}/").replace("build/release", str(binaries.parent))

    def run(*words):
        subprocess.run(list(map(str, words)), check=True, stdout=subprocess.DEVNULL, cwd=folder)

    hosts = sorted({Path(name).stem for name in names if name.endswith(".key")} - {"ca", "master"})
    if hosts:
        run(binaries / "iotcloud", "certs", "init", folder, "--host", *hosts)
    for name in names:
        file = folder / name
        if name.endswith("tokens"):
            run(binaries / "iotcloud", "token", "add", "somebody", "--role", "viewer", "--file", file)
        elif name in ("plugin-keys", "order-keys"):
            file.mkdir()
            run(binaries / "iotcloud", "keys", "new", folder / f"lab-{name}")
            shutil.copy(folder / f"lab-{name}.pub", file)
            if name == "order-keys" and (folder / "master.pub").exists():
                shutil.copy(folder / "master.pub", file)  # a master trusts its own key
        elif name == "pages":
            file.mkdir()
        elif name == "master.key":
            file.unlink(missing_ok=True)
            run(binaries / "iotcloud", "keys", "new", folder / "master")
        elif name == "registry.users":
            for user, role in (("master", "master"), ("gateway-1", "gateway"), ("workers", "worker")):
                run(binaries / "iotcloud", "registry", "user", user, "--role", role, "--file", file)
        elif not file.exists():
            file.write_text("a secret\n")
            file.chmod(0o600)
    return text


def comments(text):
    """What is said of each dotted key of a file: what belongs to it alone (the comment lines right above it, and what
    stands behind it), and what it shares with the keys before it (their comment, up to an empty line)."""
    said, above, fresh, stack = {}, [], False, []
    for line in text.splitlines():
        match = KEY_LINE.match(line)
        if not line.strip():
            above = []
        elif line.lstrip().startswith("#"):
            above = (above if fresh else []) + [line.strip().lstrip("# ")]
            fresh = True
        elif match:
            indent, key = len(match[1]), match[2]
            if not fresh and stack and stack[-1][0] != indent:
                above = []
            stack = [entry for entry in stack if entry[0] < indent] + [(indent, key)]
            behind = (match[3] or "").partition(" # ")[2].strip()
            own = above * fresh + [behind] * bool(behind)
            said[".".join(part for _, part in stack)] = (" ".join(own), " ".join(above))
            fresh = False
    return said


def tables(readme):
    """What the tables of a README say of keys, in the form of comments()."""
    said, owner = {}, None
    for line in readme.read_text().splitlines() if readme else []:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|") or len(cells) < 2 or re.fullmatch(r"`[\w/]+\.h`", cells[-1]):
            continue  # no row, or one that only cites a header
        if len(cells) == 3:
            owner = cells[0] or owner
        for key in re.findall(r"`([a-z_][\w.]*)(?:: \w+)?`", cells[-2]):
            for prefix in OWNERS.get(owner, [""]) if len(cells) == 3 else [""]:
                said[prefix + key] = (cells[-1], "")
    return said


def lookup(key, said):
    """What is said of a key; a name of the user's choice may stand for `<name>` in the file."""
    if key in said:
        return said[key]
    pattern = re.compile(re.escape(key).replace("<name>", r"[^.]+").replace(r"\[\]", ""))
    found = [text for path, text in said.items() if pattern.fullmatch(path)]
    return next((text for text in found if text[0]), next(iter(found), ("", "")))


def asked(program, configuration, binaries):
    """The keys that a daemon lists for a file."""
    name, *options = program.split()
    listed = subprocess.run([binaries / name, *options, "--config", configuration, "--list-keys"],
                            capture_output=True, text=True)
    if listed.returncode != 0:
        sys.exit(f"{program} does not take this file:\n{configuration.read_text()}\n{listed.stderr}")
    return json.loads(listed.stdout)


def for_any_file(binaries):
    """What of a spout's or bolt's keys depends on the file that the daemon reads, as it is for any file: {key: (value or None,
    default or None)}. It is where the lists for the two PROBES differ."""
    with tempfile.TemporaryDirectory(prefix="iotcloud-reference-") as folder:
        lists = []
        for values in PROBES:
            file = Path(folder) / f"{values['broker']}.yaml"
            file.write_text(PROBE.format(**values))
            lists.append({entry["key"]: entry for entry in asked("iotcloud-topology", file, binaries)})

    def each(key, what):
        return [entries[key][what] for entries in lists]

    def value_of(key, what):
        """The key of PROBES whose value is, each time, what `shown` says of this key."""
        found = [name for name in PROBES[0] if [str(values[name]) for values in PROBES] == what]
        if not found:
            sys.exit(f"iotcloud-topology lists {what} of {key} for two files, and neither has such a value: docs/reference/write.py "
                     "does not know of what it depends")
        return found[0]

    true = {}
    for key in lists[0]:
        if not re.match(r"(spouts|bolts)\.<name>\.\w+(\[\]\.\w+)?$", key):
            continue
        value = fallback = None
        if len(set(each(key, "allowed"))) > 1:
            words = [allowed.split(", ") for allowed in each(key, "allowed")]
            fixed = [word for word in words[0] if word in words[1]]
            own = [", ".join(word.strip('"') for word in some if word not in fixed) for some in words]
            value = f"{lists[0][key]['kind']}: {', '.join(fixed)}, or a name under `{value_of(key, own)}s`"
        if len(set(each(key, "default"))) > 1:
            fallback = f"`{value_of(key, each(key, 'default'))}`"
        if len(set(each(key, "required"))) > 1:
            owner = key.rpartition(".")[0]
            names = {values["driver"] for values in PROBES} - {key.removeprefix(f"{owner}.")}
            if len(names) != 1 or each(f"{owner}.{min(names)}", "required") != each(key, "required")[::-1]:
                sys.exit(f"iotcloud-topology requires {key} of some files, but not in turns with the other name of it")
            fallback = f"**required**, or `{min(names)}`"
        if value or fallback:
            true[key] = (value, fallback)
    return true


def table(keys, said, mentioned, true):
    """Markdown of a daemon's keys, and those of which nothing is said. `true`: as for_any_file() returns it."""
    rows, unsaid = [], []
    for entry in keys:
        key = entry["key"]
        own, shared = lookup(key, said)
        if not own and not shared and not re.search(rf"(?<!\w){re.escape(key.rsplit('.', 1)[-1])}(?!\w)", mentioned):
            unsaid.append(key)
        fallback = "**required**" if entry["required"] else f"`{entry['default']}`" * bool(entry["default"])
        kind = entry["kind"] + f": {entry['allowed']}" * bool(entry["allowed"])
        true_kind, true_fallback = true.get(key, (None, None))
        kind, fallback = true_kind or kind, true_fallback or fallback
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in (f"`{key}`", kind, fallback, own)) + " |")
    return "\n".join(["| key | value | default | meaning |", "|---|---|---|---|", *rows]), unsaid


def section(program, file, readme, binaries):
    source = (ROOT / "config" / file).read_text()
    complete = taken_in(source)
    with tempfile.TemporaryDirectory(prefix="iotcloud-reference-") as folder:
        folder = Path(folder) / "etc"
        folder.mkdir(mode=0o700)
        configuration = folder / file
        configuration.write_text(furnished(complete, folder, binaries))
        keys = [{**entry, "key": CHOSEN.sub("brokers.<name>.", entry["key"])} for entry in asked(program, configuration, binaries)
                if not CHOSEN.fullmatch(entry["key"] + ".")]
    beside = {key: text for key, text in comments(complete).items() if any(text)}
    said = tables(readme and ROOT / readme) | beside
    mentioned = source + ((ROOT / readme).read_text() if readme else "")
    true = for_any_file(binaries) if program == "iotcloud-topology" else {}
    text, unsaid = table(keys, said, mentioned, true)
    if unsaid:
        where = f"config/{file}" + f" or {readme}" * bool(readme)
        sys.exit(f"{where}: nothing is said of {', '.join(unsaid)}: add a comment that tells what each is for")
    more = f"[{readme}](../../{readme}) says more.\n\n" if readme else ""
    return f"## {program}: [{file}](../../config/{file})\n\n{more}{text}\n"


def conf_section(name, keys):
    """The keys of `conf` that a class declares."""
    what, prefix, readme = CLASSES[name]
    others = f"Any other key that begins with `{prefix}`" if prefix else "Any other key"
    rows = ["| " + " | ".join((f"`{key['key']}`", key["value"], key["otherwise"], key["text"])) + " |" for key in keys]
    table = "\n".join(["| key of `conf` | value | default | meaning |", "|---|---|---|---|", *rows])
    return f"## {what}: `conf`\n\n[{readme}](../../{readme}) says more. {others} is refused.\n\n{table}\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    build = given.build.resolve()
    declared = json.loads(subprocess.run([build / "bin/list_conf_keys"], check=True, capture_output=True).stdout)
    text = "\n".join([HEAD, *(section(*daemon, build / "bin") for daemon in DAEMONS),
                      *(conf_section(name, keys) for name, keys in declared.items())])
    if not given.check:
        TARGET.write_text(text)
        return
    written = TARGET.read_text()
    if written != text:
        sys.stdout.writelines(difflib.unified_diff(written.splitlines(True), text.splitlines(True),
                                                   "docs/reference/README.md", "what the daemons ask for"))
        sys.exit("docs/reference/README.md is not what the daemons ask their files for: run ./dev reference")


if __name__ == "__main__":
    main()
