#include <algorithm>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/route_table.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

}  // namespace

RouteTable::RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint)
    : services_(std::move(services)), component_(std::move(component)), endpoint_(std::move(endpoint)) {}

void RouteTable::join() {
  const std::lock_guard joining(joining_);
  if (tasks_++ > 0) return;
  {
    const std::lock_guard lock(mutex_);
    meters_ = std::make_shared<SenderMeters>(
        *services_->metrics, config::Labels{{"topology", services_->topology}, {"component", component_}});
  }
  discovery::DriverDirectory::Callbacks callbacks;
  callbacks.on_channel = [this](const discovery::ChannelRecord& channel) { on_channel(channel); };
  callbacks.on_channel_gone = [this](const discovery::ChannelRecord& channel) { on_channel_gone(channel); };
  directory_ = std::make_unique<discovery::DriverDirectory>(*services_->registry, services_->paths, endpoint_.driver,
                                                            endpoint_.channel, std::move(callbacks));
}

void RouteTable::leave(const OutputCollector& collector) {
  const std::lock_guard joining(joining_);
  std::set<std::shared_ptr<ChannelSender>> senders;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, route] : routes_) senders.insert(route.sender);
  }
  for (const auto& sender : senders) sender->forget(collector);
  if (--tasks_ > 0) return;
  directory_.reset();  // no callback runs any more
  {
    const std::lock_guard lock(mutex_);
    routes_.clear();
    senders_.clear();
  }
  for (const auto& sender : senders) sender->close();
}

RouteTable::Route RouteTable::find(const std::string& driver_id) const {
  const std::lock_guard lock(mutex_);
  const auto found = routes_.find(driver_id);
  return found == routes_.end() ? Route{} : found->second;
}

void RouteTable::reset_timeouts() {
  std::set<std::shared_ptr<ChannelSender>> senders;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, route] : routes_) senders.insert(route.sender);
  }
  for (const auto& sender : senders) sender->reset_timeouts();
}

bool RouteTable::fits(const discovery::ChannelRecord& channel) {
  std::string problem;
  if (channel.direction != discovery::Direction::in) {
    problem = "it brings messages from the driver";
  } else if (channel.transport != endpoint_.broker) {
    problem =
        "it goes over the broker \"" + channel.transport + "\", and the topology says \"" + endpoint_.broker + "\"";
  } else if (topic_of(channel).name.empty()) {
    problem = "its record names no topic";
  }
  if (problem.empty()) return true;
  const std::lock_guard lock(mutex_);
  if (complained_.insert(channel.gateway + problem).second) {
    logger.warn("{}: nothing is sent to channel {} of driver {} on gateway {}: {}", component_, channel.name,
                channel.driver, channel.gateway, problem);
  }
  return false;
}

void RouteTable::on_channel(const discovery::ChannelRecord& channel) {
  auto sender = fits(channel) ? sender_for(channel) : nullptr;
  if (!sender) {
    on_channel_gone(channel);
    return;
  }
  std::shared_ptr<ChannelSender> replaced;
  {
    const std::lock_guard lock(mutex_);
    Route& route = routes_[channel.instance];
    if (route.sender != sender) replaced = std::exchange(route.sender, sender);
    route.gateway = channel.gateway;
    for (const auto& [id, other] : routes_) {
      if (other.sender == replaced) replaced = nullptr;  // others still use it
    }
  }
  if (replaced) replaced->close();
}

void RouteTable::on_channel_gone(const discovery::ChannelRecord& channel) {
  std::shared_ptr<ChannelSender> unused;
  {
    const std::lock_guard lock(mutex_);
    const auto found = routes_.find(channel.instance);
    if (found == routes_.end()) return;
    unused = std::move(found->second.sender);
    routes_.erase(found);
    for (const auto& [id, other] : routes_) {
      if (other.sender == unused) return;
    }
  }
  unused->close();
}

/// The topic's sender; a new one when there is none yet. Null, which is said once, when its broker cannot be used.
std::shared_ptr<ChannelSender> RouteTable::sender_for(const discovery::ChannelRecord& channel) {
  const SenderKey key(url_of(channel, *services_), topic_of(channel));
  std::shared_ptr<SenderMeters> meters;
  {
    const std::lock_guard lock(mutex_);
    std::erase_if(senders_, [](const auto& entry) { return entry.second.expired(); });
    const auto found = senders_.find(key);
    if (found != senders_.end()) {
      if (auto sender = found->second.lock()) return sender;
    }
    meters = meters_;
  }
  brokers::PublisherOptions options;
  options.when_full = endpoint_.sending.keep_newest ? brokers::WhenFull::keep_newest : brokers::WhenFull::block;
  options.capacity = static_cast<std::size_t>(endpoint_.sending.capacity);
  options.deadline = endpoint_.sending.deadline;
  try {
    auto sender = ChannelSender::open(services_->brokers->get(key.first), key.second, options, std::move(meters));
    const std::lock_guard lock(mutex_);
    senders_[key] = sender;
    return sender;
  } catch (const config::Error& error) {
    const std::lock_guard lock(mutex_);
    if (complained_.insert(key.first).second) {
      logger.error("{}: nothing can be sent to {}: {}", component_, key.second.name, error.what());
    }
    return nullptr;
  }
}

}  // namespace iotcloud::topology
