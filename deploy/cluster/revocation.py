"""What `./dev cluster certs revoke` does beside the list of revoked certificates: a gateway's users at the brokers and in the
registry go, with the connections that they have open, and those of all tunnels to the registry are begun anew, by those who still
have a certificate.
"""

import json


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


def commands(gateway, master):
    """What is to be done in which service, in this order; a service that does not run has nothing to forget. The registry's nodes
    get their rights from a master's container."""
    kafka = ["env", "KAFKA_HEAP_OPTS=-Xmx64m", "KAFKA_OPTS=", "/opt/kafka/bin/kafka-acls.sh", "--bootstrap-server", "localhost:9092",
             "--command-config", "/run/secrets/admin.properties", "--remove", "--force", "--allow-principal", f"User:{gateway}",
             "--operation", "All", "--topic", f"{gateway}.", "--group", f"{gateway}.", "--resource-pattern-type", "prefixed"]
    rights = ["iotcloud", "registry", "rights", "--registry", "zookeeper://127.0.0.1:2181", "--user", master, "--password-file",
              "/run/secrets/registry.password", "--users", "/run/secrets/registry.users"]
    return [*(("rabbitmq", ["rabbitmqctl", "delete_user", user]) for user in users_at_rabbitmq(gateway)),
            ("kafka", kafka), (master, rights)]
