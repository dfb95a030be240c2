#include <algorithm>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/registration/order_feed.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log{"gateway"};

}  // namespace

OrderFeed::OrderFeed(discovery::Registry& registry, discovery::Paths paths, std::string gateway, EventLoop& loop,
                     Listener listener)
    : registry_(registry),
      paths_(std::move(paths)),
      gateway_(std::move(gateway)),
      loop_(loop),
      listener_(std::move(listener)) {}

// Callbacks come on the registry's dispatcher; they only post.

void OrderFeed::start() {
  names_watch_ =
      registry_.watch_children(paths_.orders(gateway_), [this](const std::optional<std::vector<std::string>>& names) {
        std::set<std::string> now;
        if (names) now.insert(names->begin(), names->end());
        loop_.post([this, now] { names_changed(now); });
      });
}

void OrderFeed::stop() {
  stopped_ = true;
  names_watch_.reset();
  order_watches_.clear();
}

void OrderFeed::names_changed(const std::set<std::string>& names) {
  if (stopped_) return;
  if (!std::exchange(names_known_, true)) {
    initial_ = names;
    listener_.on_first(names);
  }
  for (const auto& name : names) {
    if (order_watches_.contains(name)) continue;
    order_watches_[name] =
        registry_.watch_node(paths_.order(gateway_, name), [this, name](const std::optional<discovery::Node>& node) {
          loop_.post([this, name, node] { order_changed(name, node); });
        });
  }
  for (auto it = order_watches_.begin(); it != order_watches_.end();) {
    if (names.contains(it->first)) {
      ++it;
      continue;
    }
    const std::string instance = it->first;
    it = order_watches_.erase(it);
    handled_.erase(instance);
    listener_.on_gone(instance);
  }
}

void OrderFeed::order_changed(const std::string& instance, const std::optional<discovery::Node>& node) {
  if (stopped_ || !node || !order_watches_.contains(instance)) return;  // its going is seen by its name's going
  const auto writing = std::make_pair(node->created, node->version);
  if (const auto found = handled_.find(instance); found != handled_.end() && found->second == writing) return;
  try {
    read(instance, *node);
    handled_[instance] = writing;
  } catch (const std::exception& e) {
    log.error("an order is ignored: {}", e.what());
  }
}

void OrderFeed::read(const std::string& instance, const discovery::Node& node) {
  const std::string path = paths_.order(gateway_, instance);
  const auto order = discovery::decode_order(node.data, path);
  if (order.instance != instance) {
    throw config::Error(fmt::format("the order at {} is for the instance \"{}\"", path, order.instance));
  }
  const bool stood_before = initial_.erase(instance) > 0;
  if (order.epoch < epoch_ && !stood_before) {
    log.warn("an order for {} is ignored: its epoch {} is older than {}, its master leads no more", instance,
             order.epoch, epoch_.load());
    return;
  }
  epoch_ = std::max(epoch_.load(), order.epoch);
  listener_.on_order(order, node.version);
}

}  // namespace iotcloud::gateway
