#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>
#include <optional>
#include <random>
#include <set>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>

namespace iotcloud::topology {
namespace {

/// Keeps what it gets, unanswered, until it is to let go; then it passes that on, and what comes later at once.
class KeepingBolt final : public Bolt {
 public:
  static inline std::atomic<bool> keeps{false};
  /// How many it got, by driver.
  static std::map<std::string, int> got() {
    const std::lock_guard lock(mutex_);
    return got_;
  }
  static int total() {
    int sum = 0;
    for (const auto& [driver, count] : got()) sum += count;
    return sum;
  }
  static void reset() {
    keeps = false;
    const std::lock_guard lock(mutex_);
    got_.clear();
  }

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  std::chrono::microseconds tick_period(const Config&) const override { return std::chrono::milliseconds(5); }
  void execute(const Tuple& tuple) override {
    if (!tuple.is_tick()) {
      tuples_.push_back(tuple);
      const std::lock_guard lock(mutex_);
      ++got_[tuple.get<std::string>("driverID")];
    }
    if (keeps) return;
    for (const Tuple& each : tuples_) {
      collector_->emit(each, Values(each.at("text"), each.at("driverID"), each.at("time")));
      collector_->ack(each);
    }
    tuples_.clear();
  }
  void cleanup() override { tuples_.clear(); }

 private:
  static inline std::mutex mutex_;
  static inline std::map<std::string, int> got_;  ///< guarded by mutex_
  OutputCollector* collector_ = nullptr;
  std::vector<Tuple> tuples_;
};

/// Workers and drivers that come and go at random, on the embedded registry and broker.
class Placement : public Endpoints {
 protected:
  struct Member {
    std::unique_ptr<config::Metrics> metrics;
    std::unique_ptr<Worker> worker;
    std::size_t tasks = 0;
  };

  Placement() { KeepingBolt::reset(); }

  /// \param tasks of the spout, in this worker. \param longest_drain nullopt: as usual
  void add_worker(std::size_t tasks, std::optional<std::chrono::milliseconds> longest_drain = tests::patience) {
    const std::string yaml =
        "topology.name: t\nspouts:\n  in:\n    {broker: rabbitmq, driver: d, channel: up, parallelism: " +
        std::to_string(tasks) +
        ",\n"
        "     fields: [text, driverID, time], builder: text}\nbolts:\n  keep: {class: Keeping, inputs: {from: in}}\n"
        "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: keep}}\n";
    ComponentRegistry components;
    components.add_bolt<KeepingBolt>("Keeping");
    Member member;
    member.metrics = std::make_unique<config::Metrics>();
    WorkerOptions options{.definition = TopologyDefinition::parse(yaml, "t.yaml"),
                          .components = std::move(components),
                          .library_folders = {},
                          .registry = registry_.get(),
                          .clock = nullptr,
                          .metrics = member.metrics.get(),
                          .fence = std::make_shared<StandstillFence>(),
                          .longest_drain = longest_drain};
    member.worker = std::make_unique<Worker>(std::move(options));
    member.worker->start();
    member.tasks = tasks;
    members_.push_back(std::move(member));
  }

  void remove_worker(std::size_t place) {
    members_[place].worker.reset();  // before its metrics
    members_.erase(members_.begin() + static_cast<std::ptrdiff_t>(place));
  }

  void add_driver() {
    const std::string id = "i" + std::to_string(mailboxes_.size());
    mailboxes_[id] = std::make_unique<Mailbox>(*broker_, topic(id, "down"));
    devices_[id] = device(id);
    present_.push_back(id);
    show_driver(id);
  }

  void remove_driver(std::size_t place) {
    discovery::remove_tree(*registry_, paths_.instance("d"_driver, discovery::InstanceId(present_[place])));
    present_.erase(present_.begin() + static_cast<std::ptrdiff_t>(place));
  }

  void send(const std::string& id) {
    int& number = sent_[id];
    devices_[id]->publish(message(std::to_string(number++), id));
  }

  /// Channels read by each worker.
  std::vector<std::size_t> loads() const {
    std::vector<std::size_t> all;
    for (const auto& member : members_) {
      double channels = 0;
      for (const auto& sample : member.metrics->collect()) {
        if (sample.name == "iotcloud_spout_channels") channels = sample.value;
      }
      all.push_back(static_cast<std::size_t>(channels));
    }
    return all;
  }

  /// Whether each worker reads so much that no task need have more than one unit more than any other.
  bool even() const {
    const auto read = loads();
    std::size_t sum = 0, least = present_.size(), most = 0;
    for (std::size_t i = 0; i < read.size(); ++i) {
      const std::size_t tasks = members_[i].tasks;
      sum += read[i];
      least = std::min(least, read[i] / tasks);
      most = std::max(most, (read[i] + tasks - 1) / tasks);
    }
    return sum == present_.size() && most <= least + 1;
  }

  /// Whether all that a driver sent came back to it, some of it perhaps twice.
  bool complete(const std::string& id) {
    const auto texts = mailboxes_[id]->texts();
    return std::set<std::string>(texts.begin(), texts.end()).size() == static_cast<std::size_t>(sent_[id]);
  }

  void expect_each_once_in_order() {
    for (const auto& [id, mailbox] : mailboxes_) {
      std::vector<std::string> all;
      all.reserve(static_cast<std::size_t>(sent_[id]));
      for (int number = 0; number < sent_[id]; ++number) all.push_back(std::to_string(number));
      EXPECT_EQ(mailbox->texts(), all) << id;
    }
  }

  std::string description() const {
    std::string text = std::to_string(present_.size()) + " drivers, read by";
    const auto read = loads();
    for (std::size_t i = 0; i < read.size(); ++i) {
      text += " " + std::to_string(read[i]) + " (" + std::to_string(members_[i].tasks) + " tasks)";
    }
    return text;
  }

  std::vector<Member> members_;
  std::vector<std::string> present_;
  std::map<std::string, int> sent_;
  std::map<std::string, std::unique_ptr<brokers::Publisher>> devices_;
  std::map<std::string, std::unique_ptr<Mailbox>> mailboxes_;
};

TEST_F(Placement, IsWithinOneUnitOfEvenOverAllTasksAfterEachOfManyChangesAndNothingIsLostOrReorderedOrComesTwice) {
  std::mt19937 choose(20161121);  // NOLINT: the same changes each time
  const auto below = [&](std::size_t limit) { return choose() % limit; };
  add_worker(2);
  std::string last;
  for (int step = 0; step < 40; ++step) {
    // A reader that moves has a while to drain, after which the broker delivers again: no backlog of earlier steps may
    // need it.
    for (const auto& id : present_) ASSERT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
    switch (below(6)) {
      case 0:
        last = "a worker joins";
        if (members_.size() < 5) add_worker(1 + below(3));
        break;
      case 1:
        last = "a worker leaves";
        if (members_.size() > 1) remove_worker(below(members_.size()));
        break;
      case 2:
        last = "a driver goes";
        if (present_.size() > 3) {
          const std::size_t place = below(present_.size());
          const std::string id = present_[place];  // what it sent must be through: its echo has no way afterwards
          ASSERT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
          remove_driver(place);
        }
        break;
      default:
        last = "a driver comes";
        add_driver();
    }
    for (const auto& id : present_) {
      for (int i = 0; i < 20; ++i) send(id);  // while units move
    }
    ASSERT_TRUE(eventually([&] { return even(); })) << "step " << step << ", " << last << ": " << description();
  }
  for (const auto& mailbox : mailboxes_) {
    ASSERT_TRUE(eventually([&] { return complete(mailbox.first); })) << mailbox.first << " lost messages";
  }
  expect_each_once_in_order();
}

TEST_F(Placement, DrainsWhatMovesToAnotherWorkerSoThatNothingComesTwice) {
  add_worker(1);
  for (int i = 0; i < 4; ++i) add_driver();
  ASSERT_TRUE(eventually([&] { return even(); })) << description();
  KeepingBolt::keeps = true;
  for (const auto& id : present_) send(id);
  ASSERT_TRUE(eventually([] { return KeepingBolt::total() == 4; }));
  add_worker(1);
  // Two of them are to go to the new worker: what they send stays in the broker, while the others' comes in.
  ASSERT_TRUE(eventually([&] {
    for (const auto& id : present_) send(id);
    const auto got = KeepingBolt::got();
    int most = 0;
    for (const auto& [id, count] : got) most = std::max(most, count);
    return std::count_if(got.begin(), got.end(), [&](const auto& entry) { return entry.second + 30 <= most; }) == 2;
  }));
  EXPECT_EQ(loads().back(), 0U) << "it reads what is not drained";
  KeepingBolt::keeps = false;
  ASSERT_TRUE(eventually([&] { return even() && loads().back() == 2; })) << description();
  for (const auto& id : present_) {
    ASSERT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
  }
  expect_each_once_in_order();
}

TEST_F(Placement, DrainsWhatMovesToAnotherTask) {
  add_worker(2);
  for (int i = 0; i < 4; ++i) add_driver();
  ASSERT_TRUE(eventually([&] { return even(); })) << description();
  KeepingBolt::keeps = true;
  for (const auto& id : present_) send(id);
  ASSERT_TRUE(eventually([] { return KeepingBolt::total() == 4; }));
  remove_driver(0);
  remove_driver(0);  // perhaps both of one task
  KeepingBolt::keeps = false;
  for (const auto& id : present_) {
    send(id);
    ASSERT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
    EXPECT_EQ(mailboxes_[id]->texts(), (std::vector<std::string>{"0", "1"})) << id;
  }
}

TEST_F(Placement, GivesAwayWhatIsNotDrainedInTime) {
  add_worker(1, std::nullopt);
  for (int i = 0; i < 2; ++i) add_driver();
  ASSERT_TRUE(eventually([&] { return even(); })) << description();
  KeepingBolt::keeps = true;
  for (const auto& id : present_) send(id);
  ASSERT_TRUE(eventually([] { return KeepingBolt::total() == 2; }));
  add_worker(1, std::nullopt);
  EXPECT_TRUE(eventually([&] { return loads() == std::vector<std::size_t>{1, 1}; })) << description();
  KeepingBolt::keeps = false;
  for (const auto& id : present_) EXPECT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
}

}  // namespace
}  // namespace iotcloud::topology
