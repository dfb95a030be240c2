// Drivers move between workers at random, and their state in Redis goes with them: every count is exact.
#include <chrono>
#include <cstdlib>
#include <map>
#include <random>

#include <hiredis/hiredis.h>

#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/tests/topology/state/positions.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology {
namespace {

/// Counts the messages of each driver, each position once, and passes their text on.
class PositionBolt final : public StatefulBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& driver = tuple.get<std::string>("driverID");
    auto positions = workshop::Positions::of(state_->get("positions of " + driver));
    if (positions.count(std::stoll(tuple.get<std::string>("text")))) {
      state_->put("positions of " + driver, positions.text());
      state_->put_int(driver, state_->get_int(driver) + 1);
    }
    collector_->emit(tuple, Values(tuple.at("text"), tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

 private:
  OutputCollector* collector_ = nullptr;
  KeyValueState* state_ = nullptr;
};

class TravellingState : public Endpoints {
 protected:
  static constexpr int drivers = 6;
  static constexpr int most_workers = 3;

  void start_worker() {
    ComponentRegistry components;
    components.add_bolt("Count", make_stateful_bolt<PositionBolt>(
                                     {.store = server_.url(), .checkpoint = std::chrono::milliseconds(20)}));
    run_yaml(
        "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time],"
        " builder: text}\nbolts:\n"
        "  count: {class: Count, tasks: " +
            std::to_string(1 + workers_started_++ % 3) +
            ", inputs: {from: in, grouping: fields, fields: [driverID]}}\n"
            "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: "
            "count}}\n",
        std::move(components));
  }
  static std::string id(int i) { return "i" + std::to_string(i); }
  void send_round() {
    for (int i = 0; i < drivers; ++i) devices_[id(i)]->publish(message(std::to_string(sent_), id(i)));
    ++sent_;
  }
  /// As Redis has it: a KeyValueState would claim the key, and so take it from the worker.
  std::int64_t count_of(const std::string& driver) const {
    const std::string port = server_.url().substr(server_.url().rfind(':') + 1);
    const std::unique_ptr<redisContext, decltype(&redisFree)> redis(redisConnect("127.0.0.1", std::stoi(port)),
                                                                    &redisFree);
    const std::unique_ptr<void, decltype(&freeReplyObject)> reply(
        redisCommand(redis.get(), "HGET iotcloud:state:1:t:count:%s v", driver.c_str()), &freeReplyObject);
    const auto* const answer = static_cast<const redisReply*>(reply.get());
    return answer != nullptr && answer->type == REDIS_REPLY_STRING ? std::stoll(answer->str) : 0;
  }

  tests::PrivateServer server_{"redis.py"};
  std::map<std::string, std::unique_ptr<brokers::Publisher>> devices_;
  std::map<std::string, std::unique_ptr<Mailbox>> mailboxes_;
  int workers_started_ = 0;
  std::int64_t sent_ = 0;
};

TEST_F(TravellingState, IsExactWhileWorkersWithOtherNumbersOfTasksComeAndGoAtRandomAndRedisIsKilled) {
  const unsigned seed = std::random_device{}();
  std::cout << "seed " << seed << "\n";
  std::mt19937 choose(seed);
  for (int i = 0; i < drivers; ++i) {
    mailboxes_[id(i)] = std::make_unique<Mailbox>(*broker_, topic(id(i), "down"));
    devices_[id(i)] = device(id(i));
    show_driver(id(i));
  }
  start_worker();
  int began = 0, ended = 0;
  for (int change = 0; change < 12; ++change) {
    // What moves, moves while messages come: until each driver had some since the change before.
    std::map<std::string, std::size_t> before;
    for (int i = 0; i < drivers; ++i) before[id(i)] = mailboxes_[id(i)]->texts().size();
    ASSERT_TRUE(eventually([&] {
      send_round();
      for (int i = 0; i < drivers; ++i) {
        if (mailboxes_[id(i)]->texts().size() < before[id(i)] + 10) return false;
      }
      return true;
    })) << "change "
        << change;
    if (change == 6) {
      server_.kill();
      for (int n = 0; n < 20; ++n) send_round();
      server_.start();
    } else if (workers_.size() == 1 || (workers_.size() < most_workers && choose() % 2 == 0)) {
      start_worker();
      ++began;
    } else {
      workers_.erase(workers_.begin() + static_cast<std::ptrdiff_t>(choose() % workers_.size()));
      ++ended;
    }
  }
  for (int i = 0; i < drivers; ++i) {
    EXPECT_TRUE(eventually([&] { return count_of(id(i)) >= sent_; })) << id(i) << " has " << count_of(id(i));
  }
  workers_.clear();  // nothing counts any more
  for (int i = 0; i < drivers; ++i) EXPECT_EQ(count_of(id(i)), sent_) << id(i);
  std::cout << drivers * sent_ << " messages of " << drivers << " drivers, each counted once; " << began
            << " workers began and " << ended << " ended meanwhile\n";
}

/// A driver's messages are in two places, as after partitions were added until the old one is read, and two workers
/// each read one of them.
TEST_F(TravellingState, OfDriversThatTwoWorkersReadGoesOnAndIsExact) {
  for (int i = 0; i < drivers; ++i) {
    auto old = channel_record(id(i), "old", discovery::Direction::out);
    old.properties = {{"routingKey", "old"}};
    old.shared = true;
    put_channel(old);
    devices_[id(i)] = device(id(i));
    show_driver(id(i));
  }
  const auto all_old = broker_->publisher({"", "g.d.old", false}, many());
  const std::string of_driver = "fields: [text, driverID, time], builder: text";
  for (int worker = 0; worker < 2; ++worker) {
    ComponentRegistry components;
    components.add_bolt("Count", make_stateful_bolt<PositionBolt>(
                                     {.store = server_.url(), .checkpoint = std::chrono::milliseconds(20)}));
    run_yaml("topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, " + of_driver +
                 "}\n  old: {broker: rabbitmq, driver: d, channel: old, group: apart, " + of_driver +
                 "}\nbolts:\n  count: {class: Count, inputs: [{from: in, grouping: fields, fields: [driverID]}, "
                 "{from: old, grouping: fields, fields: [driverID]}]}\n",
             std::move(components));
  }
  const auto failures = [&] { return metric("iotcloud_task_checkpoint_failures_total"); };
  for (int burst = 0; burst < 100 && failures() == 0; ++burst) {
    for (int n = 0; n < 5; ++n, sent_ += 2) {
      for (int i = 0; i < drivers; ++i) {
        all_old->publish(message(std::to_string(sent_), id(i)));
        devices_[id(i)]->publish(message(std::to_string(sent_ + 1), id(i)));
      }
    }
    for (int i = 0; i < drivers; ++i)
      ASSERT_TRUE(eventually([&] { return count_of(id(i)) >= sent_; })) << id(i) << " has " << count_of(id(i));
  }
  EXPECT_GT(failures(), 0) << "one worker took the other's claim";
  workers_.clear();  // nothing counts any more
  for (int i = 0; i < drivers; ++i) EXPECT_EQ(count_of(id(i)), sent_) << id(i);
}

}  // namespace
}  // namespace iotcloud::topology
