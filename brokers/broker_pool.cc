#include "iotcloud/brokers/broker_pool.h"

#include <algorithm>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers {

void BrokerAddress::prefer(const std::string& url) {
  if (urls.size() < 2) return;
  try {
    const BrokerUrl wanted = parse_broker_url(url);
    const auto found = std::find_if(urls.begin(), urls.end(), [&](const std::string& one) {
      const BrokerUrl server = parse_broker_url(one);
      return server.host == wanted.host && (server.port == wanted.port || server.port == 0 || wanted.port == 0);
    });
    if (found != urls.end()) std::rotate(urls.begin(), found, urls.end());
  } catch (const config::Error&) {
    return;
  }
}

std::shared_ptr<Broker> BrokerPool::get(const BrokerAddress& address, const BrokerOptions& how) {
  const config::MutexLock lock(mutex_);
  std::erase_if(brokers_, [](const auto& entry) { return entry.second.expired(); });
  if (auto broker = brokers_[address].lock()) return broker;
  BrokerOptions options = how;
  options.urls = address.urls;
  options.clock = clock_;
  options.metrics = metrics_;
  std::shared_ptr<Broker> broker = make_broker(options);
  brokers_[address] = broker;
  return broker;
}

std::vector<std::pair<BrokerAddress, std::shared_ptr<Broker>>> BrokerPool::in_use() {
  std::vector<std::pair<BrokerAddress, std::shared_ptr<Broker>>> brokers;
  const config::MutexLock lock(mutex_);
  for (const auto& [address, entry] : brokers_) {
    if (auto broker = entry.lock()) brokers.emplace_back(address, std::move(broker));
  }
  return brokers;
}

}  // namespace iotcloud::brokers
