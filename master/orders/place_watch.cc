#include <algorithm>
#include <utility>

#include <iotcloud/config/error.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/place_watch.h>

namespace iotcloud::master {

PlaceWatch::PlaceWatch(discovery::Registry& registry, const discovery::Paths& paths, discovery::TopologyName topology)
    : registry_(registry), paths_(paths), topology_(std::move(topology)) {
  names_ = registry_.watch_children(paths_.pools, [this](const auto& names) { on_pools(names); });
}

PlaceWatch::~PlaceWatch() {
  names_.reset();  // from now on nobody else uses guards_
  guards_.clear();
}

void PlaceWatch::on_pools(const std::optional<std::vector<std::string>>& names) {
  const auto now = names.value_or(std::vector<std::string>());
  const auto is_gone = [&](const auto& one) { return std::find(now.begin(), now.end(), one.first) == now.end(); };
  std::erase_if(guards_, is_gone);
  for (const auto& name : now) {
    auto& guard = guards_[name];
    if (guard) continue;
    guard = registry_.watch_node(paths_.pools + "/" + name, [this, name](const auto& node) { on_pool(name, node); });
  }
  const config::MutexLock lock(mutex_);
  std::erase_if(pools_, is_gone);
  listed_ = now.size();
  changed_.notify_all();
}

void PlaceWatch::on_pool(const std::string& name, const std::optional<discovery::Node>& node) {
  std::vector<discovery::PlaceStatus> places;
  try {
    if (node) places = discovery::decode_pool(node->data, name).places;
  } catch (const config::Error& error) {
    logger.warn("skipped: {}", error.what());
  }
  std::erase_if(places, [&](const auto& place) { return place.topology != topology_; });
  for (auto& place : places) place.pool = discovery::PoolId(name);
  const config::MutexLock lock(mutex_);
  pools_[name] = std::move(places);
  changed_.notify_all();
}

PlaceWatch::Places PlaceWatch::seen() const {
  Places places;
  for (const auto& [pool, of_pool] : pools_) {
    for (const auto& place : of_pool) {
      auto& one = places[place.place];
      if (one.state.empty() || one.since_ms < place.since_ms) one = place;
    }
  }
  return places;
}

PlaceWatch::Places PlaceWatch::wait(std::chrono::milliseconds limit, const std::stop_token& stop,
                                    const std::function<bool(const Places&)>& enough) {
  const config::MutexLock lock(mutex_);
  changed_.wait_for(mutex_, stop, limit,
                    [&]() IOTCLOUD_REQUIRES(mutex_) { return listed_ && pools_.size() >= *listed_ && enough(seen()); });
  return seen();
}

}  // namespace iotcloud::master
