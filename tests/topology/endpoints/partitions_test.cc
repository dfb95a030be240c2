// Shared channels whose topics a real Kafka splits: which task of which worker reads which driver, and in what order.
#include <algorithm>
#include <array>
#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>

#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/placement/partition_agreement.h>

namespace iotcloud::topology {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int partitions = 4;

/// Remembers which task of which worker's spout brought which message, and to which task of the bolt.
class WhoReadsBolt final : public BasicBolt {
 public:
  struct Read {
    std::string worker;
    int task = 0;   ///< of the spout
    int taker = 0;  ///< task of the bolt
    std::string channel, driver;
    int number = 0;
  };
  explicit WhoReadsBolt(std::string worker) : worker_(std::move(worker)) {}
  static void reset() {
    const std::lock_guard lock(mutex_);
    reads_.clear();
  }
  static std::vector<Read> reads() {
    const std::lock_guard lock(mutex_);
    return reads_;
  }
  void declare_output_fields(OutputFieldsDeclarer&) const override {}
  void prepare(const Config&, const TopologyContext& context) override { task_ = context.task; }
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    const std::lock_guard lock(mutex_);
    reads_.push_back({worker_, tuple.source_task(), task_, tuple.source_component(), tuple.get<std::string>("driverID"),
                      std::stoi(tuple.get<std::string>("text"))});
  }

 private:
  static inline std::mutex mutex_;
  static inline std::vector<Read> reads_;  ///< guarded by mutex_
  const std::string worker_;
  int task_ = 0;
};

tests::PrivateServer& kafka() {
  static tests::PrivateServer server("kafka.py", {"--partitions", std::to_string(partitions)});
  return server;
}

/// A driver on one gateway, with many instances that share the channels `up` and `side`.
class KafkaPartitions : public Endpoints {
 protected:
  static constexpr int instances = 48;

  KafkaPartitions() : Endpoints(kafka().url()) { WhoReadsBolt::reset(); }

  /// A client that makes topics with this many partitions.
  brokers::Broker& broker_with(int number) {
    brokers::BrokerOptions options;
    options.urls = {broker_url_};
    options.properties["partitions"] = std::to_string(number);
    return *brokers_.emplace_back(brokers::make_broker(options));
  }
  /// Starts a worker with this many tasks of each spout. \param brokers of the channels that are not on Kafka
  void start(const std::string& name, int tasks, const std::vector<std::string>& channels = {"up"},
             const std::map<std::string, std::string>& brokers = {}) {
    std::string yaml = "topology.name: t\nbrokers:\n  kafka: {heartbeat: 1s, properties: {partitions: \"" +
                       std::to_string(partitions) + "\"}}\nspouts:\n";
    std::string inputs;
    for (const auto& channel : channels) {
      const auto other = brokers.find(channel);
      yaml += "  " + channel + ": {broker: " + (other == brokers.end() ? "kafka" : other->second) +
              ", driver: d, channel: " + channel +
              ", fields: [text, driverID, time], builder: text, parallelism: " + std::to_string(tasks) + "}\n";
      inputs += (inputs.empty() ? "{from: " : ", {from: ") + channel + ", grouping: fields, fields: [driverID]}";
    }
    yaml += "bolts:\n  who: {class: Who, tasks: 4, inputs: [" + inputs + "]}\n";
    ComponentRegistry components;
    components.add_bolt("Who", [name] { return make_bolt<WhoReadsBolt>(name); });
    names_.push_back(name);
    run_yaml(yaml, std::move(components));
  }
  void stop(const std::string& name) {
    const auto place = std::find(names_.begin(), names_.end(), name) - names_.begin();
    workers_.erase(workers_.begin() + place);
    names_.erase(names_.begin() + place);
  }
  /// The topic's name in the channel's record.
  std::string raw(const std::string& channel) const { return channel + url_.substr(url_.rfind('-')); }
  std::string topic_of(const std::string& channel) const { return "g.d." + raw(channel); }
  void show(const std::vector<std::string>& channels = {"up"}, const std::string& transport = "kafka",
            discovery::Direction direction = discovery::Direction::out) {
    std::map<std::string, std::string> topics;
    for (const auto& name : channels) topics[name] = raw(name);
    for (int i = 0; i < instances; ++i) show_instance(i, topics, transport, direction);
  }
  /// \param topics by channel, as in the channel's record
  void show_instance(int i, const std::map<std::string, std::string>& topics, const std::string& transport = "kafka",
                     discovery::Direction direction = discovery::Direction::out) {
    for (const auto& [name, topic] : topics) {
      discovery::ChannelRecord channel = channel_record(id(i), name, direction, transport);
      channel.properties = {{"topic", topic}};
      channel.shared = true;
      put_channel(channel);
    }
    put_driver(driver_record(id(i)));
  }
  static std::string id(int i) { return "i" + std::to_string(i); }
  /// One more message of each instance on each channel.
  void send_round() {
    for (const auto& [channel, publisher] : publishers_) {
      for (int i = 0; i < instances; ++i) publisher->publish(message(std::to_string(sent_), id(i)));
    }
    ++sent_;
  }
  void publish_on(const std::string& channel, brokers::Broker& broker) {
    publishers_[channel] = broker.publisher({"", topic_of(channel), false}, many());
  }
  /// Makes the topics with the publishers' numbers of partitions, before a worker makes them with its own: a topic that
  /// is confirmed is there.
  void make_topics() {
    send_round();
    for (const auto& [channel, publisher] : publishers_)
      ASSERT_TRUE(publisher->drain(std::chrono::seconds(60))) << channel;
  }
  /// Sends rounds until this many tasks have read something of the last one, and everything of it was read.
  bool until_tasks_read(std::size_t tasks) {
    return eventually([&] {
      const int round = sent_;
      send_round();
      const bool all = eventually([&] { return count_of(round) == static_cast<std::size_t>(instances); });
      return all && readers_of(round).size() == tasks;
    });
  }
  static std::size_t count_of(int number) {
    std::set<std::string> drivers;
    for (const auto& read : WhoReadsBolt::reads()) {
      if (read.number == number) drivers.insert(read.driver);
    }
    return drivers.size();
  }
  /// The drivers that each task read of the messages with this number.
  static std::map<std::pair<std::string, int>, std::set<std::string>> readers_of(int number) {
    std::map<std::pair<std::string, int>, std::set<std::string>> readers;
    for (const auto& read : WhoReadsBolt::reads()) {
      if (read.number == number) readers[{read.worker, read.task}].insert(read.driver);
    }
    return readers;
  }
  /// Whether each driver's message of each round came, or comes soon.
  bool all_came() const {
    return eventually([&] {
      std::set<std::pair<std::string, int>> seen;
      for (const auto& read : WhoReadsBolt::reads()) seen.emplace(read.driver, read.number);
      return seen.size() == static_cast<std::size_t>(instances) * static_cast<std::size_t>(sent_);
    });
  }
  /// Whether all messages of each driver came, and their first copies in order.
  void expect_all_in_order() const {
    std::map<std::string, std::vector<int>> firsts;
    std::map<std::string, std::set<int>> seen;
    for (const auto& read : WhoReadsBolt::reads()) {
      if (seen[read.driver].insert(read.number).second) firsts[read.driver].push_back(read.number);
    }
    ASSERT_EQ(firsts.size(), static_cast<std::size_t>(instances));
    for (const auto& [driver, numbers] : firsts) {
      EXPECT_TRUE(std::is_sorted(numbers.begin(), numbers.end())) << driver;
      EXPECT_EQ(numbers.size(), static_cast<std::size_t>(sent_)) << driver;
    }
  }
  /// Gives a topic more partitions, as kafka-topics.sh does.
  void add_partitions(const std::string& topic, int number) const {
    const std::unique_ptr<rd_kafka_conf_t, decltype(&rd_kafka_conf_destroy)> conf(rd_kafka_conf_new(),
                                                                                  &rd_kafka_conf_destroy);
    std::array<char, 256> problem{};
    rd_kafka_conf_set(conf.get(), "bootstrap.servers", broker_url_.substr(8).c_str(), problem.data(), problem.size());
    const std::unique_ptr<rd_kafka_t, decltype(&rd_kafka_destroy)> client(
        rd_kafka_new(RD_KAFKA_PRODUCER, rd_kafka_conf_dup(conf.get()), problem.data(), problem.size()),
        &rd_kafka_destroy);
    rd_kafka_NewPartitions_t* wanted =
        rd_kafka_NewPartitions_new(topic.c_str(), static_cast<std::size_t>(number), problem.data(), problem.size());
    const std::unique_ptr<rd_kafka_queue_t, decltype(&rd_kafka_queue_destroy)> queue(rd_kafka_queue_new(client.get()),
                                                                                     &rd_kafka_queue_destroy);
    rd_kafka_CreatePartitions(client.get(), &wanted, 1, nullptr, queue.get());
    rd_kafka_NewPartitions_destroy(wanted);
    rd_kafka_event_t* const event = rd_kafka_queue_poll(queue.get(), 20'000);
    ASSERT_NE(event, nullptr);
    std::size_t count = 0;
    const auto* const topics =
        rd_kafka_CreatePartitions_result_topics(rd_kafka_event_CreatePartitions_result(event), &count);
    ASSERT_EQ(count, 1U);
    EXPECT_EQ(rd_kafka_topic_result_error(topics[0]), RD_KAFKA_RESP_ERR_NO_ERROR);
    rd_kafka_event_destroy(event);
  }

  std::vector<std::unique_ptr<brokers::Broker>> brokers_;
  std::map<std::string, std::unique_ptr<brokers::Publisher>> publishers_;  ///< by channel
  std::vector<std::string> names_;                                         ///< of workers_
  int sent_ = 0;
};

TEST_F(KafkaPartitions, OfOneTopicAreReadByAsManyTasksOfOneWorkerAsThereAreAndTheOthersStandBy) {
  publish_on("up", broker_with(partitions));
  show();
  start("one", partitions + 2);
  ASSERT_TRUE(until_tasks_read(partitions));
  std::size_t drivers = 0;
  for (const auto& [task, read] : readers_of(sent_ - 1)) {
    std::cout << "task " << task.second << " read " << read.size() << " drivers\n";
    drivers += read.size();
  }
  EXPECT_EQ(drivers, static_cast<std::size_t>(instances)) << "each driver was read by one task";
  EXPECT_EQ(metric("iotcloud_spout_channels"), partitions);
  expect_all_in_order();
}

TEST_F(KafkaPartitions, SpreadOverWorkersThatComeAndGoWithEachDriversMessagesInOrder) {
  publish_on("up", broker_with(partitions));
  show();
  start("one", 1);
  ASSERT_TRUE(until_tasks_read(1));
  for (const char* name : {"two", "three", "four"}) start(name, 1);
  ASSERT_TRUE(until_tasks_read(partitions));
  std::map<std::string, std::size_t> drivers;
  for (const auto& [task, read] : readers_of(sent_ - 1)) drivers[task.first] += read.size();
  EXPECT_THAT(drivers, SizeIs(partitions)) << "each worker reads one partition";
  stop("two");
  stop("four");
  ASSERT_TRUE(until_tasks_read(2));
  expect_all_in_order();
}

TEST_F(KafkaPartitions, WithOneNumberOfAllChannelsOfADriverAreReadInOneWorkerAndMeetInOneTask) {
  publish_on("up", broker_with(partitions));
  publish_on("side", broker_with(partitions));
  show({"up", "side"});
  start("one", 2, {"up", "side"});
  start("two", 2, {"up", "side"});
  ASSERT_TRUE(until_tasks_read(std::size_t{2} * partitions));
  send_round();  // the one before may have come while a partition moved from one worker to the other
  ASSERT_TRUE(eventually([&] {
    std::set<std::pair<std::string, std::string>> read;
    for (const auto& each : WhoReadsBolt::reads()) {
      if (each.number == sent_ - 1) read.emplace(each.channel, each.driver);
    }
    return read.size() == std::size_t{2} * instances;
  }));
  using Taker = std::pair<std::string, int>;  // a worker, and a task of the bolt
  std::map<std::string, std::set<Taker>> takers;
  std::set<Taker> all;
  for (const auto& read : WhoReadsBolt::reads()) {
    if (read.number != sent_ - 1) continue;
    takers[read.driver].emplace(read.worker, read.taker);
    all.emplace(read.worker, read.taker);
  }
  for (const auto& [driver, of_driver] : takers) EXPECT_THAT(of_driver, SizeIs(1)) << driver;
  EXPECT_GT(all.size(), 2U) << "and both workers' bolts have several tasks that take";
}

TEST_F(KafkaPartitions, ThatAreAddedAreReadAndTheOthersAreReadOnFromWhereTheyWere) {
  publish_on("up", broker_with(1));
  make_topics();
  show();
  start("one", partitions);
  ASSERT_TRUE(until_tasks_read(1));
  for (int round = 0; round < 20; ++round) send_round();
  ASSERT_TRUE(eventually([&] { return count_of(sent_ - 1) == static_cast<std::size_t>(instances); }));
  const std::size_t before = WhoReadsBolt::reads().size();
  add_partitions(topic_of("up"), partitions);
  publishers_.clear();
  publish_on("up", broker_with(partitions));  // a client learns of new partitions after seconds, a new one at once
  ASSERT_TRUE(until_tasks_read(partitions));
  EXPECT_TRUE(all_came()) << "also of the rounds that until_tasks_read() did not wait for";
  // At least once: what was not committed when the group settled anew comes again, but not all from the beginning.
  EXPECT_LT(WhoReadsBolt::reads().size(), static_cast<std::size_t>(sent_ * instances) + before / 2);
}

TEST_F(KafkaPartitions, OfDifferentNumbersOfADriversChannelsAreRefusedUntilTheyAreTheSame) {
  publish_on("up", broker_with(partitions));
  publish_on("side", broker_with(2));
  make_topics();
  const tests::CapturedLog log;
  show({"up", "side"});
  start("one", 1, {"up", "side"});
  // Until the numbers are known, partition 0 of both may be read.
  ASSERT_TRUE(eventually([&] { return log.contains("have 2 and 4 partitions"); }));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
  const Worker& worker = *workers_.back();
  const auto trouble = [&](const std::string& text) { return worker.trouble().find(text) != std::string::npos; };
  EXPECT_TRUE(eventually([&] {
    return trouble("up: channel up of driver d on gateway g is not read: ") &&
           trouble("side: channel side of driver d") && trouble("have 2 and 4 partitions");
  })) << "/healthz and iotcloud status say: "
      << worker.trouble();
  EXPECT_THAT(worker.describe(), HasSubstr(R"("troubles":[{"component":"side","text":"channel side of driver d)"))
      << "for iotcloud topology show";
  add_partitions(topic_of("side"), partitions);
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2 * partitions; }));
  EXPECT_TRUE(eventually([&] { return worker.trouble().empty(); })) << worker.trouble();
  EXPECT_THAT(worker.describe(), HasSubstr(R"("troubles":[])"));
}

TEST_F(KafkaPartitions, AreRefusedBesideAChannelOfTheDriverThatAnotherBrokerDoesNotSplit) {
  publish_on("up", broker_with(partitions));
  make_topics();
  show();
  for (int i = 0; i < instances; ++i) {
    auto side = channel_record(id(i), "side", discovery::Direction::out, "rabbitmq");
    side.broker_url = url_;
    side.properties = {{"routingKey", "side"}};
    side.shared = true;
    put_channel(side);
  }
  start("one", 1, {"up", "side"}, {{"side", "rabbitmq"}});
  const Worker& worker = *workers_.back();
  EXPECT_TRUE(eventually([&] {
    const std::string trouble = worker.trouble();
    return trouble.find("up: channel up of driver d on gateway g is not read: instance i0 and 47 others") !=
               std::string::npos &&
           trouble.find("side: channel side of driver d") != std::string::npos &&
           trouble.find("(side: shared and not split; up: shared and split into 4 partitions)") != std::string::npos;
  })) << worker.trouble();
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
}

TEST_F(KafkaPartitions, OfDifferentNumbersAreToldOfEachInstanceThatHasOthers) {
  publish_on("up", broker_with(partitions));
  publish_on("side", broker_with(2));
  publish_on("aside", broker_with(3));
  make_topics();
  show_instance(0, {{"up", raw("up")}, {"side", raw("side")}});
  show_instance(1, {{"up", raw("up")}, {"side", raw("aside")}});
  show_instance(2, {{"up", raw("up")}, {"side", raw("aside")}});
  start("one", 1, {"up", "side"});
  const Worker& worker = *workers_.back();
  const auto says = [&](const std::string& who, const std::string& numbers) {
    const auto text = worker.trouble();
    const auto told = [&](const std::string& channel) {
      return text.find("channel " + channel + " of driver d on gateway g is not read: instance " + who +
                       ": its topics of the channels \"side\" and \"up\" have " + numbers + " partitions") !=
             std::string::npos;
    };
    return told("up") && told("side");
  };
  EXPECT_TRUE(eventually([&] { return says("i0", "2 and 4") && says("i1 and 1 other", "3 and 4"); }))
      << worker.trouble();
  show_instance(1, {{"up", raw("up")}, {"side", raw("side")}});
  EXPECT_TRUE(eventually([&] { return says("i0 and 1 other", "2 and 4") && says("i2", "3 and 4"); }))
      << worker.trouble();
  add_partitions(topic_of("side"), partitions);
  EXPECT_TRUE(eventually([&] { return worker.trouble().find("2 and 4") == std::string::npos; })) << worker.trouble();
  EXPECT_TRUE(says("i2", "3 and 4")) << worker.trouble();
  add_partitions(topic_of("aside"), partitions);
  EXPECT_TRUE(eventually([&] { return worker.trouble().empty(); })) << worker.trouble();
}

TEST_F(KafkaPartitions, OfDifferentNumbersAreNoTroubleOfAChannelThatIsNotReadForAnotherReason) {
  publish_on("up", broker_with(partitions));
  publish_on("side", broker_with(2));
  make_topics();
  show({"up", "side"});
  start("one", 1, {"up", "side"});
  const Worker& worker = *workers_.back();
  const auto in_trouble = [&] { return worker.trouble().find("up: channel up of driver d") != std::string::npos; };
  ASSERT_TRUE(eventually(in_trouble));
  show({"up"}, "kafka", discovery::Direction::in);
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; })) << "the other channel is read";
  EXPECT_TRUE(eventually([&] { return worker.trouble().empty(); })) << worker.trouble();
  show({"up"});
  ASSERT_TRUE(eventually(in_trouble));
  show({"up"}, "rabbitmq");
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2; })) << "the other channel is read";
  EXPECT_TRUE(eventually([&] { return worker.trouble().empty(); })) << worker.trouble();
}

PartitionAgreement::Layout split(int partitions_of_topic) {
  return {.exclusive = false, .partitions = partitions_of_topic};
}

TEST(PartitionAgreementTest, NamesTheChannelsThatDifferAndTellsOfEachChange) {
  PartitionAgreement agreement;
  const PartitionAgreement::Source source{"t", "d"_driver, "g"_gateway, "i"_instance};
  int changes = 0;
  const int listener = agreement.listen([&] { ++changes; });
  agreement.set(source, "up", split(4));
  agreement.set(source, "side", split(4));
  agreement.set({"t", "d"_driver, "g"_gateway, "other"_instance}, "side", split(2));
  EXPECT_THAT(agreement.difference(source), IsEmpty());
  EXPECT_EQ(changes, 0);
  agreement.set(source, "side", split(2));
  EXPECT_THAT(agreement.difference(source), HasSubstr("\"side\" and \"up\" have 2 and 4 partitions"));
  EXPECT_THAT(agreement.difference(source),
              HasSubstr("(kafka-topics.sh --alter --partitions); or, if they need not meet, "
                        "give one of the spouts a \"group\" of its own"));
  EXPECT_EQ(changes, 1);
  agreement.forget(source, "side");
  EXPECT_THAT(agreement.difference(source), IsEmpty());
  EXPECT_EQ(changes, 2);
  agreement.ignore(listener);
  agreement.set(source, "side", split(1));
  EXPECT_EQ(changes, 2);
}

}  // namespace
}  // namespace iotcloud::topology
