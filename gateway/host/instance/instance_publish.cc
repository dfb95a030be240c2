// The outgoing side of an instance.
#include <algorithm>
#include <exception>
#include <filesystem>

#include <fmt/format.h>

#include <iotcloud/brokers/spool/spooled_publisher.h>
#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/instance/instance.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log_to{"gateway.host"};

/// What became of a channel's messages, under their reasons.
class OutcomeCounters {
 public:
  OutcomeCounters(config::Metrics& metrics, const discovery::ChannelRecord& channel)
      : metrics_(metrics),
        labels_{{"driver", channel.driver}, {"channel", channel.name}},
        confirmed_(counter("confirmed", "")),
        would_block_(counter("would_block", "")) {}

  void count(brokers::Outcome outcome, const std::string& reason) {
    switch (outcome) {
      case brokers::Outcome::confirmed:
        confirmed_.add();
        break;
      case brokers::Outcome::refused:
        counter("refused", reason).add();
        break;
      case brokers::Outcome::dropped:
        counter("dropped", reason).add();
        break;
      case brokers::Outcome::unknown:
        counter("unknown", reason).add();
        break;
    }
  }
  void count_would_block() { would_block_.add(); }

 private:
  config::Counter& counter(const char* outcome, const std::string& reason) {
    auto labels = labels_;
    labels["outcome"] = outcome;
    if (!reason.empty()) labels["reason"] = reason;
    return metrics_.counter("iotcloud_driver_messages_total", "Messages of drivers, by what became of them", labels);
  }
  config::Metrics& metrics_;
  const config::Labels labels_;
  config::Counter& confirmed_;
  config::Counter& would_block_;
};

brokers::SpoolOptions spool_options(const drivers::Spool& spool) {
  brokers::SpoolOptions options;
  options.max_bytes = spool.bytes;
  options.when_full =
      spool.full == drivers::Spool::Full::block ? brokers::SpoolFull::block : brokers::SpoolFull::drop_oldest;
  switch (spool.fsync) {
    case drivers::Spool::Fsync::never:
      options.sync = brokers::SpoolSync::never;
      break;
    case drivers::Spool::Fsync::interval:
      options.sync = brokers::SpoolSync::interval;
      break;
    case drivers::Spool::Fsync::always:
      options.sync = brokers::SpoolSync::always;
      break;
  }
  return options;
}

}  // namespace

struct Instance::Outgoing {
  std::string spool_folder;  ///< empty: it has none
  std::shared_ptr<OutcomeCounters> counters;
  std::shared_ptr<brokers::Broker> broker;        ///< before what uses it
  std::unique_ptr<brokers::Publisher> publisher;  ///< last: dies first
};

void Instance::open_outgoing(const PlannedChannel& channel) {
  auto outgoing = std::make_shared<Outgoing>();
  outgoing->counters = std::make_shared<OutcomeCounters>(*environment_->metrics, channel.record);
  outgoing->broker = environment_->brokers->get(channel.address, channel.broker);
  brokers::PublisherOptions options;
  options.when_full = channel.spec.when_full == drivers::WhenFull::keep_newest ? brokers::WhenFull::keep_newest
                                                                               : brokers::WhenFull::block;
  options.capacity = channel.spec.capacity;
  options.deadline = channel.spec.deadline;
  options.priority = channel.spec.priority;
  options.own_queue = channel.own_queue;
  options.on_outcome = [counters = outgoing->counters](std::uint64_t, brokers::Outcome outcome,
                                                       const std::string& reason) { counters->count(outcome, reason); };
  options.on_writable = [weak = weak_from_this(), name = channel.spec.name] {
    const auto self = weak.lock();
    if (!self) return;
    self->loop_->post([self, name] {
      if (!self->running()) return;
      self->call("on_writable", [&](std::string& error) { self->shell_->on_writable(name, error); });
    });
  };
  if (channel.spec.when_full == drivers::WhenFull::spool) {
    brokers::SpoolOptions spool = spool_options(channel.spec.spool);
    spool.folder = outgoing->spool_folder = spool_folder(channel.spec.name);
    spool.labels = {{"driver", channel.record.driver}, {"channel", channel.spec.name}};
    spool.clock = environment_->clock;
    spool.metrics = environment_->metrics;
    outgoing->publisher = brokers::make_spooled_publisher(*outgoing->broker, channel.topic, options, spool);
  } else {
    outgoing->publisher = outgoing->broker->publisher(channel.topic, options);
  }
  const std::unique_lock lock(channels_mutex_);
  outgoing_.emplace(channel.spec.name, std::move(outgoing));
}

std::string Instance::spool_folder(const std::string& channel) const {
  if (environment_->state_folder.empty()) {
    throw config::Error(
        fmt::format("channel \"{}\" is to be spooled to disk, but this driver host has no state folder to keep it in; "
                    "set channel.{}.when_full to block or keep_newest, or run the driver under a gateway",
                    channel, channel));
  }
  check_name("the instance id of a spool", id_);
  return fmt::format("{}/spool/{}/{}", environment_->state_folder, id_, channel);
}

/// Closes a channel's publisher. What its spool still has stays there for a later life of the instance.
void Instance::close_outgoing(const std::string& name, Outgoing& outgoing) {
  const std::size_t left = outgoing.publisher->pending();
  outgoing.publisher.reset();
  if (outgoing.spool_folder.empty()) {
    if (left > 0)
      log_to.warn("{}: channel {} closed with {} message(s) that the broker has not confirmed", id_, name, left);
    return;
  }
  if (left > 0) {
    log_to.warn(
        "{}: channel {} closed with {} message(s) that the broker has not confirmed; they are kept in {} and sent "
        "when an instance of this id has the channel again; delete the folder if that is not to be",
        id_, name, left, outgoing.spool_folder);
  }
  std::error_code not_empty;
  std::filesystem::remove(std::filesystem::path(outgoing.spool_folder).parent_path(), not_empty);
}

drivers::PublishStatus Instance::publish(std::string_view channel, drivers::Message message) noexcept try {
  if (!running()) return drivers::PublishStatus::closed;
  const std::shared_lock lock(channels_mutex_);
  const auto found = outgoing_.find(channel);
  if (found == outgoing_.end()) return drivers::PublishStatus::closed;
  message.driver_id = id_;
  message.gateway_id = environment_->gateway;
  if (message.time_ms == 0) message.time_ms = environment_->clock->wall_ms();
  switch (found->second->publisher->publish(std::move(message))) {
    case brokers::PublishStatus::accepted:
      return drivers::PublishStatus::accepted;
    case brokers::PublishStatus::would_block:
      found->second->counters->count_would_block();
      return drivers::PublishStatus::would_block;
    case brokers::PublishStatus::closed:
      break;
  }
  return drivers::PublishStatus::closed;
} catch (const std::exception& e) {
  log_to.error("{}: publish on {} failed: {}", id_, channel, e.what());
  return drivers::PublishStatus::closed;
}

void Instance::drain_then_report(discovery::DriverState final_state, const std::string& reason) {
  auto closing = std::make_shared<std::map<std::string, std::shared_ptr<Outgoing>, std::less<>>>();
  {
    const std::unique_lock lock(channels_mutex_);  // waits for a publish that is under way
    closing->swap(outgoing_);
  }
  // A failure is told at once; the end of an instance when its messages are out.
  const bool failed = final_state == discovery::DriverState::failed;
  if (failed) {
    // Its successor opens the spools as soon as it knows; what is in them is not lost.
    for (auto& [name, outgoing] : *closing) {
      if (!outgoing->spool_folder.empty()) close_outgoing(name, *outgoing);
    }
    report(final_state, reason);
  }
  const auto deadline = environment_->clock->now() + environment_->drain_limit;
  environment_->closing->post([self = shared_from_this(), closing, deadline, failed, final_state, reason] {
    for (auto& [name, outgoing] : *closing) {
      if (!outgoing->publisher) continue;
      const auto left = std::max(deadline - self->environment_->clock->now(), config::Clock::Instant::duration::zero());
      outgoing->publisher->drain(std::chrono::duration_cast<std::chrono::milliseconds>(left));
      self->close_outgoing(name, *outgoing);
    }
    closing->clear();
    if (!failed) self->report(final_state, reason);
  });
}

}  // namespace iotcloud::gateway
