#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/host/event_loop.h>

namespace iotcloud::gateway {

/// Follows the orders of one gateway in the registry (/iot/gateways/<id>/orders) and hands each writing of one on once.
/// An order of an older epoch than one seen before is ignored, since its master leads no more; those that stood when
/// the feed started, or when the registry was there again after it had been out of reach, may be of any epoch. Used on
/// one event loop, on which the listener is called, unless said otherwise.
class OrderFeed {
 public:
  struct Listener {
    /// The names of the orders that stand when the feed starts; first of all, once.
    std::function<void(const std::set<std::string>& names)> on_first;
    /// An order was given or changed; `version` is the node's.
    std::function<void(const discovery::OrderRecord& order, std::int64_t version)> on_order;
    /// The order was taken back. Its node and the list of names say so, each in its time: it may be heard twice.
    std::function<void(const std::string& instance)> on_gone;
  };

  OrderFeed(discovery::Registry& registry, discovery::Paths paths, std::string gateway, EventLoop& loop,
            Listener listener);

  void start();
  /// Nothing is handed on any more.
  void stop();
  /// The highest epoch of the orders seen. Thread safe.
  std::int64_t epoch() const { return epoch_; }

 private:
  void catch_up();
  void names_changed(const std::set<std::string>& names);
  void order_changed(const std::string& instance, const std::optional<discovery::Node>& node);
  void read(const std::string& instance, const discovery::Node& node);
  bool is_handled(const std::string& instance, const discovery::Node& node) const;

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  const std::string gateway_;
  EventLoop& loop_;
  const Listener listener_;
  std::atomic<std::int64_t> epoch_{0};
  /// That stood at the start, or when the registry was there again, and are not read yet.
  std::set<std::string> initial_;
  std::map<std::string, std::pair<std::int64_t, std::int64_t>> handled_;  ///< creation and version of what was read
  bool names_known_ = false;
  bool stopped_ = false;
  std::map<std::string, discovery::GuardPtr> order_watches_;
  discovery::GuardPtr names_watch_, session_listener_;
};

}  // namespace iotcloud::gateway
