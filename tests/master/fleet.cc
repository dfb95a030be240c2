#include <atomic>
#include <thread>

#include <unistd.h>

#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master::test {

using discovery::DriverRecord;
using discovery::DriverState;
using discovery::OrderRecord;

std::string fresh_registry_url() {
  static std::atomic<int> counter{0};
  return "embedded://master-test-" + std::to_string(getpid()) + "-" + std::to_string(++counter);
}

std::unique_ptr<discovery::Registry> open_registry(const std::string& url) {
  discovery::RegistryOptions options;
  options.url = url;
  return discovery::make_registry(options);
}

std::optional<FakeGateway::Report> FakeGateway::obey(const OrderRecord& order) {
  return Report{order.active ? DriverState::active : DriverState::inactive, ""};
}

FakeGateway::Behaviour FakeGateway::fail(std::string reason) {
  return [reason = std::move(reason)](const OrderRecord&) { return Report{DriverState::failed, reason}; };
}

FakeGateway::Behaviour FakeGateway::say_nothing() {
  return [](const OrderRecord&) { return std::nullopt; };
}

FakeGateway::FakeGateway(const std::string& registry_url, std::string id, Behaviour behaviour)
    : id_(std::move(id)), registry_(open_registry(registry_url)), behaviour_(std::move(behaviour)) {
  discovery::GatewayRecord gateway;
  gateway.id = id_;
  gateway.host = "127.0.0.1";
  gateway.port = 12905;
  gateway.brokers = {"rabbitmq"};
  gateway.since_ms = 1;
  discovery::put(*registry_, paths_.gateway(id_), encode(gateway));
  alive_ = registry_->hold(paths_.gateway_alive(id_), "");
  names_ = registry_->watch_children(
      paths_.orders(id_), [this](const auto& names) { on_names(names.value_or(std::vector<std::string>{})); });
}

FakeGateway::~FakeGateway() {
  names_.reset();
  watches_.clear();
}

void FakeGateway::behave(Behaviour behaviour) {
  std::lock_guard lock(mutex_);
  behaviour_ = std::move(behaviour);
}

DriverRecord FakeGateway::record(const OrderRecord& order, DriverState state, const std::string& reason,
                                 int made_anew) const {
  DriverRecord record;
  record.name =
      order.driver.empty() ? discovery::DriverName(order.plugin.substr(0, order.plugin.find('.'))) : order.driver;
  record.instance = order.instance;
  record.gateway = id_;
  record.state = state;
  record.reason = reason;
  record.since_ms = 1'000 + made_anew;
  record.metadata = order.metadata;
  record.deployment = order.name;
  record.index = order.index;
  record.plugin = order.plugin;
  record.sha256 = order.sha256;
  discovery::ChannelRecord channel;
  channel.name = "kinect";
  channel.transport = "rabbitmq";
  channel.broker_url = "amqp://robot:secret@127.0.0.1:5672/";
  channel.gateway = id_;
  channel.driver = record.name;
  channel.instance = order.instance;
  channel.properties["urls"] = "amqp://127.0.0.2:5672/ " + channel.broker_url;
  record.channels = {channel};
  return record;
}

void FakeGateway::report(const std::string& instance, DriverState state, const std::string& reason, bool starts_again) {
  DriverRecord told;
  {
    std::lock_guard lock(mutex_);
    told = record(orders_.at(instance), state, reason, made_anew_[instance]);
  }
  told.starts_again = starts_again;
  for (const auto& channel : told.channels)
    discovery::put(*registry_, paths_.channel(told.name, discovery::InstanceId(instance), channel.name),
                   encode(channel));
  discovery::put(*registry_, paths_.instance(told.name, discovery::InstanceId(instance)), encode(told));
}

std::vector<OrderRecord> FakeGateway::orders() const {
  std::lock_guard lock(mutex_);
  std::vector<OrderRecord> all;
  for (const auto& [instance, order] : orders_) all.push_back(order);
  return all;
}

int FakeGateway::orders_seen() const {
  std::lock_guard lock(mutex_);
  return seen_;
}

bool FakeGateway::wait_for_orders(std::size_t count) const {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, patience, [&] { return orders_.size() == count; });
}

void FakeGateway::on_names(const std::vector<std::string>& names) {
  for (const auto& instance : names) {
    if (watches_.contains(instance)) continue;
    watches_[instance] = registry_->watch_node(paths_.order(id_, discovery::InstanceId(instance)),
                                               [this, instance](const auto& node) { on_order(instance, node); });
  }
}

void FakeGateway::on_order(const std::string& instance, const std::optional<discovery::Node>& node) {
  std::optional<OrderRecord> gone;
  std::optional<Report> report_now;
  {
    std::lock_guard lock(mutex_);
    if (node) {
      const auto order = discovery::decode_order(node->data, paths_.order(id_, discovery::InstanceId(instance)));
      const auto before = orders_.find(instance);
      if (before != orders_.end() && before->second.properties != order.properties) ++made_anew_[instance];
      orders_[instance] = order;
      ++seen_;
      report_now = behaviour_(order);
    } else if (const auto known = orders_.find(instance); known != orders_.end()) {
      if (behaviour_(known->second)) gone = known->second;  // a silent one does not even take away
      orders_.erase(known);
    }
  }
  changed_.notify_all();
  if (report_now) report(instance, report_now->first, report_now->second);
  if (gone)
    discovery::remove_tree(*registry_, paths_.instance(record(*gone, {}, "", 0).name, discovery::InstanceId(instance)));
}

MasterOptions TestMaster::quick() {
  MasterOptions options;
  options.id = "m1";
  options.address = "127.0.0.1:1111";
  options.outcome_timeout = patience;
  return options;
}

TestMaster::TestMaster(const std::string& registry_url, MasterOptions options)
    : registry_(open_registry(registry_url)), master_(std::make_unique<Master>(*registry_, std::move(options))) {}

bool TestMaster::leads() const {
  return eventually([this] { return master_->status().leading; });
}

void TestMaster::end() {
  master_.reset();
  registry_.reset();
}

}  // namespace iotcloud::master::test
