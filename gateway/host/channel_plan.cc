#include <algorithm>
#include <initializer_list>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/number.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/channel_names.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/gateway/host/plugin.h>

namespace iotcloud::gateway {

namespace {

using drivers::ChannelSpec;

const std::vector<std::string> channel_options = {"capacity", "when_full",   "deadline_ms", "durable",
                                                  "broker",   "shared",      "keep_last",   "priority",
                                                  "interop",  "spool_bytes", "spool_fsync", "spool_full"};
constexpr std::string_view prefix = "channel.";

std::size_t whole_number(const std::string& property, const std::string& text, std::size_t min,
                         std::size_t max = 1'000'000'000) {
  const auto value = config::parse_number<std::size_t>(text);
  if (!value || *value < min || *value > max) {
    throw config::Error(
        fmt::format("property \"{}\" is \"{}\"; it must be a whole number from {} to {}", property, text, min, max));
  }
  return *value;
}

bool yes_or_no(const std::string& property, const std::string& text) {
  if (text == "true") return true;
  if (text == "false") return false;
  throw config::Error(fmt::format("property \"{}\" is \"{}\"; it must be true or false", property, text));
}

/// The value that belongs to an option's word. \throws config::Error that lists the allowed words.
template <typename Value>
Value one_of(const std::string& property, const std::string& text,
             std::initializer_list<std::pair<const char*, Value>> words) {
  std::vector<std::string> names;
  for (const auto& [name, value] : words) {
    if (text == name) return value;
    names.emplace_back(name);
  }
  throw config::Error(
      fmt::format("property \"{}\" is \"{}\"; it must be one of: {}", property, text, fmt::join(names, ", ")));
}

void apply_spool(drivers::Spool& spool, const std::string& option, const std::string& property,
                 const std::string& value) {
  using drivers::Spool;
  if (option == "spool_bytes") {
    spool.bytes = whole_number(property, value, 65'536, std::size_t{1} << 50);
  } else if (option == "spool_fsync") {
    spool.fsync = one_of<Spool::Fsync>(
        property, value,
        {{"never", Spool::Fsync::never}, {"interval", Spool::Fsync::interval}, {"always", Spool::Fsync::always}});
  } else {
    spool.full = one_of<Spool::Full>(property, value,
                                     {{"block", Spool::Full::block}, {"drop_oldest", Spool::Full::drop_oldest}});
  }
}

void apply(ChannelSpec& spec, const std::string& option, const std::string& property, const std::string& value) {
  if (option == "capacity") {
    spec.capacity = whole_number(property, value, 1);
  } else if (option == "deadline_ms") {
    spec.deadline = std::chrono::milliseconds(whole_number(property, value, 0));
  } else if (option == "keep_last") {
    spec.keep_last = whole_number(property, value, 0);
  } else if (option == "interop") {
    if (value != "java") throw config::Error(fmt::format("property \"{}\" is \"{}\"; it can be java", property, value));
    spec.properties["interop"] = value;
  } else if (option == "priority") {
    spec.priority = static_cast<std::uint8_t>(whole_number(property, value, 0, 9));
  } else if (option == "durable") {
    spec.durable = yes_or_no(property, value);
  } else if (option == "shared") {
    spec.shared = yes_or_no(property, value);
  } else if (option == "broker") {
    spec.broker = value;
  } else if (option == "when_full") {
    spec.when_full = one_of<drivers::WhenFull>(property, value,
                                               {{"keep_newest", drivers::WhenFull::keep_newest},
                                                {"block", drivers::WhenFull::block},
                                                {"spool", drivers::WhenFull::spool}});
  } else {
    apply_spool(spec.spool, option, property, value);
  }
}

/// Refuses spool options of a channel that has no spool.
void check_spool_options(const drivers::PropertyMap& properties, const ChannelSpec& spec) {
  if (spec.when_full == drivers::WhenFull::spool) return;
  for (const char* option : {"spool_bytes", "spool_fsync", "spool_full"}) {
    const std::string property = fmt::format("{}{}.{}", prefix, spec.name, option);
    if (!properties.contains(property)) continue;
    throw config::Error(
        fmt::format("property \"{}\" says how the channel is spooled, but it is not: set {}{}.when_full "
                    "to spool as well",
                    property, prefix, spec.name));
  }
}

void apply_overrides(const drivers::PropertyMap& properties, std::vector<ChannelSpec>& specs) {
  for (const auto& [property, value] : properties) {
    if (!property.starts_with(prefix)) continue;
    const auto dot = property.rfind('.');
    const std::string option = property.substr(dot + 1);
    const std::string channel =
        dot > prefix.size() ? property.substr(prefix.size(), dot - prefix.size()) : std::string{};
    const auto spec = std::find_if(specs.begin(), specs.end(), [&](const auto& s) { return s.name == channel; });
    if (spec == specs.end()) {
      std::vector<std::string> names;
      names.reserve(specs.size());
      for (const auto& s : specs) names.push_back(s.name);
      throw config::Error(fmt::format("property \"{}\": the driver has no channel \"{}\"; it has {}", property, channel,
                                      fmt::join(names, ", ")));
    }
    if (std::find(channel_options.begin(), channel_options.end(), option) == channel_options.end()) {
      const std::string near = config::nearest(option, channel_options);
      throw config::Error(fmt::format("property \"{}\": \"{}\" is no option of a channel; {}", property, option,
                                      near.empty() ? fmt::format("they are {}", fmt::join(channel_options, ", "))
                                                   : fmt::format("did you mean \"{}\"?", near)));
    }
    apply(*spec, option, property, value);
  }
  for (const auto& spec : specs) check_spool_options(properties, spec);
}

const BrokerPlan& broker_of(const ChannelSpec& spec, const std::vector<BrokerPlan>& brokers) {
  if (brokers.empty())
    throw config::Error("the gateway has no broker; name one under \"brokers\" in its configuration");
  if (spec.broker.empty()) return brokers.front();
  for (const auto& broker : brokers) {
    if (broker.name == spec.broker) return broker;
  }
  std::vector<std::string> names;
  names.reserve(brokers.size());
  for (const auto& broker : brokers) names.push_back(broker.name);
  throw config::Error(fmt::format("channel \"{}\" wants the broker \"{}\"; this gateway has {}", spec.name, spec.broker,
                                  fmt::join(names, ", ")));
}

/// Refuses names that readers would take for whole wire names, as older gateways wrote them.
void check_raw(const discovery::ChannelRecord& record) {
  const std::string beginning = discovery::wire_prefix(record);
  for (const char* property : {"routingKey", "queueName", "topic"}) {
    const auto found = record.properties.find(property);
    if (found == record.properties.end() || !found->second.starts_with(beginning)) continue;
    throw config::Error(fmt::format(
        "the channel's property \"{}\" is \"{}\"; readers put \"{}\" before it themselves, so leave that out", property,
        found->second, beginning));
  }
}

/// With `interop: java` the channel has the one queue that the original's programs read and declare.
void make_room_for_the_original(PlannedChannel& channel, const BrokerPlan& broker) {
  const auto interop = channel.spec.properties.find("interop");
  channel.own_queue = interop != channel.spec.properties.end() && interop->second == "java";
  if (!channel.own_queue || broker.type != "rabbitmq") return;
  if (channel.spec.durable) {
    throw config::Error(
        fmt::format("channel \"{}\" is durable and has \"interop\" java, but programs of the original declare an "
                    "exchange and a queue "
                    "that are not durable, which RabbitMQ would refuse them; leave one of the two out",
                    channel.spec.name));
  }
  channel.original_queue = discovery::original_queue(channel.record);
}

PlannedChannel plan(const discovery::GatewayId& gateway, const discovery::DriverName& driver,
                    const InstanceSpec& instance, const ChannelSpec& spec) {
  check_name("channel name", spec.name);
  const BrokerPlan& broker = broker_of(spec, instance.brokers);
  if (broker.type == "kafka" && !spec.shared) {
    throw config::Error(
        fmt::format("channel \"{}\" is exclusive, but Kafka carries shared channels only; deploy with --property "
                    "channel.{}.shared=true, or use another broker",
                    spec.name, spec.name));
  }
  const auto given = [&](const char* key, const std::string& fallback) {
    const auto found = spec.properties.find(key);
    return found == spec.properties.end() || found->second.empty() ? fallback : found->second;
  };
  PlannedChannel channel;
  channel.spec = spec;
  auto& record = channel.record;
  record.gateway = gateway;
  record.driver = driver;
  record.instance = instance.order.instance;
  record.shared = spec.shared;
  record.properties["durable"] = spec.durable ? "true" : "false";
  // All names stand in the record as the driver gave them, also those that this broker does not use.
  for (const char* name : {"exchange", "routingKey", "queueName", "topic"}) {
    if (const std::string own = given(name, ""); !own.empty()) record.properties[name] = own;
  }
  if (broker.type == "kafka") {
    record.properties["topic"] = given("topic", spec.name);
  } else {
    const auto of_broker = broker.options.properties.find("exchange");
    const std::string usual = spec.durable ? driver + ".durable" : driver.str();
    channel.topic.exchange =
        given("exchange", of_broker == broker.options.properties.end() ? usual : of_broker->second);
    record.properties["exchange"] = channel.topic.exchange;
    record.properties["routingKey"] = given("routingKey", given("queueName", spec.name));
    record.properties["queueName"] = given("queueName", given("routingKey", spec.name));
  }
  channel.address = {broker.name, spec.shared ? broker.shared_urls : broker.exclusive_urls};
  const auto& urls = channel.address.urls;
  if (urls.empty()) throw config::Error(fmt::format("the broker \"{}\" has no URL", broker.name));
  record.broker_url = urls.front();
  if (urls.size() > 1) record.properties["urls"] = fmt::format("{}", fmt::join(urls, " "));
  check_raw(record);
  channel.topic.name = discovery::wire_name(record);
  channel.topic.durable = spec.durable;
  make_room_for_the_original(channel, broker);
  record.name = spec.name;
  record.transport = broker.name;
  record.direction = spec.direction == drivers::Direction::in ? discovery::Direction::in : discovery::Direction::out;
  channel.broker = broker.options;
  if (spec.priority != brokers::normal_priority) record.properties["priority"] = std::to_string(spec.priority);
  return channel;
}

}  // namespace

std::vector<PlannedChannel> plan_channels(const discovery::GatewayId& gateway, const discovery::DriverName& driver,
                                          const InstanceSpec& instance, std::vector<ChannelSpec> wanted) {
  apply_overrides(instance.order.properties, wanted);
  std::vector<PlannedChannel> planned;
  std::set<std::string> names;
  for (const auto& spec : wanted) {
    if (!names.insert(spec.name).second) {
      throw config::Error(fmt::format("the driver asks for two channels named \"{}\"", spec.name));
    }
    planned.push_back(plan(gateway, driver, instance, spec));
  }
  return planned;
}

}  // namespace iotcloud::gateway
