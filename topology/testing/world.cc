#include <atomic>
#include <deque>
#include <stdexcept>
#include <utility>

#include <iotcloud/config/mutex.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/topology/testing/world.h>

namespace iotcloud::topology::testing {

namespace {

constexpr std::chrono::seconds for_room{20};
constexpr const char* fake_property = "fake";  ///< the number by which a fake driver finds its FakeInstance

std::string names_of(const std::vector<drivers::ChannelSpec>& channels, drivers::Direction direction) {
  std::string names;
  for (const auto& channel : channels) {
    if (channel.direction == direction) names += (names.empty() ? "" : ", ") + channel.name;
  }
  return names.empty() ? "none" : names;
}

}  // namespace

struct FakeInstance::Impl {
  /// \throws std::invalid_argument unless there is such a channel.
  void require(std::string_view channel, drivers::Direction direction) const {
    for (const auto& known : channels) {
      if (known.name == channel && known.direction == direction) return;
    }
    throw std::invalid_argument("the driver \"" + driver + "\" of this world has no " +
                                (direction == drivers::Direction::out ? "outgoing" : "incoming") + " channel \"" +
                                std::string(channel) + "\"; it has: " + names_of(channels, direction));
  }

  std::string driver;
  std::vector<drivers::ChannelSpec> channels;
  std::string id;

  mutable config::Mutex mutex;
  mutable config::ConditionVariable changed;
  drivers::DriverContext* context IOTCLOUD_GUARDED_BY(mutex) = nullptr;  ///< nullptr: not open
  std::uint64_t writable IOTCLOUD_GUARDED_BY(mutex) = 0;                 ///< calls of on_writable
  std::map<std::string, std::vector<drivers::Message>, std::less<>> received IOTCLOUD_GUARDED_BY(mutex);
};

namespace {

/// The instances that are played in this process, by number. Thread safe.
class Played {
 public:
  static Played& get() {
    static Played played;
    return played;
  }
  std::string add(FakeInstance& instance) {
    const config::MutexLock lock(mutex_);
    std::string number = std::to_string(++last_);
    instances_[number] = &instance;
    return number;
  }
  void remove(const std::string& number) {
    const config::MutexLock lock(mutex_);
    instances_.erase(number);
  }
  FakeInstance& find(const drivers::PropertyMap& properties) const {
    const config::MutexLock lock(mutex_);
    const auto number = properties.find(fake_property);
    const auto found = number == properties.end() ? instances_.end() : instances_.find(number->second);
    if (found == instances_.end()) throw std::invalid_argument("a test plays this driver; World::add() adds instances");
    return *found->second;
  }

 private:
  mutable config::Mutex mutex_;
  int last_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::map<std::string, FakeInstance*> instances_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace

/// The driver that a gateway of the world runs for a FakeInstance.
class FakeDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap& properties) override {
    played_ = Played::get().find(properties).impl_.get();
    return played_->channels;
  }
  void open(drivers::DriverContext& context) override { set(&context); }
  void close() override { set(nullptr); }
  void on_message(std::string_view channel, drivers::Message message) override {
    const config::MutexLock lock(played_->mutex);
    played_->received[std::string(channel)].push_back(std::move(message));
    played_->changed.notify_all();
  }
  void on_writable(std::string_view) override {
    const config::MutexLock lock(played_->mutex);
    ++played_->writable;
    played_->changed.notify_all();
  }

 private:
  void set(drivers::DriverContext* context) {
    const config::MutexLock lock(played_->mutex);
    played_->context = context;
    played_->changed.notify_all();
  }
  FakeInstance::Impl* played_ = nullptr;
};

FakeInstance::FakeInstance() : impl_(std::make_unique<Impl>()) {}
FakeInstance::~FakeInstance() = default;

const std::string& FakeInstance::id() const {
  return impl_->id;
}

void FakeInstance::publish(std::string_view channel, drivers::Message message) {
  Impl& impl = *impl_;
  impl.require(channel, drivers::Direction::out);
  const auto deadline = std::chrono::steady_clock::now() + for_room;
  const config::MutexLock lock(impl.mutex);
  while (true) {
    if (impl.context == nullptr) throw std::runtime_error("the instance " + impl.id + " is not there any more");
    const std::uint64_t before = impl.writable;
    const auto status = impl.context->publish(channel, message);
    if (status == drivers::PublishStatus::accepted) return;
    const auto changed = [&]() IOTCLOUD_REQUIRES(impl.mutex) {
      return impl.writable != before || impl.context == nullptr;
    };
    if (status == drivers::PublishStatus::closed || !impl.changed.wait_until(impl.mutex, deadline, changed)) {
      throw std::runtime_error("the channel \"" + std::string(channel) + "\" of " + impl.id +
                               (status == drivers::PublishStatus::closed ? " is closed" : " had no room for 20 s"));
    }
  }
}

void FakeInstance::publish(std::string_view channel, std::string_view text) {
  drivers::Message message;
  message.payload = drivers::Payload::copy(text);
  publish(channel, std::move(message));
}

void FakeInstance::update_metadata(const drivers::PropertyMap& changes) {
  const config::MutexLock lock(impl_->mutex);
  if (impl_->context == nullptr) throw std::runtime_error("the instance " + impl_->id + " is not there any more");
  if (!changes.empty()) impl_->context->update_metadata(changes);
}

std::vector<drivers::Message> FakeInstance::received(std::string_view channel) const {
  return wait_for(channel, 0);
}

std::vector<drivers::Message> FakeInstance::wait_for(std::string_view channel, std::size_t count,
                                                     std::chrono::milliseconds limit) const {
  const Impl& impl = *impl_;
  impl.require(channel, drivers::Direction::in);
  const config::MutexLock lock(impl.mutex);
  const auto got = [&]() IOTCLOUD_REQUIRES(impl.mutex) {
    const auto found = impl.received.find(channel);
    return found == impl.received.end() ? std::size_t{0} : found->second.size();
  };
  impl.changed.wait_for(impl.mutex, limit, [&]() IOTCLOUD_REQUIRES(impl.mutex) { return got() >= count; });
  return got() == 0 ? std::vector<drivers::Message>() : impl.received.find(channel)->second;
}

struct World::Impl {
  explicit Impl(WorldOptions given) : options(std::move(given)) {
    static std::atomic<int> number{0};
    local::LocalOptions local;
    local.name = "world-" + std::to_string(++number);
    local.plugin_dir = options.plugin_dir;
    local.metrics = &metrics;
    local.drivers = options.drivers;
    local.gateways.clear();
    for (const auto& gateway : options.gateways) local.gateways.emplace_back(gateway);
    local.brokers.clear();
    for (const auto& broker : options.brokers) local.brokers.emplace_back(broker, "");
    for (const auto& [name, channels] : options.fakes) {
      descriptors.push_back(drivers::describe<FakeDriver>(name.c_str(), "test"));
      local.drivers[name] = &descriptors.back();
    }
    cluster = std::make_unique<local::LocalCluster>(std::move(local));
  }
  ~Impl() {
    cluster.reset();
    for (const auto& played : numbers) Played::get().remove(played);
  }

  const WorldOptions options;
  std::deque<drivers::Descriptor> descriptors;  ///< of the fakes
  config::Metrics metrics;
  config::Mutex mutex;
  std::deque<FakeInstance> instances IOTCLOUD_GUARDED_BY(mutex);
  std::vector<std::string> numbers IOTCLOUD_GUARDED_BY(mutex);
  std::unique_ptr<local::LocalCluster> cluster;
};

World::World(WorldOptions options) : impl_(std::make_unique<Impl>(std::move(options))) {}
World::~World() = default;

void World::run(const std::string& yaml_file, ComponentRegistry components) {
  impl_->cluster->run_topology(yaml_file, std::move(components));
}

void World::run_text(std::string_view yaml, const std::string& name, ComponentRegistry components) {
  impl_->cluster->run_topology(TopologyDefinition::parse(yaml, name), std::move(components));
}

FakeInstance& World::add(const std::string& driver, const std::string& gateway) {
  const auto fake = impl_->options.fakes.find(driver);
  if (fake == impl_->options.fakes.end()) {
    throw std::invalid_argument("the world's option `fakes` has no driver \"" + driver + "\"");
  }
  FakeInstance* added = nullptr;
  std::string number;
  {
    const config::MutexLock lock(impl_->mutex);
    added = &impl_->instances.emplace_back();
    added->impl_->driver = driver;
    added->impl_->channels = fake->second;
    number = impl_->numbers.emplace_back(Played::get().add(*added));
  }
  added->impl_->id = deploy(driver, {{fake_property, number}}, gateway);
  return *added;
}

std::string World::deploy(const std::string& driver, const drivers::PropertyMap& properties,
                          const std::string& gateway) {
  return impl_->cluster->deploy(driver, properties, discovery::GatewayId(gateway));
}

void World::undeploy(const std::string& id) {
  impl_->cluster->undeploy(discovery::InstanceId(id));
}

bool World::stop(std::chrono::milliseconds limit) {
  return impl_->cluster->stop(limit);
}

local::LocalCluster& World::cluster() {
  return *impl_->cluster;
}

}  // namespace iotcloud::topology::testing
