// A console in front of a fleet that is made up: for tests in a browser, which need neither servers nor daemons.
//
// usage: console_stand TOKENS INSTANCES [OTHER_CONSOLE] [--pages FOLDER KEY]
// Prints its address, then each order that it gets, as JSON. Obeys lines on stdin, and ends at their end:
//   state ID STATE     an instance has that state from now on
//   gone ID            an instance is undeployed
// Names, reasons, metadata, logs and payloads have what a hostile driver would write there.
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/master/console/console.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/tests/master/console/simulated_turtle.h>
#include <iotcloud/tests/master/console/stand_ways.h>

namespace iotcloud::master {
namespace {

using Json = nlohmann::json;
using discovery::DriverState;

const std::string hostile = R"("><img src=x onerror="window.hacked=1"><script>window.hacked=1</script>{{7*7}})";
constexpr std::int64_t begun_ms = 1'790'000'000'000;

class Fleet {
 public:
  explicit Fleet(int instances) {
    for (int number = 1; number <= instances; ++number) {
      discovery::DriverRecord driver;
      driver.instance = discovery::InstanceId(fmt::format("{:032x}", number));
      driver.gateway = discovery::GatewayId(fmt::format("gateway-{}", 1 + number % 4));
      driver.name = discovery::DriverName(number % 3 == 0 ? "turtle" : "meter");
      driver.deployment = number % 3 == 0 ? "robot" : "meter";
      driver.index = number;
      driver.state = number % 500 == 7  ? DriverState::failed
                     : number % 50 == 8 ? DriverState::inactive
                                        : DriverState::active;
      if (driver.state == DriverState::failed) driver.reason = "the device does not answer";
      driver.since_ms = begun_ms + std::int64_t{number} * 1000;
      driver.metadata = {{"site", number % 2 == 0 ? "lab" : "roof"}};
      if (number % 2 == 0) {  // each at a place of its own, but for 4 and 6
        const int place = number == 6 ? 4 : number;
        driver.metadata["location"] =
            fmt::format("{:.3f},{:.3f}", -50 + place * 37 % 1200 / 10.0, -170 + place * 53 % 3400 / 10.0);
      }
      if (number == 1) {
        driver.deployment = hostile;
        driver.reason = hostile;
        driver.metadata[hostile] = hostile;
      }
      if (number == 9) driver.made_by = "rule " + hostile;
      discovery::ChannelRecord channel;
      channel.name = number == 1 ? hostile : "data";
      channel.transport = "rabbitmq";
      channel.broker_url = "amqp://guest:secret@lab1";
      driver.channels.push_back(channel);
      if (number == 2) {
        channel.name = "control";
        channel.direction = discovery::Direction::in;
        driver.channels.push_back(channel);
      }
      drivers_[driver.instance] = driver;
    }
  }

  std::vector<discovery::DriverRecord> drivers() const {
    std::vector<discovery::DriverRecord> all;
    const config::MutexLock lock(mutex_);
    for (const auto& [instance, driver] : drivers_) all.push_back(driver);
    return all;
  }
  void set(const std::string& instance, DriverState state) {
    const config::MutexLock lock(mutex_);
    if (state == DriverState::undeployed)
      drivers_.erase(discovery::InstanceId(instance));
    else if (const auto found = drivers_.find(discovery::InstanceId(instance)); found != drivers_.end())
      found->second.state = state;
  }

 private:
  mutable config::Mutex mutex_;
  std::map<discovery::InstanceId, discovery::DriverRecord> drivers_ IOTCLOUD_GUARDED_BY(mutex_);
};

std::vector<discovery::GatewayStatus> gateways() {
  std::vector<discovery::GatewayStatus> all;
  for (int number = 1; number <= 5; ++number) {
    discovery::GatewayStatus gateway;
    gateway.record.id = discovery::GatewayId(fmt::format("gateway-{}", number));
    gateway.record.host = fmt::format("lab{}", number);
    gateway.record.port = 12'905;
    gateway.record.brokers = {"rabbitmq"};
    gateway.record.since_ms = begun_ms;
    gateway.alive = number != 5;
    if (number == 2) gateway.record.trouble = gateway.frozen = hostile;
    gateway.draining = number == 4;
    if (number == 3) {
      gateway.record.trouble =
          "the broker rabbitmq (amqp://lab1) is away since 2026-09-21T14:00:00Z: refused; instance " +
          fmt::format("{:032x}", 2) + " hangs: a callback of its driver has not returned since 2026-09-21T14:00:00Z; " +
          "instance " + fmt::format("{:032x}", 6) + " drops messages: channel " + hostile +
          " since 2026-09-21T14:00:00Z, dropped: superseded";
    }
    all.push_back(gateway);
  }
  return all;
}

std::vector<discovery::TopologyStatus> topologies() {
  discovery::TopologyStatus topology;
  topology.record.name = discovery::TopologyName("follow");
  topology.record.since_ms = begun_ms;
  topology.record.spouts = {"kinect"};
  topology.record.bolts = {"decode", "decide", hostile, "commands"};
  discovery::WorkerRecord worker;
  worker.name = "lab1-4711";
  worker.host = "lab1";
  worker.pid = 4711;
  worker.http = "127.0.0.1:9300";
  worker.state = "active";
  worker.since_ms = begun_ms;
  topology.workers = {worker};
  return {topology};
}

/// The page of a worker; its counts grow with each reading.
std::string worker_page() {
  static std::atomic<int> read{0};
  const int now = 1000 + 12 * ++read;  // which the console writes in full for as long as a browser test may take
  const auto latency = [&](double first) {
    return Json{
        {"count", now},
        {"p50_us", first * 2},
        {"p99_us", first * 9},
        {"max_us", first * 20},
        {"buckets",
         {{first, now / 4}, {first * 1.19, now / 3}, {first * 2, now / 3}, {first * 4, now / 20}, {first * 16, 3}}}};
  };
  const Json none{{"count", 0}, {"p50_us", 0.0}, {"p99_us", 0.0}, {"max_us", 0.0}, {"buckets", Json::array()}};
  Json components = Json::array(), tasks = Json::array();
  const std::vector<std::pair<std::string, double>> parts{
      {"kinect", 0.03}, {"decode", 0.86}, {"decide", 0.55}, {hostile, 0.0}, {"commands", 0.04}};
  std::string from;
  for (const auto& [id, capacity] : parts) {
    const bool spout = from.empty();
    Json inputs = Json::array(), streams = Json::object(), of_streams = Json::object(), of_inputs = Json::array();
    streams["default"] = {"frame", "driverID"};
    if (!spout)
      inputs.push_back({{"from", from}, {"stream", "default"}, {"grouping", "fields"}, {"fields", {"driverID"}}});
    if (id == "commands") {
      inputs.push_back({{"from", "decode"}, {"stream", "alerts"}, {"grouping", "all"}, {"fields", Json::array()}});
      const int alerts = now / 6;
      of_inputs = {{{"from", from},
                    {"stream", "default"},
                    {"executed", now - alerts},
                    {"acked", now - alerts},
                    {"failed", 0},
                    {"late", 0}},
                   {{"from", "decode"},
                    {"stream", "alerts"},
                    {"executed", alerts},
                    {"acked", alerts - 7},
                    {"failed", 0},
                    {"late", 0}}};
    }
    if (id == "decode") {  // of six tuples one goes to the stream "alerts"
      streams["alerts"] = Json::array({"why"});
      of_streams = {{"default", {{"emitted", 5 * now / 6}, {"transferred", 5 * now / 6}}},
                    {"alerts", {{"emitted", now / 6}, {"transferred", 4 * now / 6}}}};
    }
    components.push_back({{"id", id},
                          {"kind", spout ? "spout" : "bolt"},
                          {"parallelism", spout ? 1 : 2},
                          {"tasks", spout ? 1 : 4},
                          {"inputs", inputs},
                          {"streams", streams}});
    for (int number = 0; number < (spout ? 1 : 4); ++number) {
      tasks.push_back({{"component", id},
                       {"task", number},
                       {"emitted", now},
                       {"transferred", now},
                       {"streams", of_streams},
                       {"inputs", of_inputs},
                       {"executed", now},
                       {"acked", id == "commands" ? now - 7 : now},
                       {"failed", 0},
                       {"timed_out", 0},
                       {"late", id == hostile ? now / 20 : 0},
                       {"superseded", 2},
                       {"errors", id == hostile ? 3 : 0},
                       {"queue_depth", 1},
                       {"pending", spout ? 2 : 0},
                       {"oldest_s", 0.0},
                       {"capacity", capacity},
                       {"window_tuples", id == "decide" ? Json(40 + number) : Json()},
                       {"state_entries", id == "decide" ? Json(3) : Json()},
                       {"state_bytes", id == "decide" ? Json(2048) : Json()},
                       {"execute", spout ? none : latency(180)},
                       {"process", spout ? none : latency(190)},
                       {"complete", spout ? latency(900) : none},
                       {"last_error", id == hostile ? hostile : ""}});
    }
    from = id;
  }
  return Json{
      {"topology", "follow"},
      {"worker", "lab1-4711"},
      {"active", true},
      {"brokers",
       {{{"broker", "rabbitmq"}, {"url", "amqp://lab1"}, {"state", "connected"}, {"since_ms", begun_ms}, {"why", ""}}}},
      {"arrivals", {{{"component", "kinect"}, {"age_s", 0.02}, {"backlog", 3}, {"topic", hostile}, {"most", 3}}}},
      {"troubles", Json::array()},
      {"components", components},
      {"tasks", tasks}}
      .dump();
}

/// A channel that has lost messages.
Json channel_state(const Json& name) {
  return {{"name", name},         {"direction", true},
          {"shared", false},      {"broker", "rabbitmq"},
          {"url", "amqp://lab1"}, {"broker_state", "connected"},
          {"waiting", 1},         {"oldest_ms", 2},
          {"done", 1200},         {"lost", {{"dropped: superseded", 7}, {"refused: " + hostile, 1}}}};
}

/// Keeps the roles as the API does, and tells the test of orders.
class StandCalls final : public ConsoleCalls {
 public:
  StandCalls(Fleet& fleet, std::shared_ptr<security::TokenKeeper> tokens) : fleet_(fleet), tokens_(std::move(tokens)) {}

  std::string authenticate(const ConsoleCaller&, const std::string& token) override {
    return tokens_->holder(token, "") ? "" : "that is nobody's token here";
  }

  std::string call(const ConsoleCaller& caller, const std::string& call, const std::string& json) override {
    const auto given = Json::parse(json);
    if (call == "order" || call == "topology") return order(caller, call, given);
    if (call == "history") {
      return Json{{"changes",
                   {{{"time_ms", begun_ms},
                     {"gateway", "gateway-1"},
                     {"instance", "00000000000000000000000000000001"},
                     {"driver", "meter"},
                     {"state", "active"},
                     {"reason", hostile}}}},
                  {"silent", {{"gateway-5", "it is lost"}}}}
          .dump();
    }
    if (call == "log") {
      const bool first = given.at("position").get<std::string>().empty();
      return Json{{"text", first ? "a line\n" + hostile + "\n" : ""}, {"position", "1"}}.dump();
    }
    if (call == "look" && given.value("every_ms", 0) > 0)
      return timed_look(given.at("channel") == "control", hostile).dump();
    if (call == "look" && (given.at("channel") == "kinect" || given.at("channel") == "control"))
      return turtle_.look(given);
    if (call == "look") {
      static std::atomic<int> number{0};
      const int now = ++number;
      // In base64: {"depth":[1,2]}, then 00 ff 00, then the hostile text, which is no JSON.
      const char* const payloads[] = {"eyJkZXB0aCI6WzEsMl19", "AP8A",
                                      "Ij48aW1nIHNyYz14IG9uZXJyb3I9IndpbmRvdy5oYWNrZWQ9MSI+"};
      Json messages = Json::array();
      if (given.at("most") != 0)
        messages.push_back({{"number", now},
                            {"seen_ms", begun_ms},
                            {"size", 15},
                            {"payload", payloads[now % 3]},
                            {"properties", {{hostile, hostile}}}});
      return Json{{"state", "active"},   {"elapsed_us", now * 100'000},
                  {"count", now * 5},    {"bytes", now * 75},
                  {"missed", 0},         {"smallest", 15},
                  {"largest", 15},       {"channels", {channel_state(given.at("channel"))}},
                  {"messages", messages}}
          .dump();
    }
    if (call == "worker" && given.at("target").get<std::string>().starts_with("/trace?"))
      return trace_page(given.at("target").get<std::string>().find(fmt::format("{:032x}", 2)) != std::string::npos,
                        hostile)
          .dump();
    if (call == "worker" && given.at("target") == "/units") return units_page(hostile).dump();
    if (call == "worker") return tap(rpc::read_target(given.at("target").get<std::string>()).query);
    if (call == "order_of")
      return Json{
          {"plugin", "meter.so"}, {"manager", hostile}, {"properties", {{hostile, hostile}, {"password", "***"}}}}
          .dump();
    if (call == "plugins") {
      const auto plugin = [](const std::string& file, const std::string& sha256) {
        return Json{{"gateway", "gateway-2"},
                    {"plugin",
                     {{"file", file},
                      {"sha256", sha256},
                      {"sent", file != "meter.so"},
                      {"signed_by", hostile},
                      {"signed_version", 3},
                      {"problem", ""}}}};
      };
      return Json{{"plugins",
                   {plugin("meter.so", std::string(64, 'a')), plugin("meter-2.so", std::string(64, 'b')),
                    plugin(hostile, std::string(64, 'c'))}},
                  {"silent", Json::object()}}
          .dump();
    }
    throw config::Error("the console has no call " + call);
  }

 private:
  /// As a worker, knows a tap by its id: one that goes on is that of its first component.
  std::string tap(const std::map<std::string, std::string>& query) {
    const auto word = [&](const char* key) {
      const auto found = query.find(key);
      return found == query.end() ? std::string() : found->second;
    };
    const config::MutexLock lock(taps_mutex_);
    if (!word("end").empty()) {
      taps_.erase(word("id"));
      return "{}";
    }
    const auto component = taps_.try_emplace(word("id"), word("component")).first->second;
    return Json{
        {"missed", 0},
        {"samples",
         {{{"time_ms", begun_ms},
           {"task", 1},
           {"source", component},
           {"stream", word("stream").empty() ? "default" : word("stream")},
           {"fields", {{"x", hostile}, {"taps", taps_.size()}, {"data", {{"bytes", 3}, {"hex", "89 50 ff"}}}}}}}}}
        .dump();
  }

  std::string order(const ConsoleCaller& caller, const std::string& call, const Json& given) {
    const auto role = tokens_->role_of(*caller.holder);
    const auto name = call == "order" ? given.at("order").get<std::string>() : given.at("change").get<std::string>();
    if (role < (name == "undeploy" ? security::Role::admin : security::Role::operating)) {
      return Json{
          {"done", false},
          {"refused", true},
          {"leader", ""},
          {"outcomes", Json::array()},
          {"summary", caller.holder->name + " is " + security::to_string(*role) + ", which is not enough for " + name}}
          .dump();
    }
    std::cout << "ORDER " << given.dump() << std::endl;
    if (call == "order") {
      const std::map<std::string, DriverState> results{{"start", DriverState::active},
                                                       {"restart", DriverState::active},
                                                       {"stop", DriverState::inactive},
                                                       {"undeploy", DriverState::undeployed}};
      if (const auto result = results.find(name); result != results.end())
        for (const auto& instance : given.at("with").at("instances"))
          fleet_.set(instance.get<std::string>(), result->second);
    }
    return Json{{"done", true}, {"refused", false}, {"leader", ""}, {"summary", "done"}, {"outcomes", Json::array()}}
        .dump();
  }

  Fleet& fleet_;
  const std::shared_ptr<security::TokenKeeper> tokens_;
  SimulatedTurtle turtle_;
  config::Mutex taps_mutex_;
  std::map<std::string, std::string> taps_ IOTCLOUD_GUARDED_BY(taps_mutex_);  ///< components by the taps' ids
};

/// Takes "--pages FOLDER KEY" out of the words.
PagePluginSettings take_pages(std::vector<std::string>& words) {
  const auto option = std::find(words.begin(), words.end(), "--pages");
  if (option == words.end()) return {};
  PagePluginSettings pages{{option[1]},
                           std::make_shared<security::TrustedKeys>(security::TrustedKeys::Options{true, {option[2]}})};
  words.erase(option, option + 3);
  return pages;
}

int run(const std::string& tokens, int instances, std::vector<std::string> others) {
  Fleet fleet(instances);
  const auto keeper = std::make_shared<security::TokenKeeper>(tokens);
  StandCalls calls(fleet, keeper);
  Live::Source source;
  source.status = [] {
    MasterStatus status;
    status.id = "master-1";
    status.leading = true;
    status.epoch = 3;
    return status;
  };
  source.drivers = [&] { return fleet.drivers(); };
  source.gateways = gateways;
  source.topologies = topologies;
  source.carried = [calls = std::uint64_t{0}]() mutable {  // 2 of 3 messages are answered within 1.3 ms
    ++calls;
    return std::vector<CarriedByGateway>{
        {discovery::GatewayId("gateway-1"), {"turtle.so", {}, 300 * calls, 200 * calls, {{1310.72, 200 * calls}}}}};
  };
  source.worker_page = [](const auto&, const auto&) { return worker_page(); };
  Console::Options options;
  options.settings.pages.address = "127.0.0.1:0";
  options.settings.page_plugins = take_pages(others);
  options.settings.others = others;
  options.id = others.empty() ? "master-2" : "master-1";
  options.tokens = keeper;
  options.live.look = std::chrono::milliseconds(200);
  options.live.pages = options.live.sample = std::chrono::milliseconds(1'000);
  options.live.remember = std::chrono::milliseconds(2'000);
  options.live.beat = std::chrono::milliseconds(1'000);
  const Console console(options, source, calls);
  std::cout << console.url() << std::endl;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::string word, instance, state;
    words >> word >> instance >> state;
    fleet.set(instance, word == "gone" ? DriverState::undeployed : discovery::parse_driver_state(state));
  }
  return 0;
}

}  // namespace
}  // namespace iotcloud::master

int main(int count, char** words) {
  if (count < 3) {
    std::cerr << "usage: console_stand TOKENS INSTANCES [OTHER_CONSOLE] [--pages FOLDER KEY]\n";
    return 2;
  }
  return iotcloud::master::run(words[1], std::atoi(words[2]), std::vector<std::string>(words + 3, words + count));
}
