#include <algorithm>
#include <map>
#include <random>
#include <set>

#include <iotcloud/tests/topology/endpoints_fixture.h>

namespace iotcloud::topology {
namespace {

/// Workers and drivers that come and go at random, on the embedded registry and broker.
class Placement : public Endpoints {
 protected:
  struct Member {
    std::unique_ptr<config::Metrics> metrics;
    std::unique_ptr<Worker> worker;
    std::size_t tasks = 0;
  };

  /// \param tasks of the spout, in this worker.
  void add_worker(std::size_t tasks) {
    const std::string yaml =
        "topology.name: t\nspouts:\n  in:\n    {broker: rabbitmq, driver: d, channel: up, parallelism: " +
        std::to_string(tasks) +
        ",\n"
        "     fields: [text, driverID, time], builder: text}\nbolts:\n"
        "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: in}}\n";
    Member member;
    member.metrics = std::make_unique<config::Metrics>();
    WorkerOptions options{.definition = TopologyDefinition::parse(yaml, "t.yaml"),
                          .components = {},
                          .library_folders = {},
                          .registry = registry_.get(),
                          .clock = nullptr,
                          .metrics = member.metrics.get()};
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
    discovery::remove_tree(*registry_, paths_.instance("d", present_[place]));
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

TEST_F(Placement, IsWithinOneUnitOfEvenOverAllTasksAfterEachOfManyChangesAndLosesAndReordersNothing) {
  std::mt19937 choose(20161121);  // NOLINT: the same changes each time
  const auto below = [&](std::size_t limit) { return choose() % limit; };
  add_worker(2);
  std::string last;
  for (int step = 0; step < 40; ++step) {
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
  for (const auto& [id, mailbox] : mailboxes_) {
    ASSERT_TRUE(eventually([&] { return complete(id); })) << id << " lost messages";
    int next = 0;
    for (const auto& text : mailbox->texts()) {
      const int number = std::stoi(text);
      ASSERT_LE(number, next) << id << ": a message overtook another";
      if (number == next) ++next;  // what is lower was delivered again
    }
  }
}

}  // namespace
}  // namespace iotcloud::topology
