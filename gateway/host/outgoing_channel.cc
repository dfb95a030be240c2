#include <algorithm>
#include <filesystem>

#include <fmt/format.h>

#include <iotcloud/brokers/spool/spooled_publisher.h>
#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/outgoing_channel.h>

namespace iotcloud::gateway {

namespace {

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

/// The folder of the channel's spool. \throws config::Error if the host has no state folder.
std::string spool_folder_of(const HostEnvironment& environment, const discovery::InstanceId& instance,
                            const std::string& channel) {
  if (environment.state_folder.empty()) {
    throw config::Error(
        fmt::format("channel \"{}\" is to be spooled to disk, but this driver host has no state folder to keep it in; "
                    "set channel.{}.when_full to block or keep_newest, or run the driver under a gateway",
                    channel, channel));
  }
  check_name("the instance id of a spool", instance);
  return fmt::format("{}/spool/{}/{}", environment.state_folder, instance, channel);
}

}  // namespace

/// Counts the outcomes of a channel's messages, by reason.
class OutgoingChannel::OutcomeCounters {
 public:
  OutcomeCounters(config::Metrics& metrics, const discovery::ChannelRecord& channel)
      : metrics_(metrics),
        labels_{{"driver", channel.driver}, {"channel", channel.name}},
        confirmed_(counter("confirmed", "")),
        would_block_(counter("would_block", "")) {}

  /// \return the message's fate (discovery::SeenMessage::fate)
  std::string count(brokers::Outcome outcome, const std::string& reason) {
    if (outcome == brokers::Outcome::confirmed) {
      confirmed_.add();
      tally_.done();
      return "confirmed";
    }
    const char* const word = outcome == brokers::Outcome::refused   ? "refused"
                             : outcome == brokers::Outcome::dropped ? "dropped"
                                                                    : "unknown";
    counter(word, reason).add();
    std::string fate = reason.empty() ? word : fmt::format("{}: {}", word, reason);
    tally_.lost(fate);
    return fate;
  }
  void count_would_block() {
    would_block_.add();
    tally_.refused("not taken: would_block");
  }
  const ChannelTally& tally() const { return tally_; }

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
  ChannelTally tally_;
};

OutgoingChannel::OutgoingChannel(const HostEnvironment& environment, discovery::InstanceId instance,
                                 const PlannedChannel& channel, Events events)
    : instance_(std::move(instance)),
      name_(channel.spec.name),
      clock_(*environment.clock),
      looks_(clock_),
      counters_(std::make_shared<OutcomeCounters>(*environment.metrics, channel.record)),
      broker_(environment.brokers->get(channel.address, channel.broker)) {
  brokers::PublisherOptions options;
  options.when_full = channel.spec.when_full == drivers::WhenFull::keep_newest ? brokers::WhenFull::keep_newest
                                                                               : brokers::WhenFull::block;
  options.capacity = channel.spec.capacity;
  options.deadline = channel.spec.deadline;
  options.priority = channel.spec.priority;
  options.own_queue = channel.own_queue;
  options.original_queue = channel.original_queue;
  options.on_outcome = [counters = counters_, looks = &looks_](std::uint64_t number, brokers::Outcome outcome,
                                                               const std::string& reason) {
    const std::string fate = counters->count(outcome, reason);
    if (looks->watched()) looks->ended(number, fate);
  };
  options.on_writable = std::move(events.on_writable);
  if (channel.spec.when_full != drivers::WhenFull::spool) {
    publisher_ = broker_->publisher(channel.topic, options);
    return;
  }
  brokers::SpoolOptions spool = spool_options(channel.spec.spool);
  spool.folder = spool_folder_ = spool_folder_of(environment, instance_, name_);
  spool.labels = {{"driver", channel.record.driver}, {"channel", name_}};
  spool.clock = environment.clock;
  spool.metrics = environment.metrics;
  spool.on_stored = std::move(events.on_stored);
  publisher_ = brokers::make_spooled_publisher(*broker_, channel.topic, options, spool);
}

OutgoingChannel::~OutgoingChannel() {
  close();
}

drivers::PublishStatus OutgoingChannel::publish(drivers::Message message) {
  std::uint64_t number = 0;
  if (!looks_.watched()) return pass_on(std::move(message), number);
  const drivers::Message seen = message;
  const auto begin = clock_.now();
  const auto status = pass_on(std::move(message), number);
  if (status == drivers::PublishStatus::accepted) looks_.saw(seen, {number, begin});
  return status;
}

const ChannelTally& OutgoingChannel::tally() const {
  return counters_->tally();
}

ChannelQueue::Backlog OutgoingChannel::backlog() const {
  ChannelQueue::Backlog backlog{publisher_->pending()};
  if (const auto oldest = publisher_->oldest()) {
    const auto age = std::chrono::duration_cast<std::chrono::milliseconds>(clock_.now() - *oldest);
    backlog.oldest = std::max(age, std::chrono::milliseconds{0});
  }
  return backlog;
}

/// \param number set to the publisher's number of a message that it has accepted
drivers::PublishStatus OutgoingChannel::pass_on(drivers::Message message, std::uint64_t& number) {
  const auto published = publisher_->publish(std::move(message));
  number = published.number;
  switch (published.status) {
    case brokers::PublishStatus::accepted:
      return drivers::PublishStatus::accepted;
    case brokers::PublishStatus::would_block:
      counters_->count_would_block();
      return drivers::PublishStatus::would_block;
    case brokers::PublishStatus::closed:
      break;
  }
  return drivers::PublishStatus::closed;
}

void OutgoingChannel::drain(std::chrono::milliseconds limit) {
  if (publisher_) publisher_->drain(limit);
}

void OutgoingChannel::close() {
  if (!publisher_) return;
  const std::size_t left = publisher_->pending();
  publisher_.reset();
  if (!spooled()) {
    if (left > 0)
      host_logger.warn("{}: channel {} closed with {} message(s) that the broker has not confirmed", instance_, name_,
                       left);
    return;
  }
  if (left > 0) {
    host_logger.warn(
        "{}: channel {} closed with {} message(s) that the broker has not confirmed; they are kept in {} and sent "
        "when an instance of this id has the channel again; delete the folder if that is not to be",
        instance_, name_, left, spool_folder_);
  }
  std::error_code not_empty;
  std::filesystem::remove(std::filesystem::path(spool_folder_).parent_path(), not_empty);
}

}  // namespace iotcloud::gateway
