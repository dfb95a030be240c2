#include <atomic>
#include <stdexcept>

#include "iotcloud/tests/brokers/ledger/ledger.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/brokers/embedded/server.h>

namespace iotcloud::brokers {
namespace {

Victim embedded_victim() {
  auto server = std::make_shared<embedded::Server>(embedded::Server::named("ledger"));
  Victim victim;
  victim.options.urls = {"embedded://ledger"};
  victim.kill = [server] { server->stop(); };
  victim.start = [server] { server->start(); };
  victim.server = server;
  return victim;
}

Victim process_victim(const std::string& script) {
  auto server = std::make_shared<tests::PrivateServer>(script);
  Victim victim;
  victim.options.urls = {server->url()};
  victim.kill = [server] { server->kill(); };
  victim.start = [server] { server->start(); };
  victim.pause = [server] { server->pause(); };
  victim.resume = [server] { server->resume(); };
  victim.server = server;
  return victim;
}

/// Stops one of three nodes at a time, first the one to which the clients are connected.
Victim cluster_victim() {
  auto server = std::make_shared<tests::PrivateServer>("rabbitmq_cluster.py");
  auto next = std::make_shared<std::atomic<int>>(0);
  const auto node = [next] { return *next % 3 + 1; };
  Victim victim;
  victim.options.urls = server->urls();
  victim.options.properties = {{"queue_type", "quorum"}};
  victim.kill = [server, node] { server->kill(node()); };
  victim.start = [server, node, next] {
    server->start(node());
    ++*next;
  };
  victim.pause = [server, node] { server->pause(node()); };
  victim.resume = [server, node, next] {
    server->resume(node());
    ++*next;
  };
  victim.server = server;
  return victim;
}

/// Three nodes, each with a copy of all data; stops each time the node that leads the first topic.
Victim replicated_kafka_victim() {
  const std::string topic = "gw.ledger.0";
  auto server = std::make_shared<tests::PrivateServer>("kafka_cluster.py");
  Victim victim;
  victim.options.urls = server->urls();
  victim.options.properties = {{"partitions", "3"}, {"replication", "3"}};
  victim.kill = [server, topic] { server->command("kill-leader " + topic, "KILLED"); };
  victim.start = [server] { server->start(); };
  victim.pause = [server, topic] { server->command("pause-leader " + topic, "PAUSED"); };
  victim.resume = [server] { server->resume(); };
  victim.server = server;
  return victim;
}

}  // namespace

Victim make_victim(const std::string& kind) {
  Victim victim;
  if (kind == "embedded") {
    victim = embedded_victim();
  } else if (kind == "cluster") {
    victim = cluster_victim();
  } else if (kind == "replicated_kafka") {
    victim = replicated_kafka_victim();
  } else {
    victim = process_victim(kind + ".py");
    if (kind == "rabbitmq") victim.gaps_from_bytes = 4096;  // classic queues: see brokers/rabbitmq/README.md
  }
  victim.options.heartbeat = std::chrono::seconds(2);
  return victim;
}

}  // namespace iotcloud::brokers
