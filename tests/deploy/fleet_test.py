#!/usr/bin/python3
"""The configurations of deploy/fleet pass their daemons' own check as they stand, but for their paths, after the commands of its
page; and each has what secures its daemon. The page gives RabbitMQ's users the rights and limits that are tested at a server
(tests/brokers/rabbitmq/users_test.cc). files_test.py starts the units with the configurations.

usage: fleet_test.py DEPLOY_FOLDER BUILD_DIR
"""

import json
import pathlib
import subprocess
import sys
import tempfile

import fleet
import yaml

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "deploy/cluster"))

import cluster  # noqa: E402  (its folder is known now)

# What no daemon of the fleet may lack: keys, with those of the mappings in which they stand before them.
ALL = ["registry.user", "registry.password_file", "registry.users", "metrics/tls/revoked", "metrics/tokens", "metrics/certificates"]
KEYS = {"master": [*ALL, "orders/signing_key", "orders/trusted_keys", "api/tls/revoked", "api/tokens",
                   "api/gateway_token_file", "api/worker_token_file", "api/pool_token_file", "audit/file"],
        "gateway": [*ALL, "orders.trusted_keys", "thrift/tls/revoked", "thrift/tokens", "host_user", "host_starter", "host_files/write",
                    "plugins.require_signature", "plugins.require_version", "plugins.trusted_keys", "brokers/rabbitmq/password_file",
                    "brokers/rabbitmq/tls/ca", "brokers/rabbitmq/tls/revoked", "brokers/rabbitmq/properties/exchange",
                    "brokers/rabbitmq/properties/reader", "audit/file"],
        "pool": [*ALL, "orders.trusted_keys", "thrift/tls/revoked", "thrift/tokens", "worker_user", "worker_starter", "worker_files/read",
                 "libraries.require_signature", "libraries.require_version", "libraries.trusted_keys", "audit/file"],
        "topology": [*ALL, "orders.trusted_keys", "brokers/rabbitmq/password_file", "brokers/rabbitmq/tls/ca",
                     "brokers/rabbitmq/tls/revoked"]}


def has(configuration, path):
    for key in path.split("/"):
        if not isinstance(configuration, dict) or not configuration.get(key):
            return False
        configuration = configuration[key]
    return True


def check(daemon, file):
    """`daemon`: a program, or a list of it and its first words."""
    words = [*(daemon if isinstance(daemon, list) else [daemon]), "--config", file, "--check-config"]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)


def certificates(configuration):
    """All certificates that a configuration names."""
    if isinstance(configuration, dict):
        return {configuration["certificate"]} if "certificate" in configuration else set().union(
            *map(certificates, configuration.values()))
    return set()


def check_certificates(deploy):
    """Each daemon has one of its own: whoever takes over a daemon has no token's certificate but its own."""
    named = {name: certificates(yaml.safe_load((deploy / "fleet" / f"{name}.yaml").read_text(encoding="utf-8"))) for name in KEYS}
    for name, own in named.items():
        if own != {f"/etc/iotcloud/lab1-{name}.pem"}:
            sys.exit(f"{name}.yaml has the certificates {own}")


def rights(told):
    """Of each user of RabbitMQ, as RABBITMQ_USERS of cluster.py has them, and who has a password."""
    users, with_password = {}, set()
    for verb, user, *words in told:
        if verb == "add_user" and words[-1]:
            with_password.add(user)
        elif verb == "set_permissions":
            users.setdefault(user, {}).update(zip(("configure", "write", "read"), words))
        elif verb == "set_topic_permissions" and words[0] == cluster.GATEWAYS_EXCHANGE and words[1] == words[2]:
            users.setdefault(user, {})["keys"] = words[1]
    return users, with_password


def check_tokens(folder):
    """Each token counts with one certificate, so that whoever catches it has no use of it, and has an end."""
    for file in ("etc/master-tokens", "etc/gateway-tokens", "etc/pool-tokens", "etc/page-tokens", "lab2/gateway-tokens"):
        for line in (folder / file).read_text(encoding="utf-8").splitlines():
            if line and not line.startswith("#") and "CN=" not in line:
                sys.exit(f"{file} has a token that counts with any certificate: {line.split()[0]}")
            if line and not line.startswith("#") and "/" not in line.split(":")[1]:
                sys.exit(f"{file} has a token without an end: {line.split(':')[0]}")


def check_brokers_users(folder):
    cluster.GATEWAYS = ["gateway-[0-9]+"]  # the page's rights of workers are for gateways that have such ids
    expected = {**cluster.rights_of_gateway("gateway-1"), "workers": cluster.rights_of_workers()}
    told = fleet.told_rabbitmq(folder)
    users, with_password = rights(told)
    if users != expected or with_password != set(expected):
        sys.exit(f"RabbitMQ's users of the page: {users}, and those that are tested: {expected}; {with_password} have passwords")
    limits = {user: cluster.USER_LIMITS[user] for user in expected}
    if {user: json.loads(limit) for verb, user, limit, *_ in told if verb == "set_user_limits"} != limits:
        sys.exit(f"RabbitMQ's users of the page have not the limits {limits}: {told}")
    if ["set_vhost_limits", json.dumps({"max-queues": cluster.MOST_QUEUES}), ""] not in told:
        sys.exit(f"RabbitMQ has any number of queues: {told}")
    if ["set_policy", "--apply-to", "queues", "limits", ".*", json.dumps(cluster.QUEUE_LIMITS), ""] not in told:
        sys.exit(f"in RabbitMQ's queues waits as much as comes: {told}")
    if ["delete_user", "guest", ""] not in told:
        sys.exit("RabbitMQ's user guest stays")


def check_further_machine(build, folder):
    """lab2's gateway takes the files that the page makes for it, and none of lab1's."""
    text = (folder / "lab2/gateway.yaml").read_text(encoding="utf-8")
    if "lab1" in text or "gateway-1" in text:
        sys.exit(f"lab2's gateway is of lab1:\n{text}")
    file = folder / "lab2/here.yaml"
    file.write_text(fleet.replaced(text, {"/etc/iotcloud": folder / "lab2", fleet.PLUGINS: folder / "plugins",
                                          "host_user: iotcloud-host": "host_user: nobody"}), encoding="utf-8")
    done = check(build / "bin/iotcloud-gateway", file)
    if done.returncode:
        sys.exit(f"lab2's gateway.yaml: {done.stderr or done.stdout}")


def check_submitted(deploy, build, folder):
    """The page's folder for workers has all that a topology names, and nothing that is the pool's: components read it."""
    of_pool = yaml.safe_load((deploy / "fleet/pool.yaml").read_text(encoding="utf-8"))
    if of_pool["worker_files"]["read"] != ["/etc/iotcloud/workers"]:
        sys.exit(f"workers of the pool read {of_pool['worker_files']['read']}")
    keys = {file.read_bytes() for file in (folder / "etc/workers").glob("*.key")}
    if keys & {(folder / "etc" / name).read_bytes() for name in ("lab1-pool.key", "lab1-topology.key", "lab1-master.key")}:
        sys.exit("the folder for workers has the key of a daemon")
    file = folder / "submitted.yaml"
    file.write_text(fleet.submitted((deploy / "fleet/topology.yaml").read_text(encoding="utf-8"), folder / "etc/workers"),
                    encoding="utf-8")
    done = check(build / "bin/iotcloud-topology", file)
    if done.returncode:
        sys.exit(f"a topology with the files of the folder for workers: {done.stderr or done.stdout}")


def main():
    deploy, build = (pathlib.Path(word).resolve() for word in sys.argv[1:])
    with tempfile.TemporaryDirectory() as work:
        folder = pathlib.Path(work)
        fleet.make(deploy, build / "bin", build / "plugins/loadgen.so", folder)
        check_certificates(deploy)
        check_tokens(folder)
        check_brokers_users(folder)
        check_further_machine(build, folder)
        check_submitted(deploy, build, folder)
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
            if name == "pool":
                paths |= {"worker_user: iotcloud-worker": "worker_user: nobody"}
            made.write_text(fleet.replaced(text, paths), encoding="utf-8")
            daemon = [build / "bin/iotcloud-topology", "--pool"] if name == "pool" else build / f"bin/iotcloud-{name}"
            done = check(daemon, made)
            if done.returncode:
                sys.exit(f"{name}.yaml: {done.stderr or done.stdout}")
            made.write_text(made.read_text(encoding="utf-8") + "\nnonsense: 1\n", encoding="utf-8")
            if check(daemon, made).returncode == 0:
                sys.exit(f"{daemon} --check-config takes nonsense")
    print(f"{len(KEYS)} configurations are good")


if __name__ == "__main__":
    main()
