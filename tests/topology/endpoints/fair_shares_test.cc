// Who reads what: the arithmetic alone. placement_test.cc has workers that really come and go.
#include <algorithm>
#include <array>
#include <map>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/topology/endpoints/placement/fair_shares.h>
#include <iotcloud/topology/endpoints/placement/task_loads.h>

namespace iotcloud::topology {
namespace {

std::vector<std::string> names(const std::string& prefix, int count) {
  std::vector<std::string> all;
  for (int i = 0; i < count; ++i) all.push_back(prefix + std::to_string(i));
  return all;
}

std::vector<Sharer> sharers(int count, int tasks = 1) {
  std::vector<Sharer> all;
  for (int i = 0; i < count; ++i) all.push_back({"w" + std::to_string(i), tasks});
  return all;
}

/// Worker by unit, of one kind.
std::map<std::string, std::string> shares_of(const std::vector<std::string>& units,
                                             const std::vector<Sharer>& workers) {
  const auto shares = fair_shares({units}, workers);
  std::map<std::string, std::string> by_unit;
  for (std::size_t i = 0; i < units.size(); ++i) by_unit[units[i]] = workers[shares[0][i]].worker;
  return by_unit;
}

TEST(FairShares, GiveEveryWorkerAsMuchOrOneLess) {
  for (const int units : {0, 1, 3, 4, 10, 101}) {
    for (const int workers : {1, 2, 3, 7}) {
      std::map<std::string, int> load;
      for (const auto& sharer : sharers(workers)) load[sharer.worker] = 0;
      for (const auto& [unit, worker] : shares_of(names("u", units), sharers(workers))) ++load[worker];
      const auto [least, most] =
          std::minmax_element(load.begin(), load.end(), [](auto& a, auto& b) { return a.second < b.second; });
      EXPECT_LE(most->second - least->second, 1) << units << " units, " << workers << " workers";
    }
  }
}

TEST(FairShares, AreTheSameWhateverTheOrderOfTheNames) {
  auto units = names("u", 50);
  auto workers = sharers(4);
  workers[2].tasks = 3;
  const auto shares = shares_of(units, workers);
  std::reverse(units.begin(), units.end());
  std::reverse(workers.begin(), workers.end());
  EXPECT_EQ(shares_of(units, workers), shares);
}

TEST(FairShares, MoveFewUnitsWhenAWorkerComes) {
  const auto before = shares_of(names("u", 1000), sharers(4));
  const auto after = shares_of(names("u", 1000), sharers(5));
  int moved = 0;
  for (const auto& [unit, worker] : before) moved += after.at(unit) != worker;
  EXPECT_GE(moved, 200);  // the new one's share
  EXPECT_LT(moved, 400);
}

/// So that the tuples of a driver's channels meet in one worker, whatever the parallelism of their spouts.
TEST(FairShares, AreTheSameForSpoutsWithDifferentNumbersOfTasksWhenAllWorkersHaveThem) {
  EXPECT_EQ(shares_of(names("u", 101), sharers(3, 1)), shares_of(names("u", 101), sharers(3, 4)));
}

TEST(FairShares, FollowTheNumbersOfTasks) {
  const std::vector<Sharer> workers{{"small", 1}, {"large", 3}};
  std::map<std::string, int> load;
  for (const auto& [unit, worker] : shares_of(names("u", 100), workers)) ++load[worker];
  EXPECT_EQ(load["small"], 25);
  EXPECT_EQ(load["large"], 75);
}

/// Workers as SpoutPlacement keeps them, without registry and broker: each evens out what its share brings.
class ManyTasks {
 public:
  void join(const Sharer& sharer) {
    workers_[sharer.worker] = {sharer.tasks, TaskLoads(static_cast<std::size_t>(sharer.tasks)), {}};
  }
  void leave(const std::string& worker) { workers_.erase(worker); }
  void show(UnitKind kind, const std::string& unit) { units(kind).push_back(unit); }
  void hide(UnitKind kind, std::size_t place) {
    units(kind).erase(units(kind).begin() + static_cast<std::ptrdiff_t>(place));
  }
  std::vector<std::string>& units(UnitKind kind) { return units_[static_cast<std::size_t>(kind)]; }
  std::size_t workers() const { return workers_.size(); }
  std::string worker(std::size_t place) const {
    return std::next(workers_.begin(), static_cast<std::ptrdiff_t>(place))->first;
  }

  void share_out() {
    std::vector<Sharer> sharers;
    for (const auto& [name, worker] : workers_) sharers.push_back({name, worker.tasks});
    const auto shares = fair_shares(units_, sharers);
    for (std::size_t kind = 0; kind < unit_kinds; ++kind) {
      std::map<std::string, std::string> reader;
      for (std::size_t i = 0; i < units_[kind].size(); ++i) reader[units_[kind][i]] = sharers[shares[kind][i]].worker;
      for (auto& [name, worker] : workers_) worker.follow(static_cast<UnitKind>(kind), name, reader);
    }
    for (auto& [name, worker] : workers_) worker.even_out();
  }

  /// By how much the busiest task of all workers exceeds the idlest: of each kind, and in all.
  std::array<std::size_t, unit_kinds + 1> differences() const {
    std::array<std::vector<std::size_t>, unit_kinds + 1> loads;
    for (const auto& [name, worker] : workers_) {
      for (std::size_t task = 0; task < static_cast<std::size_t>(worker.tasks); ++task) {
        std::array<std::size_t, unit_kinds> load{};
        for (std::size_t kind = 0; kind < unit_kinds; ++kind) {
          for (const auto& [unit, place] : worker.task_of[kind]) load[kind] += place == task;
          loads[kind].push_back(load[kind]);
        }
        loads.back().push_back(load[0] + load[1]);
      }
    }
    std::array<std::size_t, unit_kinds + 1> differences{};
    for (std::size_t i = 0; i < loads.size(); ++i) {
      const auto [least, most] = std::minmax_element(loads[i].begin(), loads[i].end());
      differences[i] = *most - *least;
    }
    return differences;
  }

 private:
  struct Worker {
    int tasks = 0;
    TaskLoads loads;
    std::array<std::map<std::string, std::size_t>, unit_kinds> task_of;

    void follow(UnitKind kind, const std::string& name, const std::map<std::string, std::string>& reader) {
      auto& mine = task_of[static_cast<std::size_t>(kind)];
      std::erase_if(mine, [&](const auto& unit) {
        const auto found = reader.find(unit.first);
        if (found != reader.end() && found->second == name) return false;
        loads.remove(unit.second, kind);
        return true;
      });
      for (const auto& [unit, worker] : reader) {
        if (worker != name || mine.contains(unit)) continue;
        mine[unit] = loads.idlest(kind);
        loads.add(mine[unit], kind);
      }
    }
    void even_out() {
      while (const auto move = loads.next_move()) {
        auto& mine = task_of[static_cast<std::size_t>(move->kind)];
        const auto moved =
            std::find_if(mine.begin(), mine.end(), [&](const auto& unit) { return unit.second == move->from; });
        ASSERT_NE(moved, mine.end());
        moved->second = move->to;
        loads.remove(move->from, move->kind);
        loads.add(move->to, move->kind);
      }
    }
  };
  std::map<std::string, Worker> workers_;
  std::vector<std::vector<std::string>> units_{unit_kinds};
};

TEST(FairShares, AreWithinOneUnitOfEvenOverAllTasksOfEachKindAndInAllAfterAnyChange) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    std::mt19937 choose(seed);  // NOLINT: the same changes each time
    const auto below = [&](std::size_t limit) { return choose() % limit; };
    ManyTasks all;
    int next = 0;
    all.join({"w", 1 + static_cast<int>(below(4))});
    for (int step = 0; step < 200; ++step) {
      const auto kind = static_cast<UnitKind>(below(unit_kinds));
      const std::string name = std::to_string(next++);
      switch (below(6)) {
        case 0:
          if (all.workers() < 6) all.join({"w" + name, 1 + static_cast<int>(below(6))});
          break;
        case 1:
          if (all.workers() > 1) all.leave(all.worker(below(all.workers())));
          break;
        case 2:
          if (!all.units(kind).empty()) all.hide(kind, below(all.units(kind).size()));
          break;
        default:
          for (std::size_t i = below(5); i > 0; --i) all.show(kind, "u" + name + "-" + std::to_string(i));
      }
      all.share_out();
      const auto [gateways, instances, in_all] = all.differences();
      ASSERT_LE(gateways, 1U) << "seed " << seed << ", step " << step;
      ASSERT_LE(instances, 1U) << "seed " << seed << ", step " << step;
      ASSERT_LE(in_all, 1U) << "seed " << seed << ", step " << step;
    }
  }
}

}  // namespace
}  // namespace iotcloud::topology
