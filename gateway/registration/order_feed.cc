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
  session_listener_ = registry_.on_session([this](discovery::SessionState state) {
    if (state == discovery::SessionState::connected) loop_.post([this] { catch_up(); });
  });
}

void OrderFeed::stop() {
  stopped_ = true;
  session_listener_.reset();
  names_watch_.reset();
  order_watches_.clear();
}

/// What came while the registry was out of reach is of one or several masters that led one after the other, and is read
/// here in no order of theirs: an older epoch says nothing.
void OrderFeed::catch_up() {
  if (stopped_ || !names_known_) return;
  try {
    const auto names = registry_.children(paths_.orders(gateway_)).value_or(std::vector<std::string>());
    std::vector<std::string> paths;
    for (const auto& name : names) paths.push_back(paths_.order(gateway_, name));
    const auto nodes = registry_.get_all(paths);
    names_changed({names.begin(), names.end()});
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (!nodes[i] || is_handled(names[i], *nodes[i])) continue;
      initial_.insert(names[i]);
      order_changed(names[i], nodes[i]);
    }
  } catch (const discovery::RegistryError& e) {
    log.debug("orders that were missed are read when the registry is there: {}", e.what());
  }
}

bool OrderFeed::is_handled(const std::string& instance, const discovery::Node& node) const {
  const auto found = handled_.find(instance);
  return found != handled_.end() && found->second == std::make_pair(node.created, node.version);
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
  if (stopped_ || !order_watches_.contains(instance)) return;
  if (!node) {
    // The list of names says so too, but not when the order went before it was told with it: catch_up() was faster.
    if (handled_.erase(instance) > 0) listener_.on_gone(instance);
    return;
  }
  if (is_handled(instance, *node)) return;
  try {
    read(instance, *node);
    handled_[instance] = {node->created, node->version};
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
