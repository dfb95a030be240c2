#include "iotcloud/brokers/broker_pool.h"

namespace iotcloud::brokers {

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

}  // namespace iotcloud::brokers
