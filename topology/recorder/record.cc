#include <algorithm>
#include <chrono>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/recorder/record.h>

namespace iotcloud::recorder {

namespace {

const config::Logger logger{"record"};
constexpr std::uint16_t prefetch = 2000;
/// A message is settled when its chunk is in the file. A chunk is written before brokers wait for that.
constexpr std::size_t most_unsettled = prefetch / 2;

std::string alias_of(const discovery::DriverRecord& driver) {
  return driver.deployment.empty() ? "" : fmt::format("{}/{}", driver.deployment, driver.index);
}

}  // namespace

struct Recorder::Impl {
  /// One topic that is read, with the instances whose channel it is: one, or those that share it.
  struct Reader {
    std::shared_ptr<brokers::Broker> broker;
    brokers::Topic topic;
    std::map<std::string, std::size_t> channels{};  ///< in the file, by instance
    std::unique_ptr<brokers::Subscription> subscription{};
  };
  using Key = std::pair<std::string, brokers::Topic>;  ///< logical broker, topic

  Impl(System& of, RecordOptions given, std::function<void()> told)
      : system(of),
        options(std::move(given)),
        group(options.group.empty() ? "record-" + discovery::new_instance_id().str().substr(0, 8) : options.group),
        on_message(std::move(told)),
        clock(options.clock != nullptr ? *options.clock : config::system_clock()),
        writer(options.file, options.writing) {}

  bool wants(const discovery::ChannelRecord& channel) const {
    if (channel.direction == discovery::Direction::out ? !options.out : !options.in) return false;
    const auto& names = options.channels;
    return names.empty() || std::find(names.begin(), names.end(), channel.name) != names.end();
  }

  /// Looks for drivers as soon as there are new ones.
  void watch_drivers() {
    watch = system.registry().watch_children(system.paths().sensors,
                                             [this](const std::optional<std::vector<std::string>>& names) {
                                               if (names) add_drivers(*names);
                                             });
  }

  /// On the registry's dispatcher.
  void add_drivers(const std::vector<std::string>& names) {
    for (const auto& name : names) {
      if (directories.contains(name)) continue;
      discovery::DriverDirectory::Callbacks callbacks;
      callbacks.on_channel = [this](const discovery::ChannelRecord& channel) { open(channel); };
      // A channel that is gone stays subscribed: what waits at its broker is recorded, and it may come back.
      callbacks.on_channel_gone = [](const discovery::ChannelRecord&) {};
      callbacks.on_record = [this](const discovery::InstanceId& instance, const discovery::DriverRecord* record, bool) {
        const config::MutexLock lock(mutex);
        if (record != nullptr) records[instance.str()] = *record;
      };
      directories[name] = std::make_unique<discovery::DriverDirectory>(
          system.registry(), system.paths(), discovery::DriverName(name), "", std::move(callbacks), options.where);
    }
  }

  /// On the registry's dispatcher.
  void open(const discovery::ChannelRecord& channel) {
    if (!wants(channel)) return;
    const std::string label = fmt::format("{} of {} {}", channel.name, channel.driver, channel.instance);
    try {
      const auto topic = System::topic_of(channel);
      const auto broker = system.broker_of(channel);
      const config::MutexLock lock(mutex);
      if (closing) return;
      Reader& reader = readers[{channel.transport, topic}];
      troubles.erase(label);
      if (!reader.channels.contains(channel.instance.str()))
        reader.channels[channel.instance.str()] = writer.add_channel(recorded(channel));
      if (reader.subscription) return;
      reader.broker = broker;
      reader.topic = topic;
      brokers::SubscriptionOptions how;
      how.group = group;
      how.prefetch = prefetch;
      reader.subscription = broker->subscribe(
          topic, how, [this, &reader](brokers::Delivery delivery) { take(reader, std::move(delivery)); });
    } catch (const std::exception& error) {
      logger.warn("{} is not recorded: {}", label, error.what());
      const config::MutexLock lock(mutex);
      troubles[label] = error.what();
    }
  }

  recording::RecordedChannel recorded(const discovery::ChannelRecord& channel) IOTCLOUD_REQUIRES(mutex) {
    const auto& record = records[channel.instance.str()];
    return {channel.driver.str(),  channel.instance.str(), alias_of(record),
            channel.gateway.str(), channel.name,           channel.direction == discovery::Direction::out,
            channel.shared,        record.metadata};
  }

  void take(Reader& reader, brokers::Delivery delivery) {
    {
      const config::MutexLock lock(mutex);
      if (closing || !failure.empty()) return;  // the message goes back to the broker
      const auto of = reader.channels.find(delivery.message.driver_id);
      const auto chunks = writer.chunks();
      try {
        writer.add((of == reader.channels.end() ? reader.channels.begin() : of)->second, delivery.message, now());
        if (delivery.redelivered) ++redelivered;
        unsettled.push_back(std::move(delivery));
        if (unsettled.size() >= most_unsettled) writer.flush();
        if (writer.chunks() != chunks) settle();
      } catch (const std::exception& error) {
        failure = error.what();
      }
    }
    if (on_message) on_message();
  }

  /// The present, finer than the wall clock tells it, and never set back.
  recording::Instant now() const { return begin_wall + (clock.now() - begin); }

  /// All that was taken is in the file.
  void settle() IOTCLOUD_REQUIRES(mutex) {
    for (auto& delivery : unsettled) delivery.settle(brokers::Settlement::accept);
    unsettled.clear();
  }

  System& system;
  const RecordOptions options;
  const std::string group;
  const std::function<void()> on_message;
  const config::Clock& clock;
  const config::Clock::Instant begin = clock.now();
  const recording::Instant begin_wall = std::chrono::milliseconds(clock.wall_ms());
  /// Held while the file is written: brokers' threads wait for the disk here, and so hold messages back.
  mutable config::Mutex mutex;
  recording::RecordingWriter writer IOTCLOUD_GUARDED_BY(mutex);
  std::map<std::string, discovery::DriverRecord> records IOTCLOUD_GUARDED_BY(mutex);  ///< by instance
  std::map<Key, Reader> readers IOTCLOUD_GUARDED_BY(mutex);
  std::map<std::string, std::string> troubles IOTCLOUD_GUARDED_BY(mutex);
  std::vector<brokers::Delivery> unsettled IOTCLOUD_GUARDED_BY(mutex);
  std::uint64_t redelivered IOTCLOUD_GUARDED_BY(mutex) = 0;
  std::string failure IOTCLOUD_GUARDED_BY(mutex);
  bool closing IOTCLOUD_GUARDED_BY(mutex) = false;
  /// By driver. Of the registry's dispatcher, as long as `watch` is there. Last, because both use the rest.
  std::map<std::string, std::unique_ptr<discovery::DriverDirectory>> directories;
  discovery::GuardPtr watch;
};

Recorder::Recorder(System& system, RecordOptions options, std::function<void()> on_message)
    : impl_(std::make_unique<Impl>(system, std::move(options), std::move(on_message))) {
  impl_->watch_drivers();
}

Recorder::~Recorder() {
  impl_->watch.reset();
  impl_->directories.clear();
  std::vector<std::unique_ptr<brokers::Subscription>> subscriptions;
  const config::MutexLock lock(impl_->mutex);
  impl_->closing = true;
  impl_->unsettled.clear();
  for (auto& [key, reader] : impl_->readers) subscriptions.push_back(std::move(reader.subscription));
}

const std::string& Recorder::group() const {
  return impl_->group;
}

void Recorder::tick() {
  const config::MutexLock lock(impl_->mutex);
  if (!impl_->failure.empty()) return;
  try {
    impl_->writer.flush();
    impl_->settle();
  } catch (const recording::RecordingError& error) {
    impl_->failure = error.what();
  }
}

Recorder::Progress Recorder::progress() const {
  const config::MutexLock lock(impl_->mutex);
  Progress progress;
  progress.channels = impl_->readers.size();
  progress.messages = impl_->writer.messages();
  progress.redelivered = impl_->redelivered;
  progress.bytes = impl_->writer.written();
  progress.failure = impl_->failure;
  for (const auto& [channel, problem] : impl_->troubles) progress.troubles.push_back(channel + ": " + problem);
  std::set<std::string> away;
  for (const auto& [key, reader] : impl_->readers) {
    if (reader.subscription && reader.subscription->active()) ++progress.listening;
    if (reader.broker && reader.broker->state() != brokers::ConnectionState::connected)
      away.insert(fmt::format("the broker \"{}\" is {}{}", key.first, brokers::to_string(reader.broker->state()),
                              reader.broker->problem().empty() ? "" : ": " + reader.broker->problem()));
  }
  progress.troubles.insert(progress.troubles.end(), away.begin(), away.end());
  return progress;
}

void Recorder::close() {
  impl_->watch.reset();
  impl_->directories.clear();
  std::vector<Impl::Reader> readers;
  {
    const config::MutexLock lock(impl_->mutex);
    impl_->closing = true;
    if (impl_->failure.empty()) {
      try {
        impl_->writer.flush();
        impl_->settle();
      } catch (const recording::RecordingError& error) {
        impl_->failure = error.what();
      }
    }
    for (auto& [key, reader] : impl_->readers)
      readers.push_back({reader.broker, reader.topic, {}, std::move(reader.subscription)});
  }
  // A handler that waits for the lock ends first.
  for (auto& reader : readers) reader.subscription.reset();
  for (auto& reader : readers) {
    if (reader.broker) reader.broker->remove_queue(reader.topic, impl_->group);
  }
  const config::MutexLock lock(impl_->mutex);
  if (!impl_->failure.empty()) throw recording::RecordingError(impl_->failure);
  impl_->writer.close();
}

}  // namespace iotcloud::recorder
