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

# What no daemon of the fleet may lack.
ALL = ["registry.user:", "registry.password_file:", "registry.users:", "trusted_keys:", "tls:", "tokens:", "revoked:"]
KEYS = {"master": [*ALL, "signing_key:", "gateway_token_file:", "worker_token_file:", "audit:"],
        "gateway": [*ALL, "host_user:", "host_starter:", "host_files:", "plugins.require_signature: true", "password_file:", "audit:"],
        "topology": [*ALL, "password_file:"]}


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
            if missing := [key for key in keys if not any(line.split("#")[0].find(key) >= 0 for line in text.splitlines())]:
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
