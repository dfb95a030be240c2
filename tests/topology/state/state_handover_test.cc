// A driver moves to another worker: what becomes of what stateful bolts know about it.
#include <map>

#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology {
namespace {

/// Counts the messages of each driver and passes them on.
class CountBolt final : public StatefulBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& driver = tuple.get<std::string>("driverID");
    state_->put_int(driver, state_->get_int(driver) + 1);
    collector_->emit(tuple, Values(tuple.at("text"), tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

 private:
  OutputCollector* collector_ = nullptr;
  KeyValueState* state_ = nullptr;
};

class StateHandover : public Endpoints {
 protected:
  static constexpr int drivers = 6;
  static constexpr int messages = 50;

  void start_worker(const std::string& store) {
    ComponentRegistry components;
    components.add_bolt("Count", make_stateful_bolt<CountBolt>({.store = store, .checkpoint = milliseconds(20)}));
    run_yaml(
        "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, fields: [text, driverID, time],"
        " builder: text}\nbolts:\n"
        "  count: {class: Count, inputs: {from: in, grouping: fields, fields: [driverID]}}\n"
        "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: count}}\n",
        std::move(components));
  }
  void send_all() {
    for (int i = 0; i < drivers; ++i) {
      for (int n = 0; n < messages; ++n) devices_[id(i)]->publish(message(std::to_string(n), id(i)));
    }
  }
  bool all_back(std::size_t times) {
    for (int i = 0; i < drivers; ++i) {
      if (!mailboxes_[id(i)]->wait_for(times * messages)) return false;
    }
    return true;
  }
  static std::string id(int i) { return "i" + std::to_string(i); }
  static std::map<std::string, std::int64_t> counts(const std::string& store) {
    std::map<std::string, std::int64_t> all;
    const auto stored = make_state_store(store)->load({"t", "count", 0, 1});
    for (const auto& [driver, count] : stored.entries) all[driver] = std::stoll(count);
    return all;
  }

  /// Whether each driver has as many in two stores together: copies may have come back before all was written.
  static bool are_counted(std::int64_t each, std::map<std::string, std::int64_t> one,
                          std::map<std::string, std::int64_t> other) {
    for (int i = 0; i < drivers; ++i) {
      if (one[id(i)] + other[id(i)] < each) return false;
    }
    return true;
  }

  using milliseconds = std::chrono::milliseconds;
  std::map<std::string, std::unique_ptr<brokers::Publisher>> devices_;
  std::map<std::string, std::unique_ptr<Mailbox>> mailboxes_;
};

TEST_F(StateHandover, WhatAWorkerKnewOfADriverStaysInItsStoreAndTheNextWorkerBeginsAnew) {
  const std::string first = "memory://handover-first", second = "memory://handover-second";
  for (int i = 0; i < drivers; ++i) {
    mailboxes_[id(i)] = std::make_unique<Mailbox>(*broker_, topic(id(i), "down"));
    devices_[id(i)] = device(id(i));
    show_driver(id(i));
  }
  start_worker(first);
  send_all();
  ASSERT_TRUE(all_back(1));
  start_worker(second);
  // While the drivers move, and until some of them are counted by the second worker.
  int rounds = 1;
  ASSERT_TRUE(eventually([&] {
    send_all();
    ++rounds;
    return counts(second).size() >= drivers / 2;
  }));
  ASSERT_TRUE(all_back(static_cast<std::size_t>(rounds)));
  ASSERT_TRUE(eventually([&] { return are_counted(std::int64_t{rounds} * messages, counts(first), counts(second)); }));
  workers_.clear();  // with the last checkpoints

  const auto then = counts(first);
  const auto now = counts(second);
  int moved = 0;
  std::int64_t both = 0;
  for (int i = 0; i < drivers; ++i) {
    const std::int64_t here = now.contains(id(i)) ? now.at(id(i)) : 0;
    ASSERT_TRUE(then.contains(id(i))) << "the first worker forgot " << id(i);
    EXPECT_GE(then.at(id(i)) + here, rounds * messages) << id(i) << ": messages in neither store";
    moved += here > 0 ? 1 : 0;
    both += then.at(id(i)) + here;
  }
  EXPECT_GE(moved, drivers / 2);
  std::cout << moved << " of " << drivers << " drivers moved; " << drivers * rounds * messages << " messages, " << both
            << " counted in the two stores together\n";
}

}  // namespace
}  // namespace iotcloud::topology
