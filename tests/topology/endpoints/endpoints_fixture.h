#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::topology {

using tests::eventually;

/// Collects the messages of one topic, in place of a driver.
class Mailbox {
 public:
  Mailbox(brokers::Broker& broker, const std::string& topic, bool durable = false) {
    brokers::SubscriptionOptions options;
    subscription_ = broker.subscribe({"", topic, durable}, options, [this](brokers::Delivery delivery) {
      const std::lock_guard lock(mutex_);
      messages_.push_back(delivery.message);
      delivery.settle(brokers::Settlement::accept);
      changed_.notify_all();
    });
  }
  /// \return false if there were fewer within 20 s.
  bool wait_for(std::size_t count) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, tests::patience, [&] { return messages_.size() >= count; });
  }
  std::vector<std::string> texts() {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> all;
    for (const auto& message : messages_) all.emplace_back(message.payload.text());
    return all;
  }
  brokers::Message message(std::size_t i) {
    const std::lock_guard lock(mutex_);
    return messages_.at(i);
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<brokers::Message> messages_;  ///< guarded by mutex_
  std::unique_ptr<brokers::Subscription> subscription_;
};

/// Lets tuples pass while it is open, and holds them while it is closed. Thread safe.
struct Gate {
  static inline std::mutex mutex;
  static inline std::condition_variable changed;
  static inline bool open = true;
  static inline int inside = 0;
  static void set(bool is_open) {
    const std::lock_guard lock(mutex);
    open = is_open;
    changed.notify_all();
  }
  /// Waits until a tuple has reached the gate. \return false if none came in time.
  static bool wait_for_one() {
    return eventually([] {
      const std::lock_guard lock(mutex);
      return inside > 0;
    });
  }
};

/// Answers the sender, or, if the text is "TEXT@ID", the driver instance ID.
class GateBolt final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    {
      std::unique_lock lock(Gate::mutex);
      ++Gate::inside;
      Gate::changed.notify_all();
      Gate::changed.wait(lock, [] { return Gate::open; });
    }
    const auto& text = tuple.get<std::string>("text");
    const auto mark = text.find('@');
    const Value to = mark == std::string::npos ? tuple.at("driverID") : Value(text.substr(mark + 1));
    collector.emit(Values(text.substr(0, mark), to, tuple.at("time")));
  }
};

class Endpoints : public ::testing::Test {
 protected:
  /// \param broker_url empty: an embedded broker.
  explicit Endpoints(std::string broker_url = {}) {
    static int number = 0;
    Gate::open = true;
    Gate::inside = 0;
    const std::string name = "endpoints-test-" + std::to_string(++number);
    url_ = "embedded://" + name;
    broker_url_ = broker_url.empty() ? url_ : std::move(broker_url);
    discovery::RegistryOptions registry;
    registry.url = url_;
    registry.session_timeout = std::chrono::milliseconds(300);
    registry_ = discovery::make_registry(registry);
    brokers::BrokerOptions broker;
    broker.urls = {broker_url_};
    broker_ = brokers::make_broker(broker);
  }

  Worker& run(const std::string& spout_properties = "{}", const std::string& bolt_properties = "{}") {
    const std::string yaml =
        "topology.name: t\nspouts:\n  in:\n    broker: rabbitmq\n    driver: d\n    channel: up\n" +
        std::string("    fields: [text, driverID, time]\n    builder: text\n    properties: ") + spout_properties +
        "\nbolts:\n  gate: {class: Gate, inputs: {from: in}}\n" +
        "  out:\n    broker: rabbitmq\n    driver: d\n    channel: down\n" +
        "    fields: [text, driverID, time]\n    properties: " + bolt_properties + "\n    inputs: {from: gate}\n";
    ComponentRegistry components;
    components.add_bolt<GateBolt>("Gate");
    return run_yaml(yaml, std::move(components));
  }

  /// \param stop ends the worker's wait to be the topology's only one
  Worker& run_yaml(const std::string& yaml, ComponentRegistry components, const std::stop_token& stop = {}) {
    WorkerOptions options{.definition = TopologyDefinition::parse(yaml, "t.yaml"),
                          .components = std::move(components),
                          .library_folders = {},
                          .registry = registry_.get(),
                          .clock = nullptr,
                          .metrics = &metrics_,
                          .fence = std::make_shared<StandstillFence>()};
    workers_.push_back(std::make_unique<Worker>(std::move(options)));
    workers_.back()->start(stop);
    return *workers_.back();
  }

  /// Shows a driver in the registry as a gateway would.
  void show_driver(const std::string& instance, const std::string& transport = "rabbitmq",
                   discovery::DriverState state = discovery::DriverState::active) {
    show_channel(instance, "up", discovery::Direction::out, transport);
    show_channel(instance, "down", discovery::Direction::in, transport);
    put_driver(driver_record(instance, state));
  }
  /// The record of a driver without channels; it is not in the registry.
  static discovery::DriverRecord driver_record(const std::string& instance,
                                               discovery::DriverState state = discovery::DriverState::active) {
    discovery::DriverRecord driver;
    driver.name = "d"_driver;
    driver.instance = discovery::InstanceId(instance);
    driver.gateway = "g"_gateway;
    driver.state = state;
    return driver;
  }
  void put_driver(const discovery::DriverRecord& driver) {
    discovery::put(*registry_, paths_.instance("d"_driver, driver.instance), discovery::encode(driver));
  }
  /// One channel of a driver.
  void show_channel(const std::string& instance, const std::string& name, discovery::Direction direction,
                    const std::string& transport = "rabbitmq") {
    discovery::ChannelRecord channel = channel_record(instance, name, direction, transport);
    channel.properties = {{"routingKey", name}};
    put_channel(channel);
  }
  /// The record of a channel at the fixture's broker. It names no topic yet, and is not in the registry.
  discovery::ChannelRecord channel_record(const std::string& instance, const std::string& name,
                                          discovery::Direction direction,
                                          const std::string& transport = "rabbitmq") const {
    discovery::ChannelRecord channel;
    channel.name = name;
    channel.transport = transport;
    channel.direction = direction;
    channel.broker_url = broker_url_;
    channel.gateway = "g"_gateway;
    channel.driver = "d"_driver;
    channel.instance = discovery::InstanceId(instance);
    return channel;
  }
  void put_channel(const discovery::ChannelRecord& channel) {
    discovery::put(*registry_, paths_.channel("d"_driver, channel.instance, channel.name), discovery::encode(channel));
  }
  static std::string topic(const std::string& instance, const std::string& channel) {
    return "g.d." + instance + "." + channel;
  }
  std::unique_ptr<brokers::Publisher> device(const std::string& instance) {
    return broker_->publisher({"", topic(instance, "up"), false}, many());
  }
  static brokers::PublisherOptions many() {
    brokers::PublisherOptions options;
    options.capacity = 100'000;
    return options;
  }
  static brokers::Message message(const std::string& text, const std::string& instance, std::int64_t time = 7) {
    brokers::Message made;
    made.payload = brokers::Payload::copy(text);
    made.driver_id = instance;
    made.time_ms = time;
    return made;
  }
  double metric(const std::string& name) const {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == name) sum += sample.value;
    }
    return sum;
  }

  std::string url_;         ///< of the registry
  std::string broker_url_;  ///< of the broker
  config::Metrics metrics_;
  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  std::unique_ptr<brokers::Broker> broker_;
  std::vector<std::unique_ptr<Worker>> workers_;  // destroyed first
};

}  // namespace iotcloud::topology
