#include "iotcloud/brokers/kafka/reading/group.h"

#include <algorithm>
#include <exception>
#include <iterator>
#include <span>
#include <utility>

#include <iotcloud/brokers/kafka/logger.h>
#include <iotcloud/brokers/kafka/reading/assignment.h>

namespace iotcloud::brokers::kafka {
namespace {

constexpr std::chrono::milliseconds committed_limit{3000};
constexpr std::chrono::milliseconds handler_limit{1000};  // how long handlers of revoked partitions may still run
constexpr std::chrono::milliseconds commit_period{100};
constexpr std::chrono::milliseconds last_commit_limit{3000};  // a group in a rebalance refuses commits meanwhile
constexpr std::chrono::milliseconds last_commit_pause{50};
constexpr std::chrono::milliseconds subscription_pause{20};
constexpr std::chrono::milliseconds leave_limit{5000};  // after that the server notices by the session's time-out
constexpr std::size_t most_complaints = 100;
constexpr std::chrono::milliseconds usual_session{6000};  // the shortest that servers allow unless told otherwise

Settings consumer_settings(const std::string& group, std::chrono::milliseconds session) {
  return {
      {"group.id", group},
      {"enable.auto.commit", "false"},
      {"enable.auto.offset.store", "false"},
      {"auto.offset.reset", "earliest"},
      {"partition.assignment.strategy", assignment_strategy(rd_kafka_version())},
      {"session.timeout.ms", std::to_string(session.count())},
      {"heartbeat.interval.ms", std::to_string(session.count() / 4)},
      // This is also how long other members wait for this one in a rebalance. The groups' thread polls often.
      {"max.poll.interval.ms", std::to_string(std::max<std::int64_t>(60'000, 2 * session.count()))},
      {"fetch.wait.max.ms", "500"},
      {"queued.min.messages", "10000"},
      {"queued.max.messages.kbytes", "32768"},
  };
}

PartitionList list_of(const std::vector<CommitOf>& commits) {
  PartitionList list(rd_kafka_topic_partition_list_new(static_cast<int>(commits.size())));
  for (const CommitOf& commit : commits) {
    rd_kafka_topic_partition_t* entry =
        rd_kafka_topic_partition_list_add(list.get(), commit.key.first.c_str(), commit.key.second);
    entry->offset = commit.committed.offset;
    entry->metadata = rd_kafka_mem_malloc(nullptr, commit.committed.metadata.size());
    entry->metadata_size = commit.committed.metadata.size();
    std::copy(commit.committed.metadata.begin(), commit.committed.metadata.end(), static_cast<char*>(entry->metadata));
  }
  return list;
}

/// Not rd_kafka_rebalance_protocol(), which may wait for ever while a client leaves its group (librdkafka issue 4041).
bool cooperative() {
  return is_cooperative(rd_kafka_version());
}

void check(rd_kafka_error_t* error, const char* doing) {
  if (error == nullptr) return;
  logger.warn("cannot {}: {}", doing, rd_kafka_error_string(error));
  rd_kafka_error_destroy(error);
}

}  // namespace

ConsumerGroup::ConsumerGroup(const KafkaOptions& options, std::shared_ptr<PartitionReader> reader,
                             std::shared_ptr<GroupMember> member, const config::Clock& clock, ConnectionLog& log,
                             client::WakeEvent& wake)
    : options_(options),
      reader_(std::move(reader)),
      member_(std::move(member)),
      clock_(clock),
      log_(log),
      wake_(wake),
      session_(2 * options.broker.heartbeat),
      renewal_(options, [this] {
        return std::make_shared<KafkaClient>(
            RD_KAFKA_CONSUMER, options_, consumer_settings(member_->name, session_),
            RD_KAFKA_EVENT_REBALANCE | RD_KAFKA_EVENT_OFFSET_COMMIT | RD_KAFKA_EVENT_ERROR);
      }) {}

ConsumerGroup::~ConsumerGroup() {
  end_client();
}

std::chrono::milliseconds ConsumerGroup::serve() {
  if (closing_ && !client_) return std::chrono::milliseconds(1000);
  try {
    if (!client_) start_client();
  } catch (const std::exception& error) {  // ClientError, config::Error: try to make the client later
    log_.failed(error.what());
    start_at_ = clock_.now() + std::chrono::seconds(1);
  }
  if (!client_) return std::chrono::milliseconds(1000);
  // First the events, then the check for servers: otherwise an old event about a failed connection would count as a
  // loss of the new one.
  while (const Event event{rd_kafka_queue_poll(events_.get(), 0)}) on_event(event.get());
  look_for_servers();
  const Instant now = clock_.now();
  if (!ending() && renewal_.ready(now)) renewing_ = true;
  // Without a server there is no group to leave: its server notices by the session's time-out.
  const bool left = rd_kafka_consumer_closed(client_->get()) != 0 || (renewing_ && !connected_);
  if (broken_ || left) {
    end_client();
    return std::chrono::milliseconds(0);
  }
  if (ending()) return serve_closing(now);
  follow_subscriptions(now);
  commit_settled(now);
  return time_to_sleep(now);
}

std::chrono::milliseconds ConsumerGroup::time_to_sleep(Instant now) const {
  if (!connected_ || doubted_at_ != Instant{}) return look_again;
  std::chrono::milliseconds limit{1000};
  const auto until = [&](Instant instant) {
    limit =
        std::clamp(std::chrono::ceil<std::chrono::milliseconds>(instant - now), std::chrono::milliseconds(0), limit);
  };
  if (renewal_.pending()) limit = look_again;
  if (now < ask_topics_at_) until(ask_topics_at_);
  if (!subscription_is_taken_ && !(subscribed_.empty() && forgotten_.empty())) until(now + subscription_pause);
  if (reader_->dirty(*member_)) until(commit_at_);
  return limit;
}

void ConsumerGroup::start_client() {
  if (clock_.now() < start_at_) return;
  client_ = renewal_.client();
  rd_kafka_poll_set_consumer(client_->get());
  events_.reset(rd_kafka_queue_get_consumer(client_->get()));
  watch(events_);
  connected_ = broken_ = false;
  doubted_at_ = {};
}

void ConsumerGroup::end_client() {
  if (!client_) return;
  stop_reading(assigned_);
  assigned_.clear();
  unsaved_.clear();
  reader_->set_connected(*member_, false);
  connected_ = renewing_ = leaving_ = false;
  close_by_ = {};
  subscribed_.clear();
  forgotten_.clear();
  asked_.clear();
  rd_kafka_queue_io_event_enable(events_.get(), -1, nullptr, 0);
  events_.reset();
  client_.reset();
}

void ConsumerGroup::watch(const Queue& queue) const {
  constexpr std::uint64_t one = 1;
  rd_kafka_queue_io_event_enable(queue.get(), wake_.descriptor(), &one, sizeof(one));
}

std::chrono::milliseconds ConsumerGroup::serve_closing(Instant now) {
  if (close_by_ == Instant{}) {
    stop_reading(assigned_);
    close_by_ = now + last_commit_limit;
  }
  if (leaving_) {
    if (now < close_by_) return std::chrono::milliseconds(20);
    logger.warn("group {}: its server does not let this member go; the group waits {} ms for it", member_->name,
                session_.count());
    end_client();
    return std::chrono::milliseconds(0);
  }
  // In a rebalance the group refuses commits; the members that stay take part until it is over.
  const bool may_commit = connected_ && rd_kafka_assignment_lost(client_->get()) == 0;
  const rd_kafka_resp_err_t error = may_commit ? commit_unsaved(assigned_) : RD_KAFKA_RESP_ERR__STATE;
  if (error != RD_KAFKA_RESP_ERR_NO_ERROR && may_commit && now < close_by_) return last_commit_pause;
  warn_of_unsaved(error);
  leave_group();
  close_by_ = now + leave_limit;
  return std::chrono::milliseconds(0);
}

void ConsumerGroup::leave_group() {
  leaving_ = true;
  // In librdkafka 2.0.2, a subscription that waits for the end of a rebalance survives the closing of the consumer,
  // which then fails an assertion or joins the group again for ever. Unsubscribing cancels it.
  rd_kafka_unsubscribe(client_->get());
  // The library delivers its last events through this queue, which must be the application's own.
  Queue last(rd_kafka_queue_new(client_->get()));
  watch(last);
  check(rd_kafka_consumer_close_queue(client_->get(), last.get()), "leave the group");
  events_ = std::move(last);
}

bool ConsumerGroup::closed() const {
  return closing_ && (!client_ || rd_kafka_consumer_closed(client_->get()) != 0);
}

void ConsumerGroup::look_for_servers() {
  if ((connected_ && doubted_at_ == Instant{}) || ending()) return;
  const bool connected = client_->connected();
  if (!connected) client_->refresh_credentials(options_, clock_.now());
  if (!connected && connected_ && clock_.now() - doubted_at_ < longest_doubt) return;
  doubted_at_ = {};
  if (connected == connected_) {
    if (!connected && !last_error_.empty()) log_.failed(last_error_);
    return;
  }
  connected_ = connected;
  if (connected) {
    last_error_.clear();
    log_.connected();
  } else {
    log_.lost(last_error_);
  }
  reader_->set_connected(*member_, connected_);
}

void ConsumerGroup::on_event(rd_kafka_event_t* event) {
  switch (rd_kafka_event_type(event)) {
    case RD_KAFKA_EVENT_REBALANCE: {
      const rd_kafka_topic_partition_list_t* partitions = rd_kafka_event_topic_partition_list(event);
      if (rd_kafka_event_error(event) == RD_KAFKA_RESP_ERR__ASSIGN_PARTITIONS) {
        // In an eager group the library has withdrawn an assignment that came before it was told to leave. It would
        // take the answer for that to the revocation which follows, and end while that is answered: the answer, a
        // request to a thread that has ended, may then wait for ever (librdkafka issues 4041 and 4884).
        if (!leaving_ || cooperative()) on_assign(*partitions);
      } else {
        on_revoke(*partitions);
      }
      return;
    }
    case RD_KAFKA_EVENT_OFFSET_COMMIT:
      if (rd_kafka_event_error(event) == RD_KAFKA_RESP_ERR_NO_ERROR) return;
      for (const auto& entry : entries_of(*rd_kafka_event_topic_partition_list(event))) {
        reader_->commit_failed(*member_, {entry.topic, entry.partition});
      }
      return;
    case RD_KAFKA_EVENT_CREATETOPICS_RESULT:
      on_topics(event);
      return;
    case RD_KAFKA_EVENT_ERROR:
      on_error(event);
      return;
    default:
      return;
  }
}

void ConsumerGroup::on_error(rd_kafka_event_t* event) {
  const rd_kafka_resp_err_t error = rd_kafka_event_error(event);
  const std::string text = rd_kafka_event_error_string(event);
  if (rd_kafka_event_error_is_fatal(event) != 0) {
    logger.error("the reader of group {} cannot go on: {}; starting another", member_->name, text);
    broken_ = true;
  } else if (error == RD_KAFKA_RESP_ERR_INVALID_SESSION_TIMEOUT && session_ < usual_session) {
    logger.warn(
        "the server of group {} does not allow a session time-out of {} ms; taking {} ms. Lower its "
        "group.min.session.timeout.ms, or make the broker's heartbeat longer",
        member_->name, session_.count(), usual_session.count());
    session_ = usual_session;
    broken_ = true;
  } else if (error == RD_KAFKA_RESP_ERR_UNKNOWN_TOPIC_OR_PART || error == RD_KAFKA_RESP_ERR__UNKNOWN_TOPIC) {
    // The topic was just made and is not known on all servers yet, or it was deleted: ask for it again, and subscribe
    // again.
    made_.clear();
    there_.clear();
    subscribed_.clear();
    ask_topics_at_ = clock_.now() + topic_backoff_.next();
  } else if (is_about_connection(error)) {
    if (error != RD_KAFKA_RESP_ERR__ALL_BROKERS_DOWN || last_error_.empty()) last_error_ = lasting_words(event);
    if (doubted_at_ == Instant{}) doubted_at_ = clock_.now();
    if (error == RD_KAFKA_RESP_ERR__ALL_BROKERS_DOWN && std::exchange(connected_, false)) {
      log_.lost(last_error_);
      reader_->set_connected(*member_, false);
    }
  } else if (complaints_.size() < most_complaints && complaints_.insert(text).second) {
    logger.warn("group {}: {}", member_->name, text);
  }
}

/// Those of the partitions that this member reads; it leaves the others of its topics to the groups of their own.
PartitionList ConsumerGroup::wanted(const rd_kafka_topic_partition_list_t& partitions) const {
  PartitionList list(rd_kafka_topic_partition_list_new(partitions.cnt));
  for (const auto& entry : entries_of(partitions)) {
    if (member_->wants(entry.partition)) rd_kafka_topic_partition_list_add(list.get(), entry.topic, entry.partition);
  }
  return list;
}

void ConsumerGroup::on_assign(const rd_kafka_topic_partition_list_t& partitions) {
  const PartitionList list = wanted(partitions);
  const rd_kafka_resp_err_t error =
      rd_kafka_committed(client_->get(), list.get(), static_cast<int>(committed_limit.count()));
  for (rd_kafka_topic_partition_t& entry : std::span(list->elems, static_cast<std::size_t>(list->cnt))) {
    const PartitionKey key(entry.topic, entry.partition);
    Committed committed;
    const rd_kafka_resp_err_t problem = error != RD_KAFKA_RESP_ERR_NO_ERROR ? error : entry.err;
    committed.known = problem == RD_KAFKA_RESP_ERR_NO_ERROR;
    if (committed.known) {
      committed.offset = entry.offset;
      if (entry.metadata != nullptr) {
        committed.metadata.assign(static_cast<const char*>(entry.metadata), entry.metadata_size);
      }
    } else {
      logger.warn(
          "group {}: its server does not say where it is in partition {} of topic {}: {}; the library asks again, and "
          "what comes first may come a second time",
          member_->name, entry.partition, entry.topic, rd_kafka_err2str(problem));
    }
    Progress progress(committed, reader_->handed_on(*member_, key));
    entry.offset = progress.start() >= 0 ? progress.start()
                   : committed.known     ? RD_KAFKA_OFFSET_BEGINNING
                                         : RD_KAFKA_OFFSET_STORED;
    entry.err = RD_KAFKA_RESP_ERR_NO_ERROR;
    assigned_.insert(key);
    if (!ending())
      reader_->assigned(std::make_shared<PartitionFeed>(reader_, member_, client_, key, std::move(progress)));
  }
  const bool all_read = unread().empty();
  join_again_at_ = all_read ? Instant{} : clock_.now() + join_backoff_.next();
  if (all_read && forgotten_.empty()) join_backoff_.reset();
  if (cooperative()) {
    check(rd_kafka_incremental_assign(client_->get(), list.get()), "take partitions");
  } else {
    rd_kafka_assign(client_->get(), list.get());
  }
}

void ConsumerGroup::on_revoke(const rd_kafka_topic_partition_list_t& partitions) {
  const PartitionList list = wanted(partitions);
  std::set<PartitionKey> keys;
  for (const auto& entry : entries_of(*list)) keys.emplace(entry.topic, entry.partition);
  stop_reading(keys);
  if (connected_ && rd_kafka_assignment_lost(client_->get()) == 0) warn_of_unsaved(commit_unsaved(keys));
  for (const PartitionKey& key : keys) {
    assigned_.erase(key);
    unsaved_.erase(key);
  }
  if (cooperative()) {
    check(rd_kafka_incremental_unassign(client_->get(), list.get()), "give partitions back");
  } else {
    rd_kafka_assign(client_->get(), nullptr);
  }
}

void ConsumerGroup::stop_reading(const std::set<PartitionKey>& keys) {
  for (CommitOf& commit : reader_->leave(*member_, keys, handler_limit)) {
    unsaved_[commit.key] = std::move(commit.committed);
  }
}

rd_kafka_resp_err_t ConsumerGroup::commit_unsaved(const std::set<PartitionKey>& keys) {
  std::vector<CommitOf> commits;
  for (const auto& [key, committed] : unsaved_) {
    if (keys.contains(key)) commits.push_back({key, committed});
  }
  if (commits.empty()) return RD_KAFKA_RESP_ERR_NO_ERROR;
  const rd_kafka_resp_err_t error = rd_kafka_commit(client_->get(), list_of(commits).get(), 0);
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) {
    for (const CommitOf& commit : commits) unsaved_.erase(commit.key);
  }
  return error;
}

void ConsumerGroup::warn_of_unsaved(rd_kafka_resp_err_t error) const {
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR || unsaved_.empty()) return;
  logger.warn("group {}: cannot commit what was read: {}; the next reader gets some of it again", member_->name,
              rd_kafka_err2str(error));
}

void ConsumerGroup::commit_settled(Instant now) {
  if (!connected_ || closing_ || now < commit_at_) return;
  const std::vector<CommitOf> commits = reader_->take_commits(*member_);
  if (commits.empty()) return;
  commit_at_ = now + commit_period;
  const rd_kafka_resp_err_t error =
      rd_kafka_commit_queue(client_->get(), list_of(commits).get(), events_.get(), nullptr, nullptr);
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) return;
  for (const CommitOf& commit : commits) reader_->commit_failed(*member_, commit.key);
}

void ConsumerGroup::follow_subscriptions(Instant now) {
  if (!connected_) return;
  const std::set<std::string> wanted = reader_->topics(*member_);
  if (asked_.empty() && ask_topics_at_ <= now) {
    std::set_difference(wanted.begin(), wanted.end(), made_.begin(), made_.end(), std::back_inserter(asked_));
    if (!asked_.empty()) request_topics(*client_, events_.get(), asked_, options_);
    for (const std::string& topic : made_) {
      if (there_.contains(topic)) continue;
      // Subscribe only to topics that the server knows: otherwise the group checks again only after a long time.
      if (client_->partitions(topic, options_.broker.rpc_timeout) == 0) {
        made_ = there_;  // so that the missing topics are asked for again
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
    // librdkafka postpones a subscription during a rebalance and may then forget it, so the request is repeated until
    // it has taken effect.
    if (!subscription_is_taken_) subscription_is_taken_ = subscription() == told;
    if (subscription_is_taken_) {
      if (forgotten_.empty()) return join_for_unread(now);
      forgotten_.clear();  // this member has left the group for these topics; the next request joins again
      told = std::move(topics);
    }
  } else if (forgotten_.empty()) {
    join_backoff_.reset();
  }
  tell_subscription(std::move(told));
}

void ConsumerGroup::tell_subscription(std::set<std::string> topics) {
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

// The group's leader, which assigns the partitions, asks one node for them, and assumes that a topic which this node
// does not know yet has no partitions. librdkafka 2.0.2 learns of them later but does nothing, so the topic would never
// have a reader. So a member without partitions of a topic joins again for it; more and more rarely, because other
// members may have all of them.
void ConsumerGroup::join_for_unread(Instant now) {
  if (join_again_at_ == Instant{} || now < join_again_at_) return;
  forgotten_ = unread();
  logger.debug("group {}: got no partition of {} topics; joining again", member_->name, forgotten_.size());
  std::set<std::string> read;
  std::set_difference(subscribed_.begin(), subscribed_.end(), forgotten_.begin(), forgotten_.end(),
                      std::inserter(read, read.end()));
  tell_subscription(std::move(read));
}

std::set<std::string> ConsumerGroup::unread() const {
  std::set<std::string> topics = subscribed_;
  for (const auto& [topic, partition] : assigned_) topics.erase(topic);
  return topics;
}

void ConsumerGroup::on_topics(rd_kafka_event_t* event) {
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

std::set<std::string> ConsumerGroup::subscription() const {
  rd_kafka_topic_partition_list_t* list = nullptr;
  if (rd_kafka_subscription(client_->get(), &list) != RD_KAFKA_RESP_ERR_NO_ERROR) return {};
  const PartitionList owned(list);
  std::set<std::string> topics;
  for (const auto& entry : entries_of(*list)) topics.insert(entry.topic);
  return topics;
}

}  // namespace iotcloud::brokers::kafka
