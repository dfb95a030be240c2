// Drivers of which only some have a second channel: all that one of them sends is in one worker.
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>

namespace iotcloud::topology {
namespace {

/// Remembers in which worker each driver's messages of each round were.
class WhereBolt final : public BasicBolt {
 public:
  /// By round and driver, with the number of messages.
  using Workers = std::map<std::string, int>;
  explicit WhereBolt(std::string worker) : worker_(std::move(worker)) {}
  static void reset() {
    const std::lock_guard lock(mutex_);
    found_.clear();
  }
  static std::map<std::string, Workers> of_round(int round) {
    const std::lock_guard lock(mutex_);
    return found_[std::to_string(round)];
  }
  void declare_output_fields(OutputFieldsDeclarer&) const override {}
  void execute(const Tuple& tuple, BasicOutputCollector&) override {
    const std::lock_guard lock(mutex_);
    ++found_[tuple.get<std::string>("text")][tuple.get<std::string>("driverID")][worker_];
  }

 private:
  static inline std::mutex mutex_;
  static inline std::map<std::string, std::map<std::string, Workers>> found_;  ///< guarded by mutex_
  const std::string worker_;
};

class DriversWithSeveralChannels : public Endpoints {
 protected:
  static constexpr int all = 40, with_side = 15;

  DriversWithSeveralChannels() {
    WhereBolt::reset();
    for (int i = 0; i < all; ++i) {
      const std::string id = "i" + std::to_string(i);
      devices_.push_back(device(id));
      show_driver(id);
      if (i >= with_side) continue;
      sides_.push_back(broker_->publisher({"", topic(id, "side"), false}, many()));
      show_channel(id, "side", discovery::Direction::out);
    }
  }

  void start(const std::string& name) {
    const std::string spout = "broker: rabbitmq, driver: d, fields: [text, driverID, time], builder: text";
    ComponentRegistry components;
    components.add_bolt("Where", [name] { return make_bolt<WhereBolt>(name); });
    run_yaml("topology.name: t\nspouts:\n  up: {channel: up, parallelism: 2, " + spout + "}\n  side: {channel: side, " +
                 spout + "}\nbolts:\n  where: {class: Where, inputs: [{from: up}, {from: side}]}\n",
             std::move(components));
  }

  /// Sends on each channel until all of one round came, and of each driver to one worker.
  bool until_each_is_in_one_worker() {
    return eventually([&] {
      const int round = ++rounds_;
      for (int i = 0; i < all; ++i) {
        const std::string id = "i" + std::to_string(i), text = std::to_string(round);
        devices_[static_cast<std::size_t>(i)]->publish(message(text, id));
        if (i < with_side) sides_[static_cast<std::size_t>(i)]->publish(message(text, id));
      }
      const bool came = eventually([&] {
        int count = 0;
        for (const auto& [driver, workers] : WhereBolt::of_round(round)) {
          for (const auto& [worker, messages] : workers) count += messages;
        }
        return count >= all + with_side;
      });
      used_.clear();
      bool each_in_one = came;
      for (const auto& [driver, workers] : WhereBolt::of_round(round)) {
        each_in_one = each_in_one && workers.size() == 1;
        for (const auto& [worker, messages] : workers) used_.insert(worker);
      }
      return each_in_one;
    });
  }

  std::vector<std::unique_ptr<brokers::Publisher>> devices_, sides_;
  std::set<std::string> used_;  ///< the workers of the last round
  int rounds_ = 0;
};

TEST_F(DriversWithSeveralChannels, AreEachInOneWorkerAlsoWhereSomeLackAChannel) {
  start("one");
  ASSERT_TRUE(until_each_is_in_one_worker());
  start("two");
  ASSERT_TRUE(eventually([&] { return until_each_is_in_one_worker() && used_.size() == 2; }));
  start("three");
  ASSERT_TRUE(eventually([&] { return until_each_is_in_one_worker() && used_.size() == 3; }));
  workers_.erase(workers_.begin());
  EXPECT_TRUE(eventually([&] { return until_each_is_in_one_worker() && !used_.contains("one"); }));
}

/// Drivers with an exclusive channel `up` and a channel `side` that they share.
class DriversWithChannelsOfBothKinds : public Endpoints {
 protected:
  static constexpr int all = 5;

  DriversWithChannelsOfBothKinds() {
    for (int i = 0; i < all; ++i) {
      const std::string id = "i" + std::to_string(i);
      show_driver(id);
      show_side(id, true);
    }
  }
  void show_side(const std::string& id, bool shared) {
    auto side = channel_record(id, "side", discovery::Direction::out);
    side.properties = {{"routingKey", "side"}};
    side.shared = shared;
    put_channel(side);
  }
  /// \param side_group of the spout that reads `side`; empty: as that of the other
  void start(const std::string& bolts, const std::string& side_group = {}) {
    const std::string spout = "broker: rabbitmq, driver: d, fields: [text, driverID, time], builder: text";
    ComponentRegistry components;
    components.add_bolt("Where", [] { return make_bolt<WhereBolt>("one"); });
    run_yaml("topology.name: t\nspouts:\n  up: {channel: up, " + spout + "}\n  side: {channel: side, " + spout +
                 (side_group.empty() ? "" : ", group: " + side_group) + "}\nbolts:\n" + bolts,
             std::move(components));
  }
  std::string trouble() const { return workers_.back()->trouble(); }
};

TEST_F(DriversWithChannelsOfBothKinds, AreNotReadWhereTheirMessagesWouldHaveToMeet) {
  start("  where: {class: Where, inputs: [{from: up}, {from: side}]}\n");
  EXPECT_TRUE(eventually([&] {
    return trouble().find(
               "up: channel up of driver d on gateway g is not read: instance i0 and 4 others: its channels "
               "\"side\" and \"up\"") != std::string::npos &&
           trouble().find("(side: shared and not split; up: exclusive)") != std::string::npos;
  })) << trouble();
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 0; }));
  for (int i = 0; i < all; ++i) show_side("i" + std::to_string(i), false);
  EXPECT_TRUE(eventually([&] { return trouble().empty(); })) << trouble();
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == 2 * all; }));
}

TEST_F(DriversWithChannelsOfBothKinds, AreReadWhereNoBoltGetsBoth) {
  start(
      "  where: {class: Where, inputs: {from: up}}\n  too: {class: Where, inputs: {from: side}}\n"
      "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], builder: text, "
      "inputs: [{from: up}, {from: side}]}\n");
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == all + 1; }));
  EXPECT_THAT(trouble(), testing::IsEmpty());
}

TEST_F(DriversWithChannelsOfBothKinds, AreReadWhereAGroupOfItsOwnSaysThatOneOfThemNeedNotMeetTheOther) {
  start("  where: {class: Where, inputs: [{from: up}, {from: side}]}\n", "apart");
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_channels") == all + 1; }));
  EXPECT_THAT(trouble(), testing::IsEmpty());
}

}  // namespace
}  // namespace iotcloud::topology
