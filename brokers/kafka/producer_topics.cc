#include "iotcloud/brokers/kafka/producer_topics.h"

#include <algorithm>
#include <utility>

#include <iotcloud/brokers/kafka/logger.h>

namespace iotcloud::brokers::kafka {

void ProducerTopics::ask(const KafkaClient& client, rd_kafka_queue_t* events, const KafkaOptions& options,
                         Instant now) {
  if (!asked_.empty() || now < ask_at_) return;
  for (const auto& [name, lane] : lanes_) {
    if (!lane.topic && !lane.made) asked_.push_back(name);
  }
  if (!asked_.empty()) request_topics(client, events, asked_, options);
}

void ProducerTopics::on_answer(rd_kafka_event_t* event, Instant now) {
  for (const MadeTopic& made : made_topics(event, asked_)) {
    TopicLane& lane = lanes_[made.name];
    if (!made.complaint.empty() && std::exchange(lane.complaint, made.complaint) != made.complaint) {
      logger.warn("cannot make the topic {}: {}; {}", made.name, made.complaint,
                  made.there ? "using it if it is there" : "trying again");
    }
    if (!made.there) {
      ask_at_ = now + backoff_.next();
      continue;
    }
    lane.made = true;
  }
  asked_.clear();
}

std::vector<std::string> ProducerTopics::unseen(Instant now) const {
  std::vector<std::string> names;
  if (!asked_.empty() || now < ask_at_) return names;
  for (const auto& [name, lane] : lanes_) {
    if (lane.made && !lane.topic) names.push_back(name);
  }
  return names;
}

void ProducerTopics::not_there(const std::string& name, Instant now) {
  lanes_[name].made = false;  // so that ask() asks for it again
  ask_at_ = now + backoff_.next();
}

void ProducerTopics::there(const std::string& name, int partitions, const KafkaClient& client) {
  backoff_.reset();
  rd_kafka_topic_t* const made = rd_kafka_topic_new(client.get(), name.c_str(), nullptr);
  if (made == nullptr) return;
  TopicLane& lane = lanes_[name];
  lane.topic.reset(made, TopicDestroyer());
  lane.first_messages.begin_anew(partitions);
}

void ProducerTopics::gone(TopicLane& lane) {
  lane.made = false;
  lane.topic.reset();
}

ProducerTopics::Instant ProducerTopics::next_look() const {
  if (!asked_.empty()) return Instant::max();
  const bool all =
      std::all_of(lanes_.begin(), lanes_.end(), [](const auto& lane) { return lane.second.topic != nullptr; });
  return all ? Instant::max() : ask_at_;
}

void ProducerTopics::forget() {
  asked_.clear();
  for (auto& [name, lane] : lanes_) gone(lane);
}

}  // namespace iotcloud::brokers::kafka
