// What a group subscribes to: topics that are wanted, were made where they were missing, and are known to the servers.
#include <algorithm>
#include <iterator>

#include "iotcloud/brokers/kafka/reading/group.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::kafka {
namespace {

const config::Logger logger{"brokers.kafka"};

}  // namespace

void Group::follow_subscriptions(Instant now) {
  if (!connected_) return;
  const std::set<std::string> wanted = reader_->topics(*member_);
  if (asked_.empty() && ask_topics_at_ <= now) {
    std::set_difference(wanted.begin(), wanted.end(), made_.begin(), made_.end(), std::back_inserter(asked_));
    if (!asked_.empty()) request_topics(*client_, events_.get(), asked_, options_);
    for (const std::string& topic : made_) {
      if (there_.contains(topic)) continue;
      // A group that subscribes too early looks again only after a long while.
      if (!client_->knows(topic, options_.broker.rpc_timeout)) {
        made_ = there_;  // so it is asked for again
        ask_topics_at_ = clock_.now() + topic_backoff_.next();
        break;
      }
      topic_backoff_.reset();
      there_.insert(topic);
    }
  }
  std::set<std::string> topics;
  std::set_intersection(wanted.begin(), wanted.end(), there_.begin(), there_.end(),
                        std::inserter(topics, topics.end()));
  if (topics.empty()) return;
  std::set<std::string> told;
  std::set_difference(topics.begin(), topics.end(), forgotten_.begin(), forgotten_.end(),
                      std::inserter(told, told.end()));
  if (told == subscribed_) {
    // librdkafka puts off what it is told in the middle of a rebalance, and then may forget it: so it is told again.
    if (!subscription_is_taken_) subscription_is_taken_ = subscription() == told;
    if (subscription_is_taken_) {
      if (forgotten_.empty()) return join_for_unread(now);
      forgotten_.clear();  // the group is without them now
      told = std::move(topics);
    }
  } else if (forgotten_.empty()) {
    join_backoff_.reset();
  }
  tell_subscription(std::move(told));
}

void Group::tell_subscription(std::set<std::string> topics) {
  rd_kafka_resp_err_t error = RD_KAFKA_RESP_ERR_NO_ERROR;
  if (topics.empty()) {
    error = rd_kafka_unsubscribe(client_->get());
  } else {
    const PartitionList list(rd_kafka_topic_partition_list_new(static_cast<int>(topics.size())));
    for (const std::string& topic : topics) {
      rd_kafka_topic_partition_list_add(list.get(), topic.c_str(), RD_KAFKA_PARTITION_UA);
    }
    error = rd_kafka_subscribe(client_->get(), list.get());
  }
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) {
    subscribed_ = std::move(topics);
    subscription_is_taken_ = false;
    join_again_at_ = Instant{};
  } else if (complaints_.insert(rd_kafka_err2str(error)).second) {
    logger.warn("group {}: cannot subscribe: {}", member_->name, rd_kafka_err2str(error));
  }
}

// The member that places the partitions asks one node for them, and takes a topic which that one does not know yet for
// one without partitions. librdkafka 2.0.2 hears of them later and lets it be: the topic would never have a reader. Who
// got nothing of a topic joins again for it, more and more rarely: others may have all of it.
void Group::join_for_unread(Instant now) {
  if (join_again_at_ == Instant{} || now < join_again_at_) return;
  forgotten_ = unread();
  logger.debug("group {}: got no partition of {} topics; joining again", member_->name, forgotten_.size());
  std::set<std::string> read;
  std::set_difference(subscribed_.begin(), subscribed_.end(), forgotten_.begin(), forgotten_.end(),
                      std::inserter(read, read.end()));
  tell_subscription(std::move(read));
}

std::set<std::string> Group::unread() const {
  std::set<std::string> topics = subscribed_;
  for (const auto& [topic, partition] : assigned_) topics.erase(topic);
  return topics;
}

void Group::on_topics(rd_kafka_event_t* event) {
  for (const MadeTopic& made : made_topics(event, asked_)) {
    if (!made.complaint.empty() && complaints_.insert(made.name + made.complaint).second) {
      logger.warn("cannot make the topic {}: {}; {}", made.name, made.complaint,
                  made.there ? "using it if it is there" : "trying again");
    }
    if (made.there) {
      made_.insert(made.name);
    } else {
      ask_topics_at_ = clock_.now() + topic_backoff_.next();
    }
  }
  asked_.clear();
}

std::set<std::string> Group::subscription() const {
  rd_kafka_topic_partition_list_t* list = nullptr;
  if (rd_kafka_subscription(client_->get(), &list) != RD_KAFKA_RESP_ERR_NO_ERROR) return {};
  const PartitionList owned(list);
  std::set<std::string> topics;
  for (const auto& entry : entries_of(*list)) topics.insert(entry.topic);
  return topics;
}

}  // namespace iotcloud::brokers::kafka
