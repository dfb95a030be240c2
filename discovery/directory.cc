#include <algorithm>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/client/turn.h>
#include <iotcloud/discovery/directory.h>

namespace iotcloud::discovery {
namespace {

using Names = std::vector<std::string>;

const config::Logger directory_logger{"discovery.directory"};

struct Channel {
  GuardPtr watch;
  std::optional<ChannelRecord> record;    ///< the current record, if it can be read
  std::optional<ChannelRecord> reported;  ///< the record that the user was told last
  bool complained = false;
  bool complained_of_gateway = false;
};

struct Instance {
  GuardPtr watch;
  GuardPtr list_watch;  ///< null if one channel is wanted by name
  bool active = false;  ///< active and selected
  GatewayId gateway;    ///< as the last record says that could be read
  bool complained = false;
  std::map<std::string, Channel> channels;
};

/// A record is what its place in the tree says: whoever may write the records of one gateway can put any names into
/// them. What a record lacks, as some of the original and of older gateways do, is taken from its place. \throws
/// config::Error if it says something else.
template <typename Name>
void take_from_place(Name& name, const std::string& here, const char* what, const std::string& path) {
  if (name.empty()) name = Name(here);
  const std::string& said = name;
  if (said == here) return;
  throw config::Error(
      fmt::format("{}: the record there says that it is of another {}: {:?}", path, what, said.substr(0, 64)));
}

DriverRecord driver_at(const std::string& bytes, const std::string& path) {
  auto driver = decode_driver(bytes, path);
  take_from_place(driver.name, name_of(parent_of(path)), "driver", path);
  take_from_place(driver.instance, name_of(path), "instance", path);
  return driver;
}

ChannelRecord channel_at(const std::string& bytes, const std::string& path) {
  auto channel = decode_channel(bytes, path);
  const std::string instance = parent_of(path);
  take_from_place(channel.driver, name_of(parent_of(instance)), "driver", path);
  take_from_place(channel.instance, name_of(instance), "instance", path);
  take_from_place(channel.name, name_of(path), "channel", path);
  return channel;
}

}  // namespace

/// It watches the driver's node for instances; for each instance its record and, unless one channel is wanted by name,
/// the list of its channels; for each channel its record. Everything but begin() and end() runs on the dispatcher,
/// while it holds `turn`.
struct DriverDirectory::Impl : TakesTurns<Impl> {
  Impl(Registry& r, Paths p, DriverName d, std::string c, Callbacks cb, Selection w)
      : registry(r),
        paths(std::move(p)),
        driver(std::move(d)),
        wanted(std::move(c)),
        callbacks(std::move(cb)),
        where(std::move(w)) {}

  /// Does not lock `turn`, so that users may construct under a lock that their callbacks take as well.
  void begin() {
    list_watch = registry.watch_children(paths.driver(driver), guarded([](Impl& self, const auto& names) {
                                           self.turn.assert_held();
                                           self.on_instances(names.value_or(Names()));
                                         }));
  }

  void end() {
    GuardPtr watch;  // destroyed after `turn` is unlocked: their destructors wait for callbacks, which lock it
    std::map<InstanceId, Instance> dying;
    const DispatchTurnLock lock(turn);
    over = true;
    watch.swap(list_watch);
    dying.swap(instances);
  }

  void on_instances(const Names& ids) IOTCLOUD_REQUIRES(turn) {
    // Both lists are sorted. A user's callback may end the directory, so `over` is checked after each.
    Names fresh;
    auto next = ids.begin();
    for (auto place = instances.begin(); place != instances.end();) {
      for (; next != ids.end() && *next < place->first; ++next) fresh.push_back(*next);
      if (next != ids.end() && *next == place->first) {
        ++place;
        ++next;
        continue;
      }
      const InstanceId id = place->first;
      Instance gone = std::move(place->second);
      place = instances.erase(place);
      gone.active = false;
      update(gone);
      if (over) return;
      judge(id, std::nullopt, nullptr);
      if (over) return;
    }
    fresh.insert(fresh.end(), next, ids.end());
    for (const std::string& id : fresh) add_instance(InstanceId(id));
  }

  void add_instance(const InstanceId& id) IOTCLOUD_REQUIRES(turn) {
    Instance& instance = instances[id];
    instance.watch = registry.watch_node(paths.instance(driver, id), guarded([id](Impl& self, const auto& node) {
                                           self.turn.assert_held();
                                           self.on_instance(id, node);
                                         }));
    if (!wanted.empty()) {
      watch_channel(id, wanted);
      return;
    }
    instance.list_watch =
        registry.watch_children(paths.instance(driver, id), guarded([id](Impl& self, const auto& names) {
                                  self.turn.assert_held();
                                  self.on_channels(id, names.value_or(Names()));
                                }));
  }

  void on_instance(const InstanceId& id, const std::optional<Node>& node) IOTCLOUD_REQUIRES(turn) {
    const auto found = instances.find(id);
    if (found == instances.end()) return;
    Instance& instance = found->second;
    const auto record = read(node, paths.instance(driver, id), driver_at, instance.complained);
    const bool chosen = record && where.matches(*record);
    if (record) instance.gateway = record->gateway;
    instance.active = chosen && record->state == DriverState::active;
    if (record) judge(id, chosen, &*record);
    if (!over) update(instance);
    if (!over && chosen && record->state == DriverState::active) look_for_wanted(id, record->channels);
  }

  void look_for_wanted(const InstanceId& id, const std::vector<ChannelRecord>& channels) IOTCLOUD_REQUIRES(turn) {
    if (wanted.empty() || channels.empty() || !callbacks.on_missing) return;
    const auto is_wanted = [&](const ChannelRecord& channel) { return channel.name == wanted; };
    if (std::none_of(channels.begin(), channels.end(), is_wanted)) callbacks.on_missing(id, channels);
  }

  void judge(const InstanceId& id, std::optional<bool> chosen, const DriverRecord* record) IOTCLOUD_REQUIRES(turn) {
    if (callbacks.on_choice) callbacks.on_choice(id, chosen);
    if (callbacks.on_record && !over) callbacks.on_record(id, record, chosen.value_or(false));
  }

  void on_channels(const InstanceId& id, const Names& names) IOTCLOUD_REQUIRES(turn) {
    const auto found = instances.find(id);
    if (found == instances.end()) return;
    auto& channels = found->second.channels;
    for (auto place = channels.begin(); place != channels.end();) {
      if (std::binary_search(names.begin(), names.end(), place->first)) {
        ++place;
        continue;
      }
      Channel gone = std::move(place->second);
      place = channels.erase(place);
      gone.record.reset();
      update(gone, found->second);
      if (over) return;
    }
    for (const std::string& name : names) {
      if (!channels.contains(name)) watch_channel(id, name);
    }
  }

  void watch_channel(const InstanceId& id, const std::string& name) IOTCLOUD_REQUIRES(turn) {
    Channel& channel = instances[id].channels[name];
    channel.watch =
        registry.watch_node(paths.channel(driver, id, name), guarded([id, name](Impl& self, const auto& node) {
                              self.turn.assert_held();
                              self.on_channel(id, name, node);
                            }));
  }

  void on_channel(const InstanceId& id, const std::string& name, const std::optional<Node>& node)
      IOTCLOUD_REQUIRES(turn) {
    const auto instance = instances.find(id);
    if (instance == instances.end()) return;
    const auto channel = instance->second.channels.find(name);
    if (channel == instance->second.channels.end()) return;
    channel->second.record = read(node, paths.channel(driver, id, name), channel_at, channel->second.complained);
    update(channel->second, instance->second);
  }

  /// \return nothing if there is no node or it cannot be read, which is logged once.
  template <typename Record>
  static std::optional<Record> read(const std::optional<Node>& node, const std::string& path,
                                    Record (*decode)(const std::string&, const std::string&), bool& complained) {
    if (!node) return std::nullopt;
    try {
      auto record = decode(node->data, path);
      complained = false;
      return record;
    } catch (const config::Error& error) {
      if (!std::exchange(complained, true)) directory_logger.warn("skipped: {}", error.what());
      return std::nullopt;
    }
  }

  void update(Instance& instance) IOTCLOUD_REQUIRES(turn) {
    for (auto& [name, channel] : instance.channels) {
      update(channel, instance);
      if (over) return;  // `instance` is destroyed then
    }
  }

  /// The channel's record, if the channel may be used now. A channel is on its instance's gateway; a record that says
  /// another one is not used, which is logged once.
  std::optional<ChannelRecord> usable(Channel& channel, const Instance& instance) const {
    if (!instance.active || !channel.record) return std::nullopt;
    auto record = channel.record;
    if (record->gateway.empty()) record->gateway = instance.gateway;
    const bool elsewhere = !instance.gateway.empty() && record->gateway != instance.gateway;
    const bool complained = std::exchange(channel.complained_of_gateway, elsewhere);
    if (!elsewhere) return record;
    if (!complained) {
      directory_logger.warn("skipped: {}: the record there is of gateway {:?}, but that of its instance of {:?}",
                            paths.channel(driver, record->instance, record->name), record->gateway.str().substr(0, 64),
                            instance.gateway.str().substr(0, 64));
    }
    return std::nullopt;
  }

  /// Tells the user what changed about a channel.
  void update(Channel& channel, const Instance& instance) IOTCLOUD_REQUIRES(turn) {
    if (const auto record = usable(channel, instance)) {
      if (channel.reported == record) return;
      channel.reported = record;
      if (callbacks.on_channel) callbacks.on_channel(*record);  // which may destroy `channel`
    } else if (channel.reported) {
      const ChannelRecord gone = *std::exchange(channel.reported, std::nullopt);
      if (callbacks.on_channel_gone) callbacks.on_channel_gone(gone);
    }
  }

  Registry& registry;
  const Paths paths;
  const DriverName driver;
  const std::string wanted;  ///< channel name; empty: all
  const Callbacks callbacks;
  const Selection where;

  GuardPtr list_watch;  ///< set by begin(), read by end() only
  std::map<InstanceId, Instance> instances IOTCLOUD_GUARDED_BY(turn);
};

DriverDirectory::DriverDirectory(Registry& registry, Paths paths, DriverName driver, std::string channel,
                                 Callbacks callbacks, Selection where)
    : impl_(std::make_shared<Impl>(registry, std::move(paths), std::move(driver), std::move(channel),
                                   std::move(callbacks), std::move(where))) {
  impl_->begin();
}

DriverDirectory::~DriverDirectory() {
  impl_->end();
}

}  // namespace iotcloud::discovery
