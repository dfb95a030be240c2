#include <exception>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/open_channels.h>

namespace iotcloud::gateway {

namespace {

/// Tells what became of a message that a person handed to the instance: settling its delivery is the answer.
class HandedAnswer final : public brokers::Settler {
 public:
  explicit HandedAnswer(std::function<void(const std::string& problem)> done) : done_(std::move(done)) {}
  void settle(std::uint64_t, brokers::Settlement settlement) noexcept override try {
    switch (settlement) {
      case brokers::Settlement::accept:
        return done_("");
      case brokers::Settlement::reject:
        return done_("the driver failed on the message; `iotcloud logs` says why");
      case brokers::Settlement::retry:
        return done_("the instance ended before its driver saw the message; send it again when the instance is active");
    }
  } catch (const std::exception& e) {
    host_logger.error("nobody is told what became of a message by hand: {}", e.what());
  }

 private:
  const std::function<void(const std::string& problem)> done_;
};

}  // namespace

void OpenChannels::add_outgoing(const PlannedChannel& channel, std::unique_ptr<OutgoingChannel> outgoing) {
  auto broker = environment_.brokers->get(channel.address, channel.broker);
  const config::WriteLock lock(mutex_);
  outgoing_.emplace(channel.spec.name, std::move(outgoing));
  channels_[channel.spec.name] = {channel.record, std::move(broker)};
}

void OpenChannels::add_incoming(const PlannedChannel& channel, std::shared_ptr<brokers::Broker> broker,
                                std::shared_ptr<ChannelQueue> queue, std::shared_ptr<ChannelLooks> looks) {
  const config::WriteLock lock(mutex_);
  channels_[channel.spec.name] = {channel.record, std::move(broker), std::move(queue), std::move(looks)};
}

void OpenChannels::hide() {
  const config::WriteLock lock(mutex_);
  channels_.clear();
}

OpenChannels::Outgoing OpenChannels::take_outgoing() {
  const config::WriteLock lock(mutex_);  // waits for running publish() calls
  channels_.clear();
  return std::exchange(outgoing_, {});
}

std::optional<drivers::PublishStatus> OpenChannels::publish(std::string_view channel, drivers::Message& message) {
  const config::ReadLock lock(mutex_);
  const auto found = outgoing_.find(channel);
  if (found == outgoing_.end()) return std::nullopt;
  return found->second->publish(std::move(message));
}

std::vector<std::string> OpenChannels::outgoing_names() const {
  std::vector<std::string> names;
  const config::ReadLock lock(mutex_);
  for (const auto& [name, outgoing] : outgoing_) names.push_back(name);
  return names;
}

ChannelQueue::Backlog OpenChannels::backlog_of(const std::string& name, const OpenChannel& channel) const {
  if (channel.queue) return channel.queue->backlog(environment_.clock->now());
  const auto outgoing = outgoing_.find(name);
  return outgoing == outgoing_.end() ? ChannelQueue::Backlog{} : outgoing->second->backlog();
}

/// \return null: the channel is being closed
const ChannelTally* OpenChannels::tally_of(const std::string& name, const OpenChannel& channel) const {
  if (channel.queue) return &channel.queue->tally();
  const auto outgoing = outgoing_.find(name);
  return outgoing == outgoing_.end() ? nullptr : &outgoing->second->tally();
}

void OpenChannels::each_tally(
    const std::function<void(const discovery::ChannelRecord&, const ChannelTally&)>& use) const {
  const config::ReadLock lock(mutex_);
  for (const auto& [name, channel] : channels_) {
    if (const auto* const tally = tally_of(name, channel)) use(channel.record, *tally);
  }
}

void OpenChannels::each_backlog(
    const std::function<void(const discovery::ChannelRecord&, const ChannelQueue::Backlog&)>& use) const {
  const config::ReadLock lock(mutex_);
  for (const auto& [name, channel] : channels_) use(channel.record, backlog_of(name, channel));
}

std::vector<discovery::ChannelState> OpenChannels::states() const {
  std::vector<discovery::ChannelState> states;
  for (const auto& [name, channel] : channels_) {
    discovery::ChannelState state;
    state.name = name;
    state.direction = channel.record.direction;
    state.shared = channel.record.shared;
    state.broker = channel.record.transport;
    state.url = brokers::printable_url(channel.record.broker_url);
    state.broker_state = brokers::to_string(channel.broker->state());
    state.broker_problem = channel.broker->problem();
    const auto backlog = backlog_of(name, channel);
    state.waiting = static_cast<std::int64_t>(backlog.waiting);
    state.oldest_ms = backlog.oldest.count();
    if (const auto* const tally = tally_of(name, channel)) {
      auto counts = tally->counts();
      state.done = counts.done;
      state.lost = std::move(counts.lost);
    }
    states.push_back(std::move(state));
  }
  return states;
}

std::string OpenChannels::unknown(const std::string& name) const {
  std::string known;
  for (const auto& [other, channel] : channels_) {
    known += fmt::format("{}\"{}\" ({})", known.empty() ? "" : ", ", other,
                         channel.record.direction == discovery::Direction::out ? "out" : "in");
  }
  return fmt::format("instance {} has no channel \"{}\"; it has {}", id_, name, known.empty() ? "none" : known);
}

void OpenChannels::look(const discovery::LookRequest& request, discovery::ChannelLook& answer) const {
  const config::ReadLock lock(mutex_);
  answer.channels = states();
  if (request.channel.empty()) return;
  const auto found = channels_.find(request.channel);
  if (found == channels_.end()) {
    answer.problem = channels_.empty() ? fmt::format("instance {} is {} and has no open channel{}{}", id_, answer.state,
                                                     answer.reason.empty() ? "" : ": ", answer.reason)
                                       : unknown(request.channel);
  } else if (const auto outgoing = outgoing_.find(request.channel); outgoing != outgoing_.end()) {
    outgoing->second->looks().answer(request, answer);
  } else if (found->second.looks) {
    found->second.looks->answer(request, answer);
  }
}

void OpenChannels::hand(const std::string& channel, brokers::Message message,
                        const std::function<void(const std::string& problem)>& done) {
  std::shared_ptr<ChannelQueue> queue;
  std::string problem;
  {
    const config::ReadLock lock(mutex_);
    const auto found = channels_.find(channel);
    if (found == channels_.end()) {
      problem = unknown(channel);
    } else if (!found->second.queue) {
      problem = fmt::format("channel \"{}\" of instance {} is outgoing: its driver sends on it, and receives nothing",
                            channel, id_);
    } else {
      queue = found->second.queue;
    }
  }
  if (!queue) {
    done(problem);
    return;
  }
  // As one that another host has passed: it does not wait for the instance's next life.
  queue->push({brokers::Delivery(std::move(message), false, std::make_shared<HandedAnswer>(done), 0),
               environment_.clock->now(), 0, true});
}

}  // namespace iotcloud::gateway
