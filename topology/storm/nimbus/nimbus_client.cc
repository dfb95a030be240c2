#include <algorithm>
#include <fstream>
#include <sstream>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <thrift/TApplicationException.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include "iotcloud/topology/storm/Nimbus.h"
#include <iotcloud/rpc/listen_settings.h>
#include <iotcloud/rpc/thrift_client.h>
#include <iotcloud/topology/storm/nimbus/nimbus_client.h>

namespace iotcloud::topology::storm {

using apache::thrift::TException;
using std::chrono::milliseconds;

namespace {

using Client = idl::NimbusClient;

constexpr milliseconds answer_limit{30'000};
constexpr milliseconds search_pause{200};
/// What fits into a message of a Nimbus with the usual limit of 1 MiB; Storm's own client sends as much.
constexpr std::size_t chunk_size = 307'200;

struct Connection {
  explicit Connection(const std::string& address) : to(address), client(nullptr) {
    const auto parts = rpc::split_address(address);
    rpc::ThriftClientOptions options;
    options.host = parts.host;
    options.port = parts.port;
    options.answer_limit = answer_limit;
    transport = std::make_unique<rpc::ThriftClient>(options);
    client = Client(transport->protocol());
  }
  std::string to;
  std::unique_ptr<rpc::ThriftClient> transport;
  Client client;
};

RunningTopology running(const idl::TopologySummary& summary) {
  return {summary.id,          summary.name,       summary.status, summary.num_tasks, summary.num_executors,
          summary.num_workers, summary.uptime_secs};
}

bool is_own(const std::string& component) {
  return component.starts_with("__");
}

/// The class of ours with which the text of an error begins that a C++ component or grouping reports while it runs;
/// empty: it is of another class of Java, such as what a component throws when it cannot be opened.
std::string_view class_of_running(std::string_view error) {
  for (const std::string_view ours : {"iotcloud.storm.ComponentError: ", "iotcloud.storm.GroupingError: "}) {
    if (error.starts_with(ours)) return ours;
  }
  return {};
}

/// The first line of a Java exception's text, without the class of ours, which tells nothing.
std::string without_stack(const std::string& error) {
  return error.substr(0, error.find('\n')).substr(class_of_running(error).size());
}

std::vector<ReportedError> errors_of(const std::map<std::string, std::vector<idl::ErrorInfo>>& by_component) {
  std::vector<ReportedError> errors;
  for (const auto& [component, reported] : by_component) {
    for (const auto& each : reported)
      errors.push_back({component, without_stack(each.error), each.error_time_secs, each.host, each.port,
                        !class_of_running(each.error).empty()});
  }
  std::sort(errors.begin(), errors.end(), [](const auto& a, const auto& b) { return a.at_s > b.at_s; });
  return errors;
}

ComponentCounts counts_of(const std::string& component, const idl::ComponentAggregateStats& stats, bool spout) {
  const auto& common = stats.common_stats;
  ComponentCounts counts;
  counts.component = component;
  counts.spout = spout;
  counts.executors = common.num_executors;
  counts.tasks = common.num_tasks;
  counts.emitted = common.emitted;
  counts.transferred = common.transferred;
  counts.acked = common.acked;
  counts.failed = common.failed;
  counts.executed = stats.specific_stats.bolt.executed;
  counts.execute_ms = stats.specific_stats.bolt.execute_latency_ms;
  counts.process_ms = stats.specific_stats.bolt.process_latency_ms;
  counts.capacity = stats.specific_stats.bolt.capacity;
  counts.last_error = without_stack(stats.last_error.error);
  counts.complete_ms = stats.specific_stats.spout.complete_latency_ms;
  return counts;
}

std::string file_text(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) throw NimbusError(path + " cannot be read");
  return std::move(text).str();
}

idl::StormTopology read_topology(const std::string& bytes) {
  std::string copy = bytes;
  const auto memory = std::make_shared<apache::thrift::transport::TMemoryBuffer>(
      reinterpret_cast<std::uint8_t*>(copy.data()), static_cast<std::uint32_t>(copy.size()));
  apache::thrift::protocol::TBinaryProtocol protocol(memory);
  idl::StormTopology topology;
  topology.read(&protocol);
  return topology;
}

/// Sends a jar to where Nimbus keeps it. \return its name there
std::string upload(Client& nimbus, const std::string& bytes,
                   const std::function<void(std::size_t, std::size_t)>& progress) {
  std::string location;
  nimbus.beginFileUpload(location);
  for (std::size_t sent = 0; sent < bytes.size();) {
    const std::string chunk = bytes.substr(sent, chunk_size);
    nimbus.uploadChunk(location, chunk);
    sent += chunk.size();
    if (progress) progress(sent, bytes.size());
  }
  nimbus.finishFileUpload(location);
  return location;
}

bool lists(Client& nimbus, const std::string& name) {
  std::vector<idl::TopologySummary> running_now;
  nimbus.getTopologySummaries(running_now);
  return std::any_of(running_now.begin(), running_now.end(), [&](const auto& one) { return one.name == name; });
}

/// Nimbus knows no topology of the name.
struct NotAlive : NimbusError {
  using NimbusError::NimbusError;
};

TopologyDetails as_details(const RunningTopology& topology, const idl::TopologyInfo& info) {
  TopologyDetails details{topology, {}, errors_of(info.errors)};
  for (const auto& executor : info.executors) {
    if (is_own(executor.component_id)) continue;
    details.executors.push_back({executor.component_id, executor.executor_info.task_start,
                                 executor.executor_info.task_end, executor.host, executor.port, executor.uptime_secs,
                                 executor.__isset.stats});
  }
  return details;
}

}  // namespace

struct NimbusClient::Impl {
  std::vector<std::string> addresses;
  milliseconds patience;
  std::unique_ptr<Connection> leader;
  std::string version;

  /// Connects to the leader that one of the addresses names.
  void find_leader() {
    std::string why;
    if (find_leader_other_than("", why)) return;
    throw NimbusError(fmt::format(
        "no Nimbus answers and leads ({}); name one that runs, HOST:PORT, with --nimbus (6627 is the usual port)",
        why));
  }

  /// As find_leader(). \param former the address of one that is named as the leader and does not count; empty: none
  /// \param why gets why none was found \return false if none was within `patience`
  bool find_leader_other_than(const std::string& former, std::string& why) {
    leader.reset();
    const auto end = std::chrono::steady_clock::now() + patience;
    while (true) {
      for (const std::string& address : addresses) {
        try {
          auto asked = std::make_unique<Connection>(address);
          idl::NimbusSummary summary;
          asked->client.getLeader(summary);
          const std::string its = fmt::format("{}:{}", summary.host, summary.port);
          if (its == former) continue;
          if (its != address) asked = std::make_unique<Connection>(its);
          leader = std::move(asked);
          version = summary.version;
          return true;
        } catch (const TException& error) {
          why = fmt::format("{}: {}", address, error.what());
        }
      }
      if (std::chrono::steady_clock::now() >= end) return false;
      std::this_thread::sleep_for(search_pause);
    }
  }

  /// Makes a call; once more to the leader of then, when the connection broke, or when the Nimbus that answered leads
  /// no longer. \param make may be called twice
  template <typename Call>
  auto ask(Call&& make) -> decltype(make(std::declval<Client&>())) {
    for (int tries = 1;; ++tries) {
      try {
        if (!leader) find_leader();
        return make(leader->client);
      } catch (const idl::NotAliveException& error) {
        throw NotAlive("no such topology runs: " + error.msg);
      } catch (const idl::AuthorizationException& error) {
        throw NimbusError("Nimbus does not permit it: " + error.msg);
      } catch (const idl::InvalidTopologyException& error) {
        throw NimbusError("Nimbus refuses the topology: " + error.msg);
      } catch (const idl::AlreadyAliveException& error) {
        throw NimbusError("a topology of this name runs already (" + error.msg + "); kill it first");
      } catch (const apache::thrift::TApplicationException& error) {
        // So answers a Nimbus that leads no longer, without saying so, and one that failed. Until another one leads,
        // all still name the former leader.
        const std::string to = leader->to;
        std::string why;
        if (tries > 1 || !find_leader_other_than(to, why)) {
          const std::string others =
              tries > 1 ? "" : fmt::format("no other one leads{}; ", why.empty() ? "" : " (" + why + ")");
          throw NimbusError(fmt::format("Nimbus {} failed: {}; {}its log says more", to, error.what(), others));
        }
      } catch (const TException& error) {
        const std::string to = leader ? leader->to : addresses.front();
        leader.reset();
        if (tries > 1) throw NimbusError(fmt::format("Nimbus {}: {}", to, error.what()));
      }
    }
  }

  bool lists(const std::string& name) {
    return ask([&](Client& client) { return storm::lists(client, name); });
  }

  /// Makes a call about a topology. A Nimbus that has just begun to lead may say that a topology is not alive which it
  /// lists: then the call is made again.
  template <typename Call>
  void order(const std::string& name, Call&& make) {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (true) {
      try {
        return ask(make);
      } catch (const NotAlive&) {
        if (!lists(name) || std::chrono::steady_clock::now() >= end) throw;
      }
      std::this_thread::sleep_for(search_pause);
    }
  }
};

NimbusClient::NimbusClient(std::vector<std::string> addresses, milliseconds patience)
    : impl_(std::make_unique<Impl>(Impl{std::move(addresses), patience, nullptr, ""})) {
  if (impl_->addresses.empty())
    throw NimbusError("no Nimbus is named; give --nimbus HOST:PORT, or \"engine.storm.nimbus\" in the topology's file");
  impl_->find_leader();
}
NimbusClient::~NimbusClient() = default;

std::string NimbusClient::leader() const {
  return impl_->leader ? impl_->leader->to : "";
}
std::string NimbusClient::version() const {
  return impl_->version;
}

void NimbusClient::submit(const std::string& name, const std::string& conf, const std::string& topology,
                          const std::string& jar, const std::function<void(std::size_t, std::size_t)>& progress) {
  if (impl_->lists(name))
    throw NimbusError("a topology \"" + name +
                      "\" runs already; kill it first, or give the file another topology.name");
  const std::string bytes = file_text(jar);
  const idl::StormTopology graph = read_topology(topology);
  idl::SubmitOptions options;
  options.initial_status = idl::TopologyInitialStatus::ACTIVE;
  bool asked = false;  // without an answer
  impl_->ask([&](Client& client) {
    if (asked) {
      // Whether the first call, whose connection broke, was carried out.
      if (lists(client, name)) return;
      throw NimbusError("the connection to Nimbus broke while it took the topology over; submit it again");
    }
    // Another leader has not the jar that the first one got.
    const std::string location = upload(client, bytes, progress);
    asked = true;
    try {
      client.submitTopologyWithOpts(name, location, conf, graph, options);
    } catch (const apache::thrift::TApplicationException&) {
      asked = false;
      throw;
    }
  });
}

std::vector<RunningTopology> NimbusClient::topologies() {
  const auto summaries = impl_->ask([](Client& client) {
    std::vector<idl::TopologySummary> answer;
    client.getTopologySummaries(answer);
    return answer;
  });
  std::vector<RunningTopology> topologies;
  std::transform(summaries.begin(), summaries.end(), std::back_inserter(topologies), running);
  return topologies;
}

std::optional<TopologyDetails> NimbusClient::details(const std::string& name) {
  const auto end = std::chrono::steady_clock::now() + impl_->patience;
  while (true) {
    const auto all = topologies();
    const auto found = std::find_if(all.begin(), all.end(), [&](const auto& one) { return one.name == name; });
    if (found == all.end()) return std::nullopt;
    const auto info = impl_->ask([&](Client& client) -> std::optional<idl::TopologyInfo> {
      idl::TopologyInfo answer;
      try {
        client.getTopologyInfoByName(answer, name);
      } catch (const idl::NotAliveException&) {
        return std::nullopt;  // it ended since it was listed, or this Nimbus has just begun to lead, see order()
      }
      return answer;
    });
    if (info) return as_details(*found, *info);
    if (std::chrono::steady_clock::now() >= end) return std::nullopt;
    std::this_thread::sleep_for(search_pause);
  }
}

std::string NimbusClient::id_of(const std::string& name) {
  for (const auto& topology : topologies()) {
    if (topology.name == name) return topology.id;
  }
  throw NimbusError("no topology \"" + name + "\" runs");
}

std::vector<ComponentCounts> NimbusClient::counts(const std::string& name, const std::string& window) {
  const std::string id = id_of(name);
  const auto page = impl_->ask([&](Client& client) {
    idl::TopologyPageInfo answer;
    client.getTopologyPageInfo(answer, id, window, false);
    return answer;
  });
  std::vector<ComponentCounts> counts;
  for (const auto& [component, stats] : page.id_to_spout_agg_stats) counts.push_back(counts_of(component, stats, true));
  for (const auto& [component, stats] : page.id_to_bolt_agg_stats) counts.push_back(counts_of(component, stats, false));
  return counts;
}

void NimbusClient::activate(const std::string& name) {
  impl_->order(name, [&](Client& client) { client.activate(name); });
}

void NimbusClient::deactivate(const std::string& name) {
  impl_->order(name, [&](Client& client) { client.deactivate(name); });
}

void NimbusClient::rebalance(const std::string& name, std::optional<int> workers,
                             const std::map<std::string, int>& executors, std::chrono::seconds wait) {
  idl::RebalanceOptions options;
  options.__set_wait_secs(static_cast<std::int32_t>(wait.count()));
  if (workers) options.__set_num_workers(*workers);
  if (!executors.empty()) options.__set_num_executors({executors.begin(), executors.end()});
  impl_->order(name, [&](Client& client) { client.rebalance(name, options); });
}

void NimbusClient::kill(const std::string& name, std::chrono::seconds wait) {
  idl::KillOptions options;
  options.__set_wait_secs(static_cast<std::int32_t>(wait.count()));
  const bool was_there = impl_->lists(name);
  try {
    impl_->order(name, [&](Client& client) { client.killTopologyWithOpts(name, options); });
  } catch (const NotAlive&) {
    if (!was_there) throw;  // else the answer to an order that was taken got lost
  }
}

void NimbusClient::set_log_levels(const std::string& name, const std::map<std::string, std::string>& levels,
                                  std::chrono::seconds time_out) {
  const std::string id = id_of(name);
  idl::LogConfig config;
  for (const auto& [logger, level] : levels) {
    idl::LogLevel& changed = config.named_logger_level[logger];
    changed.action = level.empty() ? idl::LogLevelAction::REMOVE : idl::LogLevelAction::UPDATE;
    if (!level.empty()) changed.__set_target_log_level(level);
    changed.__set_reset_log_level_timeout_secs(static_cast<std::int32_t>(time_out.count()));
  }
  config.__isset.named_logger_level = true;
  impl_->ask([&](Client& client) { client.setLogConfig(id, config); });
}

}  // namespace iotcloud::topology::storm
