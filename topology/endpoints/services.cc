#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

std::shared_ptr<brokers::Broker> BrokerPool::get(const std::string& url) {
  const std::lock_guard lock(mutex_);
  std::erase_if(brokers_, [](const auto& entry) { return entry.second.expired(); });
  if (auto broker = brokers_[url].lock()) return broker;
  brokers::BrokerOptions options;
  options.urls = {url};
  options.clock = clock_;
  options.metrics = metrics_;
  std::shared_ptr<brokers::Broker> broker = brokers::make_broker(options);
  brokers_[url] = broker;
  return broker;
}

brokers::Topic topic_of(const discovery::ChannelRecord& channel) {
  const auto property = [&](const char* key) {
    const auto found = channel.properties.find(key);
    return found == channel.properties.end() ? std::string() : found->second;
  };
  std::string name = property("routingKey");
  if (name.empty()) name = property("topic");
  return {property("exchange"), std::move(name), property("durable") == "true"};
}

std::string url_of(const discovery::ChannelRecord& channel, const EndpointServices& services) {
  const auto found = services.broker_urls.find(channel.transport);
  return found == services.broker_urls.end() || found->second.empty() ? channel.broker_url : found->second;
}

}  // namespace iotcloud::topology
