#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/topology/endpoints/receiving/sender_filter.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

namespace {

using Standing = KnownInstances::Standing;

config::Counter& refusals(config::Metrics& metrics, config::Labels labels, const char* reason) {
  labels["reason"] = reason;
  return metrics.counter("iotcloud_spout_untrue_senders_total",
                         "Messages given up because they name a sender that their channel cannot have, by reason",
                         labels);
}

/// An id that a message says, for the log: it may be any bytes.
std::string quoted(std::string_view id) {
  return fmt::format("{:?}", id.substr(0, 64));
}

}  // namespace

SenderFilter::SenderFilter(std::shared_ptr<const KnownInstances> known, bool chooses, config::Metrics& metrics,
                           const config::Labels& labels)
    : known_(std::move(known)),
      chooses_(chooses),
      unselected_(metrics.counter("iotcloud_spout_unselected_total",
                                  "Messages on shared channels of drivers that `where` does not choose", labels)),
      other_instance_(refusals(metrics, labels, "other_instance")),
      other_gateway_(refusals(metrics, labels, "other_gateway")),
      unknown_instance_(refusals(metrics, labels, "unknown_instance")) {}

SenderFilter::Passed SenderFilter::pass(ChannelMessage arrival, Instant now) {
  const TopicReader::Sender& sender = arrival.reader->sender();
  brokers::Message& message = arrival.delivery.message;
  if (message.gateway_id.empty()) {  // as in messages of the original's gateways
    message.gateway_id = sender.gateway;
  } else if (message.gateway_id != sender.gateway.str()) {
    auto why = fmt::format("it says that it is from gateway {}", quoted(message.gateway_id));
    return refuse(std::move(arrival), other_gateway_, why);
  }
  if (!sender.driver.empty()) {  // an exclusive channel: it is read only if its instance is chosen
    if (message.driver_id.empty()) {
      message.driver_id = sender.driver;
    } else if (message.driver_id != sender.driver.str()) {
      auto why = fmt::format("it says that it is from instance {}", quoted(message.driver_id));
      return refuse(std::move(arrival), other_instance_, why);
    }
    return {std::move(arrival)};
  }
  const Standing standing = known_->of(message.driver_id, sender.gateway);
  if (waiting_.empty() && standing != Standing::unknown) return judge(std::move(arrival), standing);
  Line line(message.driver_id, sender.gateway);
  const auto queue = waiting_.find(line);
  if (queue == waiting_.end() && (standing != Standing::unknown || line.first.empty() || is_nobody(line, now)))
    return judge(std::move(arrival), standing);
  waiting_[std::move(line)].push_back({std::move(arrival), now});
  ++waiting_count_;
  return {};
}

SenderFilter::Passed SenderFilter::next(Instant now) {
  const auto news = known_->news();
  if (std::exchange(news_, news) != news) last_news_ = now;
  if (registry_keeps_silent()) last_silence_ = now;
  for (auto line = waiting_.begin(); line != waiting_.end();) {
    const auto& [instance, gateway] = line->first;
    const Standing standing = known_->of(instance.str(), gateway);
    auto& messages = line->second;
    while (!messages.empty()) {
      Waiting& first = messages.front();
      const bool gone = first.arrival.reader->closed();  // the broker delivers it again by itself
      if (!gone && standing == Standing::unknown && now < end_of_wait(first.since)) break;
      ChannelMessage arrival = std::move(first.arrival);
      messages.pop_front();
      --waiting_count_;
      if (gone) continue;
      if (standing == Standing::unknown) {
        if (nobodies_.size() >= most_nobodies) nobodies_.clear();
        nobodies_.insert_or_assign(line->first, now + nobody_for);
      }
      Passed passed = judge(std::move(arrival), standing);
      if (!passed.arrival) continue;
      if (messages.empty()) waiting_.erase(line);
      return passed;
    }
    line = messages.empty() ? waiting_.erase(line) : std::next(line);
  }
  return {};
}

/// What becomes of a message on a shared channel. \param standing that of the instance that it names
SenderFilter::Passed SenderFilter::judge(ChannelMessage arrival, Standing standing) {
  const std::string& instance = arrival.delivery.message.driver_id;
  switch (standing) {
    case Standing::chosen:
      break;
    case Standing::unchosen:
      unselected_.add();
      arrival.delivery.settle(brokers::Settlement::accept);
      return {};
    case Standing::elsewhere: {
      auto why = fmt::format("it says that it is from instance {}, which is on another gateway", quoted(instance));
      return refuse(std::move(arrival), other_gateway_, why);
    }
    case Standing::unknown: {
      if (instance.empty() && !chooses_) break;  // nobody is wronged
      auto why = instance.empty() ? "it does not say which instance it is from, so that `where` cannot choose it"
                                  : fmt::format("it says that it is from instance {}, which the registry does not have",
                                                quoted(instance));
      return refuse(std::move(arrival), unknown_instance_, why);
    }
  }
  return {std::move(arrival)};
}

/// Gives the message the ids that are known of its sender, so that what is done with it from now on, as a dead letter
/// too, is done in that name.
SenderFilter::Passed SenderFilter::refuse(ChannelMessage arrival, config::Counter& count, const std::string& why) {
  count.add();
  const TopicReader::Sender& sender = arrival.reader->sender();
  arrival.delivery.message.driver_id = sender.driver;
  arrival.delivery.message.gateway_id = sender.gateway;
  const std::string owner = sender.driver.empty() ? "" : fmt::format("instance {} on ", sender.driver);
  return {std::move(arrival), fmt::format("{}, but it came on a channel of {}gateway {}", why, owner, sender.gateway)};
}

/// Whether a message of this line has waited in vain not long ago.
bool SenderFilter::is_nobody(const Line& line, Instant now) {
  const auto nobody = nobodies_.find(line);
  if (nobody == nobodies_.end() || registry_keeps_silent()) return false;
  if (now < nobody->second) return true;
  nobodies_.erase(nobody);
  return false;
}

/// Until when a message waits that came at `since`.
SenderFilter::Instant SenderFilter::end_of_wait(Instant since) const {
  const Instant begin = std::max(since, last_silence_.value_or(since));
  return std::min(std::max(begin, last_news_.value_or(begin)) + grace, begin + longest_wait);
}

/// Whether the registry is away and messages wait for it. When there is no more room for them they do not, until it has
/// been back, or the messages of nobody would keep the spout from reading those of others.
bool SenderFilter::registry_keeps_silent() {
  if (known_->registry_tells()) {
    overrun_ = false;
    return false;
  }
  overrun_ = overrun_ || full();
  return !overrun_;
}

void SenderFilter::clear() {
  waiting_.clear();
  waiting_count_ = 0;
}

}  // namespace iotcloud::topology
