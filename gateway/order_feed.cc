#include <algorithm>
#include <chrono>

#include <fmt/format.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/order_times.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/order_feed.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::gateway {

namespace {

/// Time until the next attempt to read the orders, when the registry is there but did not answer.
constexpr std::chrono::milliseconds look_pause{500};
/// How long an order must be gone, and no other one must have gone, before that is an order to undeploy. Whoever
/// removes the gateway's whole node removes the orders in it one by one, and the node of the orders only after them.
constexpr std::chrono::milliseconds vanish_pause{200};
/// An order that has been gone for so long is an order to undeploy, even if others go all the time.
constexpr std::chrono::milliseconds longest_vanish_pause{5000};
/// Time until orders are read again that could not be followed because the disk did not take them.
constexpr std::chrono::milliseconds disk_pause{1000};

}  // namespace

/// What the registry has of this gateway's orders.
struct OrderFeed::Found {
  std::optional<discovery::Node> list;    ///< the node of the orders
  std::optional<discovery::Node> freeze;  ///< the mark that this gateway, or an earlier run of it, left
  std::map<discovery::InstanceId, std::optional<discovery::Node>> orders;  ///< nullopt: not read, or just removed
  Instances names() const {
    Instances names;
    for (const auto& [name, node] : orders) names.insert(name);
    return names;
  }
};

/// A signed order, or removal of one, that is followed now.
struct OrderFeed::Followed {
  FollowedOrder order;
  std::string signer;
  std::string path;   ///< of its node
  std::string what;   ///< what it is about, besides its instance
  bool fresh = true;  ///< it was not followed before a restart
  security::AuditEntry line() const {
    security::AuditEntry entry;
    entry.who = signer;
    entry.role = to_string(security::Role::master);
    entry.address = "registry";
    entry.order = path;
    entry.what = fmt::format("{} of {}", what, order.instance);
    return entry;
  }
};

OrderFeed::OrderFeed(discovery::Registry& registry, discovery::Paths paths, discovery::GatewayId gateway,
                     EventLoop& loop, const config::Clock& clock, Listener listener,
                     std::shared_ptr<const security::TrustedKeys> masters, std::string followed_file)
    : registry_(registry),
      paths_(std::move(paths)),
      gateway_(std::move(gateway)),
      loop_(loop),
      clock_(clock),
      listener_(std::move(listener)),
      masters_(std::move(masters)),
      done_(masters_ ? std::move(followed_file) : "") {}

// The registry calls back on its dispatcher thread, and the keys on keys_watch_; the callbacks only post to the loop.

void OrderFeed::start() {
  const std::string list = paths_.orders(gateway_);
  started_ms_ = clock_.wall_ms();
  names_watch_ = registry_.watch_children(list, [this](const std::optional<std::vector<std::string>>& names) {
    loop_.post([this, names] { names_changed(names); });
  });
  node_watch_ = registry_.watch_node(list, [this](const std::optional<discovery::Node>& node) {
    loop_.post([this, created = node ? std::optional(node->created) : std::nullopt] {
      if (created != followed_ || !frozen().empty()) read_orders();
    });
  });
  session_listener_ = registry_.on_session([this](discovery::SessionState state) {
    if (state == discovery::SessionState::connected) loop_.post([this] { read_orders(); });
  });
  if (masters_) keys_watch_ = masters_->on_change([this] { loop_.post([this] { read_refused_again(); }); });
}

void OrderFeed::stop() {
  stopped_ = true;
  keys_watch_ = {};
  session_listener_.reset();
  node_watch_.reset();
  names_watch_.reset();
  unproven_.clear();
  order_watches_.clear();
}

std::string OrderFeed::frozen() const {
  const auto freeze = freeze_record();
  return freeze ? freeze->reason : "";
}

std::optional<discovery::FreezeRecord> OrderFeed::freeze_record() const {
  const config::MutexLock lock(mutex_);
  return freeze_;
}

void OrderFeed::read_orders(Reading reading) {
  if (stopped_) return;
  follow_due();
  try {
    const Found found = read_registry(frozen().empty() ? reading : Reading::all);
    if (found.freeze && frozen().empty()) take_up_freeze(*found.freeze);
    if (const auto trouble = objection(found)) {
      freeze(*trouble, found);
    } else {
      follow_all(found);
    }
    listener_.on_orders_read();
    return;
  } catch (const discovery::RegistryError& e) {
    logger.debug("the orders are read when the registry answers: {}", e.what());
  } catch (const config::Error& e) {
    logger.error("the orders are not followed until it can be written what was followed: {}", e.what());
    return read_refused_later();
  }
  read_when_answered();
}

/// Reads the orders a little later. Without a connection, the next one does.
void OrderFeed::read_when_answered() {
  if (registry_.session() != discovery::SessionState::connected || std::exchange(retrying_, true)) return;
  loop_.start_timer(look_pause, std::chrono::microseconds{0}, [this] {
    retrying_ = false;
    read_orders();
  });
}

/// Also follows the orders that were given while the registry was unreachable. Several masters may have led one after
/// the other meanwhile, and the orders are not read in the order in which they were given. So an order with an older
/// epoch than another one is valid here (`initial_`).
void OrderFeed::follow_all(const Found& found) {
  const auto answer = adoption(*found.list);
  if (answer) done_.forget_all();
  const bool adopted = thaw();
  const bool other = std::exchange(followed_, found.list->created) != found.list->created;
  const bool of_older_lead = std::exchange(of_older_lead_, std::nullopt).has_value();
  if (adopted || other || of_older_lead) {
    handled_.clear();
    unjudged_.clear();
    epoch_ = answer ? answer->epoch : 0;  // a registry that was emptied or restored counts epochs anew
  }
  Instances names = found.names();
  if (answer || !told_first_) first_ = names;
  if (!adopted) names.merge(just_gone(names));
  if (masters_) {
    if (answer) unproven_.clear();  // a master's signed answer: all orders that are gone are meant to be gone
    if (!answer) names.merge(without_removal(names));
  }
  follow_names(names);
  if (!gone_.empty()) read_again_soon();
  for (const auto& [name, node] : found.orders) {
    if (!node || is_handled(name, *node)) continue;
    const auto unjudged = unjudged_.find(name);
    if (unjudged == unjudged_.end() || unjudged->second != std::pair(node->created, node->version))
      initial_.insert(name);
    take(name, *node);
  }
  follow_due();
}

/// \param names of the orders that are there
/// \return the other orders, unless they have been gone for long enough to take that for an order to undeploy.
OrderFeed::Instances OrderFeed::just_gone(const Instances& names) {
  const auto now = clock_.now();
  std::erase_if(gone_, [&](const auto& entry) { return names.contains(entry.first); });
  for (const auto& [name, watch] : order_watches_) {
    if (names.contains(name) || unproven_.contains(name)) continue;
    if (gone_.try_emplace(name, now).second) last_gone_ = now;
  }
  const bool more_go = now - last_gone_ < vanish_pause;
  std::erase_if(gone_, [&](const auto& entry) { return !more_go || now - entry.second >= longest_vanish_pause; });
  Instances young;
  for (const auto& [name, since] : gone_) young.insert(name);
  return young;
}

void OrderFeed::read_again_soon() {
  if (std::exchange(reads_again_, true)) return;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(last_gone_ + vanish_pause - clock_.now());
  loop_.start_timer(std::max(left, std::chrono::milliseconds{1}), std::chrono::microseconds{0}, [this] {
    reads_again_ = false;
    read_orders(Reading::names);
  });
}

OrderFeed::Found OrderFeed::read_registry(Reading reading) {
  const std::string list = paths_.orders(gateway_);
  const std::string mark = discovery::freeze_path(paths_, gateway_);
  Found found;
  auto both = registry_.get_all({list, mark});
  constexpr int most_tries = 3;  // more than one, because the registry may be emptied before the answer
  for (int tries = 0; !both[0] && !both[1] && nothing_to_lose(); ++tries) {
    if (tries == most_tries)
      throw discovery::RegistryError(discovery::RegistryErrorCode::away, list + " goes as soon as it is made");
    discovery::put(registry_, list, "");
    both = registry_.get_all({list, mark});
  }
  found.list = std::move(both[0]);
  found.freeze = std::move(both[1]);
  const auto children = registry_.children(list);
  if (found.list && !children) return read_registry(reading);  // it has just gone, and the orders went with it
  const auto names = children.value_or(std::vector<std::string>());
  std::vector<std::string> paths;
  if (reading == Reading::all) {
    for (const auto& name : names) paths.push_back(paths_.order(gateway_, discovery::InstanceId(name)));
  }
  auto nodes = registry_.get_all(paths);
  nodes.resize(names.size());
  for (std::size_t i = 0; i < names.size(); ++i) {
    found.orders.emplace(discovery::InstanceId(names[i]), std::move(nodes[i]));
  }
  return found;
}

/// An earlier run of this gateway was frozen, and nobody has adopted the registry since.
void OrderFeed::take_up_freeze(const discovery::Node& node) {
  discovery::FreezeRecord record;
  try {
    record = discovery::decode_freeze(node.data, discovery::freeze_path(paths_, gateway_));
  } catch (const config::Error& e) {
    record.reason = e.what();
    record.token = discovery::new_instance_id().str();
  }
  // Only that run knew which node of the orders it had followed, so only an adoption ends this freeze.
  record.lasting = true;
  if (masters_ && record.token != done_.freeze()) {
    // This gateway did not write the mark. A master may have answered to that token long ago.
    record.token = discovery::new_instance_id().str();
    done_.set_freeze(record.token);
  }
  logger.error("{}; since then this gateway follows no orders: `iotcloud registry adopt {}`", record.reason, gateway_);
  {
    const config::MutexLock lock(mutex_);
    freeze_ = std::move(record);
  }
  listener_.on_frozen();
}

/// No instance runs, and none was ordered as far as this gateway knows.
bool OrderFeed::nothing_to_lose() const {
  return frozen().empty() && order_watches_.empty() && listener_.present().empty();
}

/// \return why these are not the orders that this gateway is to follow; nullopt: they are.
std::optional<OrderFeed::Objection> OrderFeed::objection(const Found& found) const {
  const auto freeze = freeze_record();
  if (found.list && adoption(*found.list)) return std::nullopt;
  if (freeze && freeze->lasting) return Objection{freeze->reason, true};
  if (const auto instance = put_back(found)) {
    return Objection{fmt::format("the registry was put back to an earlier state: the order of {} was given before the "
                                 "one that this gateway followed last",
                                 *instance),
                     true};
  }
  if (of_older_lead_ && !listener_.present().empty()) {
    return Objection{
        fmt::format("the registry was put back to an earlier state: the order of {} is by a master that leads, and "
                    "this gateway has followed one that led later",
                    *of_older_lead_),
        true};
  }
  if (found.list && nothing_to_lose()) return std::nullopt;
  if (!found.list) {
    return Objection{"the registry has no orders for this gateway: it was emptied, or the gateway's node was removed",
                     !followed_};
  }
  if (followed_ && found.list->created != *followed_) {
    return Objection{"the registry's orders are not those that this gateway followed: it was emptied or restored",
                     false};
  }
  for (const auto& [instance, handled] : handled_) {
    const auto now = found.orders.find(instance);
    if (now == found.orders.end() || !now->second || now->second->created != handled.first) continue;
    if (now->second->version < handled.second) {
      return Objection{
          fmt::format("the registry was put back to an earlier state: the order of {} is an older one", instance),
          true};
    }
  }
  Instances vanished;
  for (const auto& instance : listener_.present()) {
    if (!found.orders.contains(instance)) vanished.insert(instance);
  }
  if (vanished.empty()) return std::nullopt;
  const auto lost = listener_.without_record(vanished);
  if (lost.empty()) return std::nullopt;
  return Objection{fmt::format("the registry was put back to an earlier state: the order of {} is gone, and what this "
                               "gateway recorded of it, too",
                               *lost.begin()),
                   true};
}

/// \return at the start, an instance whose order is older than what an earlier run followed, and was not written after
/// it: that would be one that somebody wrote once more; nullopt: there is none.
std::optional<discovery::InstanceId> OrderFeed::put_back(const Found& found) const {
  if (!masters_ || followed_) return std::nullopt;
  for (const auto& [instance, node] : found.orders) {
    const auto* last = done_.find(instance);
    if (!node || last == nullptr || last->removed) continue;
    if (node->created == last->created && node->version >= last->version) continue;
    const std::string path = paths_.order(gateway_, instance);
    try {
      if (signer_of(path, *node) && discovery::decode_order(node->data, path).given_ms < last->given_ms)
        return instance;
    } catch (const config::Error& e) {
      logger.debug("{}", e.what());  // it is ignored when it is read
    }
  }
  return std::nullopt;
}

/// \return a master's answer to the present freeze; nullopt: there is none yet, or the feed is not frozen.
std::optional<discovery::Adoption> OrderFeed::adoption(const discovery::Node& list) const {
  const auto freeze = freeze_record();
  if (!freeze || list.data.empty() || !signer_of(paths_.orders(gateway_), list)) return std::nullopt;
  try {
    auto answer = discovery::decode_adoption(list.data, paths_.orders(gateway_));
    if (answer.token == freeze->token) return answer;
  } catch (const config::Error& e) {
    logger.warn("{}", e.what());
  }
  return std::nullopt;
}

void OrderFeed::freeze(const Objection& objection, const Found& found) {
  auto record = freeze_record();
  const bool fresh = !record;
  if (fresh) {
    record = discovery::FreezeRecord{objection.reason, clock_.wall_ms(), discovery::new_instance_id().str(),
                                     objection.lasting};
    logger.error(
        "{}; what runs here goes on, and no orders are followed until a master says that they are meant as they stand: "
        "`iotcloud registry adopt {}`",
        record->reason, gateway_);
  }
  record->lasting = record->lasting || objection.lasting;
  if (masters_) done_.set_freeze(record->token);
  {
    const config::MutexLock lock(mutex_);
    freeze_ = record;
  }
  gone_.clear();
  if (fresh) listener_.on_frozen();
  const std::string bytes = encode(*record);
  if (!found.freeze || found.freeze->data != bytes) {
    discovery::put(registry_, discovery::freeze_path(paths_, gateway_), bytes);
  }
}

/// \return whether the feed was frozen.
bool OrderFeed::thaw() {
  if (frozen().empty()) return false;
  registry_.remove(discovery::freeze_path(paths_, gateway_));
  if (masters_) done_.set_freeze("");
  logger.warn("the registry's orders are followed again, as they stand now");
  const config::MutexLock lock(mutex_);
  freeze_.reset();
  return true;
}

bool OrderFeed::is_handled(const discovery::InstanceId& instance, const discovery::Node& node) const {
  const auto found = handled_.find(instance);
  return found != handled_.end() && found->second == std::make_pair(node.created, node.version);
}

/// If all known orders are still there, it is still the same registry: then only the new orders are read.
void OrderFeed::names_changed(const std::optional<std::vector<std::string>>& names) {
  if (stopped_) return;
  follow_due();
  Instances now;
  if (names) now.insert(names->begin(), names->end());
  const auto stays = [&](const auto& watched) { return now.contains(watched.first); };
  if (frozen().empty() && !order_watches_.empty() && std::all_of(order_watches_.begin(), order_watches_.end(), stays)) {
    follow_names(now);
  } else {
    read_orders(told_first_ && !order_watches_.empty() ? Reading::names : Reading::all);
  }
}

void OrderFeed::follow_names(const Instances& names) {
  if (!std::exchange(told_first_, true)) {
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
  Instances gone;
  for (auto it = order_watches_.begin(); it != order_watches_.end();) {
    if (names.contains(it->first)) {
      ++it;
      continue;
    }
    const discovery::InstanceId instance = it->first;
    it = order_watches_.erase(it);
    handled_.erase(instance);
    unjudged_.erase(instance);
    forget_refusal(instance);
    gone.insert(instance);
    listener_.on_gone(instance);
  }
  if (!gone.empty()) clear_removals(gone);
}

/// \param names of the orders that are there, or have only just gone
/// \return the other orders, unless a master has signed that it removed them.
OrderFeed::Instances OrderFeed::without_removal(const Instances& names) {
  Instances missing;
  for (const auto& [instance, watch] : order_watches_) missing.insert(instance);
  if (!told_first_) missing.merge(listener_.present());
  for (const auto& name : names) missing.erase(name);
  std::vector<std::string> paths;
  for (const auto& instance : missing) paths.push_back(paths_.removal(gateway_, instance));
  const auto nodes = paths.empty() ? std::vector<std::optional<discovery::Node>>() : registry_.get_all(paths);
  Instances unproven;
  std::vector<Followed> removals;
  std::size_t i = 0;
  for (const auto& instance : missing) {
    const auto& node = nodes[i++];
    const auto* last = done_.find(instance);
    if (last != nullptr && last->removed) continue;  // by an earlier run, which did not end the instance
    if (auto removed = removal_of(instance, node)) {
      removals.push_back({followed(instance, removed->given_ms), std::move(removed->signer),
                          paths_.removal(gateway_, instance), "removal"});
      removals.back().order.removed = true;
    } else {
      unproven.insert(instance);
    }
  }
  write_down(removals);
  audit_followed(removals);
  std::erase_if(unproven_, [&](const auto& entry) { return !unproven.contains(entry.first); });
  for (const auto& instance : unproven) {
    if (unproven_.contains(instance)) continue;
    refuse(instance, paths_.removal(gateway_, instance),
           "the removal of the order for {}, which no trusted master has signed",
           "If it is to go: `iotcloud undeploy`; if it is to stay: `iotcloud registry import`");
    watch_removal(instance);
  }
  return unproven;
}

void OrderFeed::watch_removal(const discovery::InstanceId& instance) {
  unproven_[instance] = registry_.watch_node(paths_.removal(gateway_, instance), [this](const auto& node) {
    if (!node) return;
    loop_.post([this] { read_orders(Reading::names); });
  });
}

/// \param node of the instance's OrderRemoval
/// \return when a master removed the instance's last order, and which; nullopt: none did.
std::optional<OrderFeed::Removal> OrderFeed::removal_of(const discovery::InstanceId& instance,
                                                        const std::optional<discovery::Node>& node) const {
  const std::string path = paths_.removal(gateway_, instance);
  if (!node) return std::nullopt;
  auto signer = signer_of(path, *node);
  if (!signer) return std::nullopt;
  try {
    const auto removal = discovery::decode_removal(node->data, path);
    const auto* last = done_.find(instance);
    const bool is_last = last == nullptr || removal.given_ms > last->given_ms;
    if (removal.instance == instance && is_last) return Removal{removal.given_ms, *std::move(signer)};
  } catch (const config::Error& e) {
    logger.warn("{}", e.what());
  }
  return std::nullopt;
}

/// Removes what masters wrote about the removal of these orders: it has been followed.
void OrderFeed::clear_removals(const Instances& gone) {
  try {
    const auto names = registry_.children(paths_.removals(gateway_)).value_or(std::vector<std::string>());
    for (const auto& name : names) {
      const discovery::InstanceId instance(name);
      if (gone.contains(instance)) registry_.remove(paths_.removal(gateway_, instance));
    }
  } catch (const discovery::RegistryError& e) {
    logger.debug("the mark of a removed order stays: {}", e.what());
  }
}

/// An order that is gone, or stands in another node than before, may belong to another state of the whole registry.
void OrderFeed::order_changed(const discovery::InstanceId& instance, const std::optional<discovery::Node>& node) {
  if (stopped_ || !frozen().empty() || !order_watches_.contains(instance)) return;
  if (!node && gone_.contains(instance)) return;
  const auto handled = handled_.find(instance);
  const bool same = node && (handled == handled_.end() ||
                             (handled->second.first == node->created && handled->second.second <= node->version));
  if (!same) {
    read_orders(node ? Reading::all : Reading::names);
  } else if (!is_handled(instance, *node)) {
    take(instance, *node);
  }
}

void OrderFeed::take(const discovery::InstanceId& instance, const discovery::Node& node) {
  try {
    read(instance, node);
    handled_[instance] = {node.created, node.version};
    unjudged_.erase(instance);
  } catch (const discovery::RegistryError& e) {
    const bool first = unjudged_.insert_or_assign(instance, std::pair(node.created, node.version)).second;
    if (first)
      logger.warn("the order for {} is read again: whether its master leads is not known yet: {}", instance, e.what());
    read_when_answered();
  } catch (const std::exception& e) {
    logger.error("an order is ignored: {}", e.what());
  }
}

void OrderFeed::read(const discovery::InstanceId& instance, const discovery::Node& node) {
  const std::string path = paths_.order(gateway_, instance);
  auto signer = signer_of(path, node);
  if (!signer) {
    return refuse(instance, path, "the order for {}, which no trusted master has signed",
                  "If this fleet's orders are older than its keys: `iotcloud registry export`, look at them, and "
                  "`import --replace`");
  }
  const auto order = discovery::decode_order(node.data, path);
  if (due_.contains(instance)) follow_due();
  if (is_out_of_date(order)) {
    return refuse(instance, path, "the order for {}, which is out of date: a later one was given",
                  "Somebody wrote an old order once more, or a master's clock is wrong. If it is meant: `iotcloud "
                  "undeploy` it and deploy it again, which is a new order");
  }
  forget_refusal(instance);
  if (order.instance != instance) {
    throw config::Error(fmt::format("the order at {} is for the instance \"{}\"", path, order.instance));
  }
  const bool stood_before = initial_.erase(instance) > 0;
  if (order.epoch < epoch_ && !stood_before) {
    if (of_older_lead_) return;  // all orders are about to be read again
    if (retrying_) {             // the registry is asked once for all orders
      throw discovery::RegistryError(discovery::RegistryErrorCode::away, "the registry did not answer a moment ago");
    }
    if (leads_now(order.epoch)) {
      of_older_lead_ = instance;
      loop_.post([this] { read_orders(); });
      return;
    }
    logger.warn("an order for {} is ignored: its epoch {} is older than {}, so its master no longer leads", instance,
                order.epoch, epoch_.load());
    return;
  }
  epoch_ = std::max(epoch_.load(), order.epoch);
  if (!masters_) return listener_.on_order(order, node.version);
  if (due_.empty()) loop_.post([this] { follow_due(); });
  due_[instance] = {order, node.created, node.version, *std::move(signer)};
}

/// Whether the registry has the node by which a master with this epoch stands for election. That of a master which lost
/// the lead went before the next one led, so of two epochs that a gateway has seen in one state of the registry, the
/// older one's is gone. \throws discovery::RegistryError
bool OrderFeed::leads_now(std::int64_t epoch) const {
  auto standing = registry_.children(paths_.masters()).value_or(std::vector<std::string>());
  for (auto& name : standing) name.insert(0, paths_.masters() + "/");
  const auto nodes = registry_.get_all(standing);
  return std::any_of(nodes.begin(), nodes.end(), [&](const auto& node) { return node && node->created == epoch; });
}

FollowedOrder OrderFeed::followed(const discovery::InstanceId& instance, std::int64_t given_ms) const {
  FollowedOrder now;
  now.instance = instance;
  now.given_ms = given_ms;
  now.counts_ms = std::min(given_ms, clock_.wall_ms() + discovery::clocks_differ.count());
  return now;
}

/// Takes note of all orders that are due with one wait for the disk, and tells the listener.
void OrderFeed::follow_due() {
  const auto due = std::exchange(due_, {});
  if (due.empty() || stopped_) return;
  std::vector<Followed> orders;
  for (const auto& [instance, one] : due) {
    const auto* last = done_.find(instance);
    const bool fresh = last == nullptr || last->removed || last->given_ms != one.order.given_ms;
    orders.push_back({followed(instance, one.order.given_ms), one.signer, paths_.order(gateway_, instance),
                      one.order.plugin, fresh});
    orders.back().order.created = one.created;
    orders.back().order.version = one.version;
  }
  try {
    write_down(orders);
  } catch (const config::Error& e) {
    logger.error("{}", e.what());
    for (const auto& [instance, one] : due) {
      initial_.insert(instance);
      refuse(instance, paths_.order(gateway_, instance),
             "the order for {}, because it cannot be written down that it is followed",
             "It is followed when the state folder and the audit log can be written");
    }
    return read_refused_later();
  }
  for (const auto& [instance, one] : due) {
    first_.erase(instance);
    listener_.on_order(one.order, one.version);
  }
  audit_followed(orders);
}

/// Brings to the disk that these orders are followed, before they are: into the audit log, and for a restart. \throws
/// config::Error when they must not be followed now
void OrderFeed::write_down(const std::vector<Followed>& orders) {
  std::vector<security::AuditEntry> lines;
  std::vector<FollowedOrder> known;
  for (const auto& one : orders) {
    known.push_back(one.order);
    const auto begun = begun_.find(one.path);
    const bool told = begun != begun_.end() && begun->second == one.order.given_ms;
    if (one.fresh && !told) lines.push_back(one.line());
  }
  if (listener_.audit_begun && !lines.empty()) {
    listener_.audit_begun(lines);
    for (const auto& one : orders) begun_[one.path] = one.order.given_ms;
  }
  done_.add(known);
}

void OrderFeed::audit_followed(const std::vector<Followed>& orders) {
  for (const auto& one : orders) {
    begun_.erase(one.path);
    if (!listener_.audit || !one.fresh) continue;
    auto line = one.line();
    line.outcome = "followed";
    listener_.audit(std::move(line));
  }
}

bool OrderFeed::is_out_of_date(const discovery::OrderRecord& order) const {
  if (!masters_) return false;
  if (const auto* last = done_.find(order.instance)) return order.given_ms < last->given_ms;
  if (order.given_ms < done_.oldest_of_unknown_ms()) return true;
  return !first_.contains(order.instance) && order.given_ms < started_ms_ - discovery::clocks_differ.count();
}

/// \return the master who signed what stands there, or "" where orders need no signature; nullopt: no trusted one did.
std::optional<std::string> OrderFeed::signer_of(const std::string& path, const discovery::Node& node) const {
  if (!masters_) return "";
  std::string signer = security::signer_of_object(*masters_, path, node.data);
  return signer.empty() ? std::nullopt : std::optional(std::move(signer));
}

/// \param path of what is refused \param what a format with the instance
void OrderFeed::refuse(const discovery::InstanceId& instance, const std::string& path, const std::string& what,
                       const std::string& advice) {
  const std::string named = fmt::format(fmt::runtime(what), instance);
  logger.error("refused: {}. What runs goes on as it is. {}", named, advice);
  if (listener_.audit) {
    security::AuditEntry entry;
    entry.event = security::AuditEvent::refused;
    entry.address = "registry";
    entry.order = path;
    entry.outcome = named;
    listener_.audit(std::move(entry));
  }
  {
    const config::MutexLock lock(mutex_);
    refused_[instance] = named;
  }
  config::process_metrics()
      .counter("iotcloud_gateway_orders_refused_total",
               "Orders, and removals of orders, that no trusted master gave now, which are not followed")
      .add();
}

void OrderFeed::forget_refusal(const discovery::InstanceId& instance) {
  const config::MutexLock lock(mutex_);
  refused_.erase(instance);
}

std::string OrderFeed::refused() const {
  const config::MutexLock lock(mutex_);
  if (refused_.empty()) return "";
  const std::string others = refused_.size() == 1 ? "" : fmt::format("; and {} others", refused_.size() - 1);
  return fmt::format("refused: {}{}", refused_.begin()->second, others);
}

void OrderFeed::read_refused_later() {
  if (std::exchange(reads_refused_, true)) return;
  loop_.start_timer(disk_pause, std::chrono::microseconds{0}, [this] {
    reads_refused_ = false;
    read_refused_again();
  });
}

void OrderFeed::read_refused_again() {
  {
    const config::MutexLock lock(mutex_);
    if (refused_.empty()) return;
    for (const auto& [instance, what] : refused_) handled_.erase(instance);
  }
  read_orders();
}

}  // namespace iotcloud::gateway
