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
  if (topics == subscribed_) {
    // librdkafka puts off what it is told in the middle of a rebalance, and then may forget it: so it is told again.
    if (!subscription_is_taken_) subscription_is_taken_ = subscription() == topics;
    if (subscription_is_taken_) return;
  }
  const PartitionList list(rd_kafka_topic_partition_list_new(static_cast<int>(topics.size())));
  for (const std::string& topic : topics) {
    rd_kafka_topic_partition_list_add(list.get(), topic.c_str(), RD_KAFKA_PARTITION_UA);
  }
  const rd_kafka_resp_err_t error = rd_kafka_subscribe(client_->get(), list.get());
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) {
    subscribed_ = std::move(topics);
    subscription_is_taken_ = false;
  } else if (complaints_.insert(rd_kafka_err2str(error)).second) {
    logger.warn("group {}: cannot subscribe: {}", member_->name, rd_kafka_err2str(error));
  }
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
