#include <algorithm>
#include <map>
#include <mutex>
#include <optional>
#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/directory.h>

namespace iotcloud::discovery {
namespace {

using Names = std::vector<std::string>;

const config::Logger log{"discovery.directory"};

struct Channel {
  GuardPtr watch;
  std::optional<ChannelRecord> record;    ///< as it stands, when it can be read
  std::optional<ChannelRecord> reported;  ///< as the user knows it
  bool complained = false;
};

struct Instance {
  GuardPtr watch;
  GuardPtr list_watch;  ///< null when one channel is wanted by name
  bool active = false;  ///< and chosen
  bool complained = false;
  std::map<std::string, Channel> channels;
};

}  // namespace

/// One watch on the driver's node for its instances; for each instance one on its record and, unless one channel is
/// wanted by name, one on the list of its channels; for each channel one on its record.
/// Everything but the beginning and the end runs on the dispatcher, in its turn.
struct DriverDirectory::Impl : std::enable_shared_from_this<Impl> {
  Impl(Registry& r, Paths p, std::string d, std::string c, Callbacks cb, Selection w)
      : registry(r),
        paths(std::move(p)),
        driver(std::move(d)),
        wanted(std::move(c)),
        callbacks(std::move(cb)),
        where(std::move(w)) {}

  /// A callback that runs in its turn, and does nothing once the directory is over.
  template <typename Function>
  auto guarded(Function function) {
    return [weak = weak_from_this(), function](const auto& argument) {
      const auto self = weak.lock();
      if (!self) return;
      const std::lock_guard lock(self->turn);
      if (!self->over) function(*self, argument);
    };
  }

  /// Takes no turn: a user who constructs under a lock that his callbacks take as well does no harm.
  void begin() {
    list_watch = registry.watch_children(paths.driver(driver), guarded([](Impl& self, const auto& names) {
                                           self.on_instances(names.value_or(Names()));
                                         }));
  }

  void end() {
    GuardPtr watch;  // these die after the turn: their destructors wait for callbacks, which want it
    std::map<std::string, Instance> dying;
    const std::lock_guard lock(turn);
    over = true;
    watch.swap(list_watch);
    dying.swap(instances);
  }

  void on_instances(const Names& ids) {
    // Both are sorted. User callbacks may end the directory: `over` is looked at after each of them.
    Names fresh;
    auto next = ids.begin();
    for (auto place = instances.begin(); place != instances.end();) {
      for (; next != ids.end() && *next < place->first; ++next) fresh.push_back(*next);
      if (next != ids.end() && *next == place->first) {
        ++place;
        ++next;
        continue;
      }
      const std::string id = place->first;
      Instance gone = std::move(place->second);
      place = instances.erase(place);
      gone.active = false;
      update(gone);
      if (over) return;
      judge(id, std::nullopt);
      if (over) return;
    }
    fresh.insert(fresh.end(), next, ids.end());
    for (const std::string& id : fresh) add_instance(id);
  }

  void add_instance(const std::string& id) {
    Instance& instance = instances[id];
    instance.watch = registry.watch_node(paths.instance(driver, id),
                                         guarded([id](Impl& self, const auto& node) { self.on_instance(id, node); }));
    if (!wanted.empty()) {
      watch_channel(id, wanted);
      return;
    }
    instance.list_watch = registry.watch_children(
        paths.instance(driver, id),
        guarded([id](Impl& self, const auto& names) { self.on_channels(id, names.value_or(Names())); }));
  }

  void on_instance(const std::string& id, const std::optional<Node>& node) {
    const auto found = instances.find(id);
    if (found == instances.end()) return;
    Instance& instance = found->second;
    const auto record = read(node, paths.instance(driver, id), decode_driver, instance.complained);
    const bool chosen = record && where.matches(*record);
    instance.active = chosen && record->state == DriverState::active;
    if (record) judge(id, chosen);
    if (!over) update(instance);
  }

  void judge(const std::string& id, std::optional<bool> chosen) {
    if (callbacks.on_verdict) callbacks.on_verdict(id, chosen);
  }

  void on_channels(const std::string& id, const Names& names) {
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
      update(gone, false);
      if (over) return;
    }
    for (const std::string& name : names) {
      if (!channels.contains(name)) watch_channel(id, name);
    }
  }

  void watch_channel(const std::string& id, const std::string& name) {
    Channel& channel = instances[id].channels[name];
    channel.watch =
        registry.watch_node(paths.channel(driver, id, name),
                            guarded([id, name](Impl& self, const auto& node) { self.on_channel(id, name, node); }));
  }

  void on_channel(const std::string& id, const std::string& name, const std::optional<Node>& node) {
    const auto instance = instances.find(id);
    if (instance == instances.end()) return;
    const auto channel = instance->second.channels.find(name);
    if (channel == instance->second.channels.end()) return;
    channel->second.record = read(node, paths.channel(driver, id, name), decode_channel, channel->second.complained);
    update(channel->second, instance->second.active);
  }

  /// Nothing when there is no node or it cannot be read, which is said once.
  template <typename Record>
  static std::optional<Record> read(const std::optional<Node>& node, const std::string& path,
                                    Record (*decode)(const std::string&, const std::string&), bool& complained) {
    if (!node) return std::nullopt;
    try {
      auto record = decode(node->data, path);
      complained = false;
      return record;
    } catch (const config::Error& error) {
      if (!std::exchange(complained, true)) log.warn("skipped: {}", error.what());
      return std::nullopt;
    }
  }

  void update(Instance& instance) {
    const bool active = instance.active;
    for (auto& [name, channel] : instance.channels) {
      update(channel, active);
      if (over) return;  // and `instance` is gone
    }
  }

  /// Tells the user what is new of a channel.
  void update(Channel& channel, bool active) {
    if (active && channel.record) {
      if (channel.reported == channel.record) return;
      channel.reported = channel.record;
      const ChannelRecord record = *channel.record;  // `channel` may die in the callback
      if (callbacks.on_channel) callbacks.on_channel(record);
    } else if (channel.reported) {
      const ChannelRecord gone = *std::exchange(channel.reported, std::nullopt);
      if (callbacks.on_channel_gone) callbacks.on_channel_gone(gone);
    }
  }

  Registry& registry;
  const Paths paths;
  const std::string driver;
  const std::string wanted;  ///< channel; empty: all
  const Callbacks callbacks;
  const Selection where;

  /// Held while a callback runs. Recursive, so that the directory may be destroyed by its own callback.
  std::recursive_mutex turn;
  // Guarded by turn:
  bool over = false;
  GuardPtr list_watch;  ///< set by begin(), looked at by end() only
  std::map<std::string, Instance> instances;
};

DriverDirectory::DriverDirectory(Registry& registry, Paths paths, std::string driver, std::string channel,
                                 Callbacks callbacks, Selection where)
    : impl_(std::make_shared<Impl>(registry, std::move(paths), std::move(driver), std::move(channel),
                                   std::move(callbacks), std::move(where))) {
  impl_->begin();
}

DriverDirectory::~DriverDirectory() {
  impl_->end();
}

}  // namespace iotcloud::discovery
