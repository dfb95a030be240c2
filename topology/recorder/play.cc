#include <algorithm>
#include <chrono>
#include <filesystem>
#include <limits>
#include <set>
#include <thread>
#include <tuple>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/recorder/play.h>
#include <iotcloud/topology/testing/world.h>

namespace iotcloud::recorder {

using recording::RecordedChannel;
using recording::RecordedMessage;

namespace {

constexpr std::chrono::seconds for_room{60};
constexpr std::chrono::seconds for_confirmations{20};  // after the last one that came
constexpr std::chrono::milliseconds look_again{50};

std::string words(const RecordedChannel& channel) {
  if (channel.instance.empty()) return channel.driver;
  return channel.alias.empty() ? fmt::format("{} {}", channel.driver, channel.instance)
                               : fmt::format("{} {} ({})", channel.driver, channel.alias, channel.instance);
}

/// Plays, once or again and again.
recording::Played play_rounds(recording::RecordingReader& recording, const PlayOptions& options,
                              const std::vector<bool>& chosen, const std::function<void(RecordedMessage)>& hand,
                              const std::stop_token& stop) {
  recording::Played all;
  do {
    recording.rewind();
    const auto played = recording::play(
        recording, options.speed, [&](const RecordedMessage& message) { return chosen[message.channel]; }, hand, stop);
    all.messages += played.messages;
    all.latest = std::max(all.latest, played.latest);
    if (played.messages == 0) break;
  } while (options.loop && !stop.stop_requested());
  return all;
}

/// A channel of the running system that messages are sent on.
class Target {
 public:
  Target(System& system, const discovery::ChannelRecord& channel)
      : channel_(channel), broker_(system.broker_of(channel)) {
    brokers::PublisherOptions how;
    how.priority = topology::priority_of(channel);
    how.on_outcome = [this](std::uint64_t, brokers::Outcome outcome, const std::string& reason) {
      const config::MutexLock lock(mutex_);
      if (outcome == brokers::Outcome::confirmed) {
        ++confirmed_;
      } else {
        ++others_[reason.empty() ? "unknown" : reason];
      }
    };
    how.on_writable = [this] {
      const config::MutexLock lock(mutex_);
      ++writable_;
      changed_.notify_all();
    };
    publisher_ = broker_->publisher(System::topic_of(channel), how);
  }

  void send(brokers::Message message, const std::stop_token& stop) {
    message.driver_id = channel_.instance.str();
    message.gateway_id = channel_.gateway.str();
    const auto deadline = std::chrono::steady_clock::now() + for_room;
    while (!stop.stop_requested()) {
      std::uint64_t before = 0;
      {
        const config::MutexLock lock(mutex_);
        before = writable_;
      }
      const auto published = publisher_->publish(message);
      if (published == brokers::PublishStatus::accepted) return;
      const config::MutexLock lock(mutex_);
      while (writable_ == before && !stop.stop_requested()) {
        if (published == brokers::PublishStatus::closed || std::chrono::steady_clock::now() > deadline)
          throw config::Error(fmt::format("the channel {} of {} takes no more messages: {}", channel_.name,
                                          channel_.instance,
                                          broker_->problem().empty() ? "nobody reads it" : broker_->problem()));
        changed_.wait_for(mutex_, look_again, [&]() IOTCLOUD_REQUIRES(mutex_) { return writable_ != before; });
      }
    }
  }

  std::size_t pending() const { return publisher_->pending(); }

  void add_outcomes(PlayResult& result) {
    const bool all = publisher_->drain({});
    const config::MutexLock lock(mutex_);
    result.confirmed += confirmed_;
    for (const auto& [reason, count] : others_) result.others[reason] += count;
    if (!all) result.others["not confirmed in time"] += publisher_->pending();
  }

 private:
  const discovery::ChannelRecord channel_;
  const std::shared_ptr<brokers::Broker> broker_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::uint64_t writable_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::uint64_t confirmed_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::map<std::string, std::uint64_t> others_ IOTCLOUD_GUARDED_BY(mutex_);
  std::unique_ptr<brokers::Publisher> publisher_;  ///< last: its callbacks use the rest
};

/// The instance of the running system that takes the place of a recorded one; nullptr: there is none.
const discovery::DriverRecord* find(const RecordedChannel& channel, const PlayOptions& options,
                                    const std::vector<discovery::DriverRecord>& drivers) {
  std::string wanted = channel.instance;
  bool named = false;
  for (const auto& [recorded, live] : options.to) {
    if (!recording::names_instance(channel, recorded)) continue;
    wanted = live;
    named = true;
  }
  const auto alias = [](const discovery::DriverRecord& driver) {
    return driver.deployment.empty() ? std::string() : fmt::format("{}/{}", driver.deployment, driver.index);
  };
  for (const auto& driver : drivers) {
    if (driver.instance == std::string_view(wanted) || (named && alias(driver) == wanted)) return &driver;
  }
  for (const auto& driver : drivers) {
    if (!named && !channel.alias.empty() && driver.name == std::string_view(channel.driver) &&
        alias(driver) == channel.alias)
      return &driver;
  }
  return nullptr;
}

}  // namespace

std::vector<bool> chosen_channels(const recording::RecordingReader& recording, const PlayOptions& options) {
  const auto& channels = recording.channels();
  const auto check_recorded = [&](const std::string& word) {
    if (std::any_of(channels.begin(), channels.end(),
                    [&](const auto& c) { return recording::names_instance(c, word); }))
      return;
    std::set<std::string> known;
    for (const auto& channel : channels) known.insert(words(channel));
    throw config::Error(fmt::format("no instance \"{}\" was recorded; there are: {}", word, fmt::join(known, ", ")));
  };
  for (const auto& word : options.instances) check_recorded(word);
  for (const auto& [recorded, live] : options.to) check_recorded(recorded);
  std::set<std::string> names;
  for (const auto& channel : channels) names.insert(channel.name);
  for (const auto& word : options.channels) {
    if (!names.contains(word))
      throw config::Error(fmt::format("no channel \"{}\" was recorded; there are: {}", word, fmt::join(names, ", ")));
  }
  std::vector<bool> chosen;
  chosen.reserve(channels.size());
  const auto among = [](const std::vector<std::string>& list, const auto& fits) {
    return list.empty() || std::any_of(list.begin(), list.end(), fits);
  };
  for (const auto& channel : channels) {
    chosen.push_back(
        (channel.out || options.in) &&
        among(options.instances, [&](const auto& word) { return recording::names_instance(channel, word); }) &&
        among(options.channels, [&](const auto& word) { return word == channel.name; }));
  }
  if (std::find(chosen.begin(), chosen.end(), true) == chosen.end())
    throw config::Error("nothing of the recording is chosen" +
                        std::string(options.in ? "" : "; channels to drivers are played with --in"));
  return chosen;
}

PlayResult play_into(System& system, recording::RecordingReader& recording, const PlayOptions& options,
                     const std::stop_token& stop) {
  const auto chosen = chosen_channels(recording, options);
  auto drivers = discovery::list_drivers(system.registry(), system.paths());
  std::map<std::tuple<std::string, std::string, bool>, std::unique_ptr<Target>> targets;  // instance, channel, out
  std::vector<Target*> target_of(chosen.size(), nullptr);
  std::set<std::string> missing;
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    if (!chosen[i]) continue;
    const auto& channel = recording.channels()[i];
    const auto* driver = find(channel, options, drivers);
    if (driver == nullptr) {
      missing.insert(words(channel));
      continue;
    }
    const auto live = std::find_if(driver->channels.begin(), driver->channels.end(), [&](const auto& other) {
      return other.name == channel.name && (other.direction == discovery::Direction::out) == channel.out;
    });
    if (live == driver->channels.end()) {
      missing.insert(fmt::format("the channel {} of {}", channel.name, words(channel)));
      continue;
    }
    auto& target = targets[{driver->instance.str(), channel.name, channel.out}];
    if (!target) target = std::make_unique<Target>(system, *live);
    target_of[i] = target.get();
  }
  if (!missing.empty())
    throw config::Error(fmt::format(
        "the system has no {}; say what takes its place with --to RECORDED=ID, leave it out with --instance, or "
        "deploy replay.so, which is such an instance (drivers/replay/README.md)",
        fmt::join(missing, ", no ")));
  PlayResult result;
  result.played = play_rounds(
      recording, options, chosen,
      [&](RecordedMessage recorded) {
        if (options.times_now) recorded.message.time_ms = config::system_clock().wall_ms();
        target_of[recorded.channel]->send(std::move(recorded.message), stop);
      },
      stop);
  // A broker may have far to go: it has the time as long as it confirms some.
  auto end = std::chrono::steady_clock::now() + for_confirmations;
  for (auto before = std::numeric_limits<std::size_t>::max(); !stop.stop_requested();) {
    std::size_t pending = 0;
    for (const auto& [key, target] : targets) pending += target->pending();
    const auto now = std::chrono::steady_clock::now();
    if (pending < before) end = now + for_confirmations;
    if (pending == 0 || now > end) break;
    before = pending;
    std::this_thread::sleep_for(look_again);
  }
  for (auto& [key, target] : targets) target->add_outcomes(result);
  return result;
}

namespace {

drivers::ChannelSpec spec_of(const RecordedChannel& channel, const topology::TopologyDefinition& definition) {
  drivers::ChannelSpec spec;
  spec.name = channel.name;
  spec.direction = channel.out ? drivers::Direction::out : drivers::Direction::in;
  spec.shared = channel.shared;
  for (const auto* components : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *components) {
      const auto& endpoint = component.endpoint;
      if (endpoint && endpoint->driver == std::string_view(channel.driver) && endpoint->channel == channel.name)
        spec.broker = endpoint->broker;
    }
  }
  return spec;
}

/// The channels that the topology's sending bolts need and nobody recorded are there, too, so that what they send has
/// somewhere to go.
void add_sent_channels(const topology::TopologyDefinition& definition,
                       std::map<std::string, std::vector<drivers::ChannelSpec>>& fakes) {
  for (const auto& bolt : definition.bolts) {
    if (!bolt.endpoint) continue;
    const auto fake = fakes.find(bolt.endpoint->driver.str());
    if (fake == fakes.end()) continue;
    const auto has = [&](const auto& spec) { return spec.name == bolt.endpoint->channel; };
    if (std::any_of(fake->second.begin(), fake->second.end(), has)) continue;
    drivers::ChannelSpec spec;
    spec.name = bolt.endpoint->channel;
    spec.direction = drivers::Direction::in;
    spec.broker = bolt.endpoint->broker;
    fake->second.push_back(std::move(spec));
  }
}

/// A spout, and which channels of a recording it reads when they are played to it.
struct PlayedInput {
  PlayedInput(const topology::ComponentDefinition& spout, const recording::RecordingReader& recording,
              const std::string& gateway)
      : id(spout.id) {
    discovery::DriverRecord instance;
    instance.gateway = discovery::GatewayId(gateway);
    instance.state = discovery::DriverState::active;
    for (const auto& channel : recording.channels()) {
      instance.name = discovery::DriverName(channel.driver);
      instance.metadata = channel.metadata;
      reads.push_back(channel.driver == spout.endpoint->driver.str() && channel.name == spout.endpoint->channel &&
                      spout.endpoint->where.matches(instance));
    }
  }
  std::string id;
  std::vector<bool> reads;
  std::uint64_t played = 0;  ///< messages for it
};

/// Waits until the topology has processed all that came, as far as one sees from outside: nothing is under way, and
/// nothing changes; for longer while a spout lacks messages, which a busy machine brings late and a spout may also have
/// left out. \return what it has done.
topology::Snapshot wait_until_idle(topology::Worker& worker, const std::vector<PlayedInput>& inputs,
                                   const std::stop_token& stop) {
  constexpr int quiet_looks = 10, quiet_looks_while_some_lack = 200;
  config::Mutex mutex;
  config::StoppableConditionVariable end;
  std::uint64_t before = 0;
  auto snapshot = worker.snapshot();
  const auto looks = [&] {
    const bool all_came = std::all_of(inputs.begin(), inputs.end(), [&](const PlayedInput& input) {
      return snapshot.component(input.id).emitted >= input.played;
    });
    return all_came ? quiet_looks : quiet_looks_while_some_lack;
  };
  for (int quiet = 0; quiet < looks() && !stop.stop_requested();) {
    std::uint64_t done = 0;
    std::size_t under_way = 0;
    for (const auto& task : snapshot.tasks) {
      done += task.executed + task.emitted + task.acked + task.failed;
      under_way += task.pending + task.queue_depth;
    }
    quiet = under_way == 0 && done == before ? quiet + 1 : 0;
    before = done;
    const config::MutexLock lock(mutex);
    end.wait_for(mutex, stop, look_again, [&] { return stop.stop_requested(); });
    snapshot = worker.snapshot();
  }
  return snapshot;
}

}  // namespace

PlayResult play_to_topology(const std::string& yaml_file, const std::vector<std::string>& library_folders,
                            recording::RecordingReader& recording, const PlayOptions& options,
                            const std::function<void(const std::string&)>& news, const std::stop_token& stop) {
  using topology::testing::FakeInstance;
  const auto chosen = chosen_channels(recording, options);
  auto definition = topology::TopologyDefinition::load(yaml_file);
  definition.brokers.clear();  // no server of the file is touched
  topology::testing::WorldOptions world_options;
  std::set<std::string> names;
  for (const auto* components : {&definition.spouts, &definition.bolts}) {
    for (const auto& component : *components) {
      if (component.endpoint) names.insert(component.endpoint->broker);
    }
  }
  world_options.brokers = {names.begin(), names.end()};
  if (names.empty()) world_options.brokers = {"rabbitmq"};
  for (const auto& folder : library_folders) {
    if (std::filesystem::is_directory(folder)) world_options.plugin_dir = folder;
  }
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    if (!chosen[i]) continue;
    const auto& channel = recording.channels()[i];
    auto& specs = world_options.fakes[channel.driver];
    const auto same = [&](const auto& spec) { return spec.name == channel.name; };
    if (std::none_of(specs.begin(), specs.end(), same)) specs.push_back(spec_of(channel, definition));
  }
  add_sent_channels(definition, world_options.fakes);

  std::vector<PlayedInput> inputs;
  for (const auto& spout : definition.spouts) {
    if (spout.endpoint) inputs.emplace_back(spout, recording, world_options.gateways.front());
  }
  topology::testing::World world(std::move(world_options));
  auto& worker = world.cluster().run_topology(std::move(definition));
  std::map<std::pair<std::string, std::string>, FakeInstance*> instances;
  std::vector<FakeInstance*> instance_of(chosen.size(), nullptr);
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    if (!chosen[i]) continue;
    const auto& channel = recording.channels()[i];
    auto& instance = instances[{channel.driver, channel.instance}];
    if (instance == nullptr) {
      instance = &world.add(channel.driver);
      instance->update_metadata(channel.metadata);
    }
    instance_of[i] = instance;
  }
  news(fmt::format("{} instances play to {}", instances.size(), yaml_file));
  PlayResult result;
  result.played = play_rounds(
      recording, options, chosen,
      [&](RecordedMessage recorded) {
        if (options.times_now) recorded.message.time_ms = config::system_clock().wall_ms();
        recorded.message.driver_id.clear();
        recorded.message.gateway_id.clear();
        for (auto& input : inputs) input.played += input.reads[recorded.channel] ? 1 : 0;
        instance_of[recorded.channel]->publish(recording.channels()[recorded.channel].name,
                                               std::move(recorded.message));
      },
      stop);
  const auto snapshot = wait_until_idle(worker, inputs, stop);
  result.confirmed = result.played.messages;
  std::set<std::string> told;
  for (const auto& task : snapshot.tasks) {
    if (!told.insert(task.component).second) continue;
    const auto sum = snapshot.component(task.component);
    std::string line = fmt::format("  {}:", task.component);
    if (!task.spout) line += fmt::format(" took {},", sum.executed);
    line += fmt::format(" emitted {}", sum.emitted);
    if (sum.failed > 0) line += fmt::format(", failed {}", sum.failed);
    if (sum.errors > 0) line += fmt::format(", error: {}", sum.last_error);
    news(line);
  }
  world.stop(std::chrono::seconds(5));
  return result;
}

}  // namespace iotcloud::recorder
