"""What `./dev cluster certs revoke` does beside the list of revoked certificates: a gateway's users at the brokers and in the
registry go, with the connections that they have open, and those of all tunnels to the registry are begun anew, by those who still
have a certificate. And what `./dev cluster passwords renew` does after a worker was stolen: all workers have one user, so they get
other passwords.
"""

import json
import re


def users_at_rabbitmq(gateway):
    return [gateway, f"{gateway}-reads"]


def forget(folder, gateway):
    """Takes a gateway's users out of the files of the folder `authority`: servers that start again know them no more."""
    file = folder / "rabbitmq.users.json"
    known = json.loads(file.read_text(encoding="utf-8"))
    gone = users_at_rabbitmq(gateway)
    for kind, key in (("users", "name"), ("permissions", "user"), ("topic_permissions", "user")):
        known[kind] = [one for one in known[kind] if one[key] not in gone]
    file.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    for name, is_its in (("kafka.server.jaas", lambda line: line.strip().startswith(f"user_{gateway}=")),
                         ("registry.users", lambda line: line.split()[1:2] and line.split()[1].split(":")[0] == gateway)):
        file = folder / name
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        file.write_text("".join(line for line in lines if not is_its(line)), encoding="utf-8")


def replace_passwords(folder, hash_at_rabbitmq, at_kafka):
    """Gives the workers other passwords in the brokers' files of the folder `authority`, and takes them out of the registry's."""
    file = folder / "rabbitmq.users.json"
    known = json.loads(file.read_text(encoding="utf-8"))
    for user in known["users"]:
        if user["name"] == "workers":
            user["password_hash"] = hash_at_rabbitmq
    file.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    file = folder / "kafka.server.jaas"
    file.write_text(re.sub(r'(?m)^(\s*user_workers)="[^"]*"', rf'\1="{at_kafka}"', file.read_text(encoding="utf-8")), encoding="utf-8")
    file = folder / "registry.users"
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    file.write_text("".join(line for line in lines if not line.startswith("worker workers:")), encoding="utf-8")


def commands_for_passwords():
    """What RabbitMQ is told of the workers' other password. Kafka reads it when it starts."""
    return [["rabbitmqctl", "import_definitions", "/run/secrets/users.json"],
            ["rabbitmqctl", "close_all_user_connections", "workers", "they have another password"]]


def rights(master):
    """Gives the registry's nodes the rights of the users that there are, from a master's container, and ZooKeeper's own nodes to the
    masters: nobody else uses this ZooKeeper."""
    return ["iotcloud", "registry", "rights", "--registry", "zookeeper://127.0.0.1:2181", "--user", master, "--password-file",
            "/run/secrets/registry.password", "--users", "/run/secrets/registry.users", "--close-server"]


def commands(gateway, master):
    """What is to be done in which service, in this order; a service that does not run has nothing to forget."""
    kafka = ["env", "KAFKA_HEAP_OPTS=-Xmx64m", "KAFKA_OPTS=", "/opt/kafka/bin/kafka-acls.sh", "--bootstrap-server", "localhost:9092",
             "--command-config", "/run/secrets/admin.properties", "--remove", "--force", "--allow-principal", f"User:{gateway}",
             "--operation", "All", "--topic", f"{gateway}.", "--group", f"{gateway}.", "--resource-pattern-type", "prefixed"]
    return [*(("rabbitmq", ["rabbitmqctl", "delete_user", user]) for user in users_at_rabbitmq(gateway)),
            ("kafka", kafka), (master, rights(master))]
