#!/usr/bin/python3
"""The configurations of deploy/fleet pass their daemons' own check as they stand, but for their paths, after the commands of its
page; and each has what secures its daemon. files_test.py starts the units with them.

usage: fleet_test.py DEPLOY_FOLDER BUILD_DIR
"""

import pathlib
import subprocess
import sys
import tempfile

import fleet
import yaml

# What no daemon of the fleet may lack: keys, with those of the mappings in which they stand before them.
ALL = ["registry.user", "registry.password_file", "registry.users", "metrics/tls/revoked", "metrics/tokens"]
KEYS = {"master": [*ALL, "orders/signing_key", "orders/trusted_keys", "api/tls/revoked", "api/tokens",
                   "api/gateway_token_file", "api/worker_token_file", "audit/file"],
        "gateway": [*ALL, "orders.trusted_keys", "thrift/tls/revoked", "thrift/tokens", "host_user", "host_starter", "host_files/write",
                    "plugins.require_signature", "plugins.trusted_keys", "brokers/rabbitmq/password_file", "brokers/rabbitmq/tls/ca",
                    "audit/file"],
        "topology": [*ALL, "orders.trusted_keys", "brokers/rabbitmq/password_file", "brokers/rabbitmq/tls/ca"]}


def has(configuration, path):
    for key in path.split("/"):
        if not isinstance(configuration, dict) or not configuration.get(key):
            return False
        configuration = configuration[key]
    return True


def check(daemon, file):
    return subprocess.run([daemon, "--config", file, "--check-config"], capture_output=True, text=True, timeout=60, check=False)


def main():
    deploy, build = (pathlib.Path(word).resolve() for word in sys.argv[1:])
    with tempfile.TemporaryDirectory() as work:
        folder = pathlib.Path(work)
        fleet.make(deploy, build / "bin", build / "plugins/loadgen.so", folder)
        for name, keys in KEYS.items():
            made = folder / "etc" / ("topologies/echo.yaml" if name == "topology" else f"{name}.yaml")
            text = made.read_text(encoding="utf-8")
            if text != (deploy / "fleet" / f"{name}.yaml").read_text(encoding="utf-8"):
                sys.exit(f"the commands of the page change {name}.yaml")
            if missing := [key for key in keys if not has(yaml.safe_load(text), key)]:
                sys.exit(f"{name}.yaml has no {missing}")
            paths = {"/etc/iotcloud": folder / "etc"}
            if name == "gateway":
                paths |= {fleet.PLUGINS: folder / "plugins", "host_user: iotcloud-host": "host_user: nobody"}  # a user of this machine
            made.write_text(fleet.replaced(text, paths), encoding="utf-8")
            daemon = build / f"bin/iotcloud-{name}"
            done = check(daemon, made)
            if done.returncode:
                sys.exit(f"{name}.yaml: {done.stderr or done.stdout}")
            made.write_text(made.read_text(encoding="utf-8") + "\nnonsense: 1\n", encoding="utf-8")
            if check(daemon, made).returncode == 0:
                sys.exit(f"{daemon} --check-config takes nonsense")
    print(f"{len(KEYS)} configurations are good")


if __name__ == "__main__":
    main()
