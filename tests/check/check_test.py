#!/usr/bin/python3
"""`iotcloud check` says what is wrong with a machine and how to mend it; `iotcloud support-bundle` packs what helps, and none of the
secrets that this test has put in every place where one can be.

usage: check_test.py BUILD_DIR
"""

import gzip
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

BUILD = Path(sys.argv[1]).resolve()
SECRETS = {"in a URL": "kryptonite-1", "in a password file": "kryptonite-2", "in a token file": "anna." + "5" * 64,
           "in the environment": "bert." + "6" * 64, "in a property": "kryptonite-3", "in a log": "kryptonite-4",
           "of the registry": "kryptonite-5", "in a variable": "kryptonite-6", "in a key": "MHcCAQEEIKryptonite7"}


def iotcloud(*words, environment=None):
    return subprocess.run([str(word) for word in (BUILD / "bin/iotcloud", *words)], capture_output=True, text=True,
                          env={**os.environ, **(environment or {})})


def require(condition, text):
    if not condition:
        sys.exit(f"wrong: {text}")


def write_machine(folder):
    """A gateway's files, with a secret in each place."""
    (folder / "plugins").mkdir()
    shutil.copy(BUILD / "plugins/loadgen.so", folder / "plugins")
    (folder / "state").mkdir()
    (folder / "broker.password").write_text(SECRETS["in a password file"] + "\n")
    (folder / "registry.password").write_text(SECRETS["of the registry"] + "\n")
    (folder / "tokens").write_text(SECRETS["in a token file"] + "\n")
    key = f"-----BEGIN EC PRIVATE KEY-----\n{SECRETS['in a key']}\n-----END EC PRIVATE KEY-----\n"
    (folder / "lab1.key").write_text(key)
    (folder / "state/host.log").write_text(
        f"connects to amqp://guest:{SECRETS['in a URL']}@127.0.0.1:1/\npassword={SECRETS['in a log']}\n{key}"
        f"Authorization: Bearer {SECRETS['in the environment']}\nthe registry refuses {SECRETS['of the registry']}\n")
    (folder / "other.log").write_text(f"a driver: {{\"api_key\": \"{SECRETS['in a property']}\", \"rate\": 5}}\n"
                                      f"{SECRETS['in a token file']} and {SECRETS['in a password file']} are worn out\n"
                                      f"variable {SECRETS['in a variable']}\nreadable line\n")
    config = folder / "gateway.yaml"
    config.write_text(f"""id: lab1
registry: "zookeeper://127.0.0.1:1"
registry.user: gateways
registry.password_file: {folder}/registry.password
registry.unencrypted: true
plugins: {folder}/plugins
state: {folder}/state
thrift: {{port: 12999, tokens: {folder}/tokens}}
metrics: {{address: "127.0.0.1:9999", tls: {{ca: {folder}/none.pem, certificate: {folder}/none.pem, key: {folder}/lab1.key}}}}
brokers:
  rabbitmq: {{type: rabbitmq, urls: ["amqp://guest:{SECRETS['in a URL']}@127.0.0.1:1/"]}}
  second: {{type: rabbitmq, urls: ["amqp://127.0.0.1:1/"], user: u, password_file: {folder}/broker.password}}
  third: {{type: rabbitmq, urls: ["amqp://127.0.0.1:1/"], user: u, password_variable: BROKER_SECRET}}
""")
    return config


def check_check(config):
    done = iotcloud("check", "--config", config, "--limit", "0.3", "-o", "json")
    require(done.returncode == 1, f"status {done.returncode}: {done.stdout}{done.stderr}")
    found = {(one["area"], one["state"]) for one in json.loads(done.stdout)}
    for area, state in (("configuration", "ok"), ("plugin", "ok"), ("disk", "ok"), ("port", "ok"), ("registry", "wrong"),
                        ("broker", "wrong"), ("certificate", "wrong")):
        require((area, state) in found, f"no {area} is {state}: {done.stdout}")
    require(all(one["mend"] for one in json.loads(done.stdout) if one["state"] == "wrong"), f"something wrong has no remedy: {done.stdout}")
    table = iotcloud("check", "--config", config, "--limit", "0.3")
    require("start ZooKeeper" in table.stdout and SECRETS["in a URL"] not in table.stdout, table.stdout)
    require(iotcloud("check", "--config", config.parent / "none.yaml").returncode == 2, "a file that is not there is checked")


def check_bundle(config):
    folder = config.parent
    bundle = folder / "bundle.tar.gz"
    words = ("support-bundle", bundle, "--config", config, "--limit", "0.3", "--log", folder / "other.log", "--master", "127.0.0.1:1")
    environment = {"IOTCLOUD_TOKEN": SECRETS["in the environment"], "BROKER_SECRET": SECRETS["in a variable"]}
    done = iotcloud(*words, environment=environment)
    require(done.returncode == 0, f"{done.stdout}{done.stderr}")
    require(oct(bundle.stat().st_mode & 0o777) == "0o600", "others may read the bundle")
    with gzip.open(bundle) as file:
        bytes_of_all = file.read().decode("utf-8", "replace")
    for where, secret in SECRETS.items():
        require(secret not in bytes_of_all, f"the secret {where} is in the bundle")
    with tarfile.open(bundle) as archive:
        files = {member.name: archive.extractfile(member).read().decode() for member in archive.getmembers()}
    require("driver SDK" in files["versions.txt"] and "iotcloud 0." in files["versions.txt"], files["versions.txt"])
    require({one["area"] for one in json.loads(files["check.json"])} > {"registry", "broker", "port"}, files["check.json"])
    require("127.0.0.1:1" in files["states/status.json"], files["states/status.json"])
    [configuration] = [text for name, text in files.items() if name.startswith("configuration/")]
    require("guest:***@127.0.0.1" in configuration and "id: lab1" in configuration, configuration)
    logs = "".join(text for name, text in files.items() if name.startswith("logs/"))
    require("readable line" in logs and "connects to amqp://guest:***@" in logs and "rate\": 5" in logs, logs)
    require(iotcloud(*words).returncode == 1, "a bundle that is there is written again")


def main():
    with tempfile.TemporaryDirectory(prefix="iotcloud-check-") as name:
        config = write_machine(Path(name))
        check_check(config)
        check_bundle(config)
    print("what is wrong is said; no secret is packed")


if __name__ == "__main__":
    main()
