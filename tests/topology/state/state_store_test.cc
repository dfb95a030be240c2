// What a store keeps, of its own, and after a kill.
#include <csignal>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/tests/topology/state/state_fixture.h>
#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/state/key_value_state.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
namespace fs = std::filesystem;

/// The stores that must be alike: "memory" and "rocksdb".
class StateStores : public testing::TestWithParam<const char*> {
 protected:
  std::string url() const {
    if (GetParam() == std::string("rocksdb")) return folder_.url();
    return "memory://" + folder_.path();  // a name of its own
  }
  KeyValueState open(const std::string& component = "count", int index = 0, int count = 2) const {
    return {make_state_store(url()), StateOwner{"t", component, index, count}};
  }

 private:
  Folder folder_;
};
INSTANTIATE_TEST_SUITE_P(All, StateStores, testing::Values("memory", "rocksdb"),
                         [](const auto& each) { return std::string(each.param); });

TEST_P(StateStores, ACheckpointIsFoundAgainAndWhatCameAfterItIsNot) {
  {
    KeyValueState state = open();
    state.put("kept", "1");
    state.put("erased", "2");
    state.checkpoint();
    state.put("kept", "3");
    state.erase("erased");
    state.put_int("number", -7);
    state.checkpoint();
    state.put("forgotten", "4");
    EXPECT_TRUE(state.changed());
  }
  const KeyValueState state = open();
  EXPECT_THAT(state.entries(), ElementsAre(Pair("kept", "3"), Pair("number", "-7")));
  EXPECT_EQ(state.get_int("number"), -7);
  EXPECT_EQ(state.version(), 2U);
  EXPECT_FALSE(state.changed());
}

TEST_P(StateStores, KeysAndValuesMayBeAnyBytes) {
  const std::string key("\0\xff k\0", 5), value("\0\0\xfe", 3);
  {
    KeyValueState state = open();
    state.put(key, value);
    state.put("", "the empty key");
    state.checkpoint();
  }
  const KeyValueState state = open();
  ASSERT_NE(state.find(key), nullptr);
  EXPECT_EQ(*state.find(key), value);
  EXPECT_EQ(state.get(""), "the empty key");
}

TEST_P(StateStores, TasksAndComponentsDoNotSeeEachOthersKeys) {
  const auto put = [this](const std::string& component, int index) {
    KeyValueState state = open(component, index);
    state.put("who", component + std::to_string(index));
    state.checkpoint();
  };
  put("a", 0);
  put("a", 1);
  put("ab", 0);
  EXPECT_THAT(open("a", 0).entries(), ElementsAre(Pair("who", "a0")));
  EXPECT_THAT(open("a", 1).entries(), ElementsAre(Pair("who", "a1")));
  EXPECT_THAT(open("ab", 0).entries(), ElementsAre(Pair("who", "ab0")));
  EXPECT_THAT(open("b", 0).entries(), IsEmpty());
}

/// The task whose place among `count` a fields grouping chooses for the key's text.
std::size_t task_of(std::string_view key, std::size_t count) {
  return task_of_key(Values(std::string(key)), count);
}

/// Each key's value by the task that has it now; the key is the grouping's.
class Rehashing : public StateStores {
 protected:
  KeyValueState task(int index, int count, StateOwner::TaskOf known = task_of) const {
    StateOwner owner{"t", "count", index, count};
    owner.task_of = std::move(known);
    return {make_state_store(url()), std::move(owner)};
  }
  /// Lets every task count its keys once more, as tuples of these keys would.
  void count(int tasks) {
    for (int i = 0; i < tasks; ++i) {
      KeyValueState state = task(i, tasks);
      for (const std::string& key : keys_) {
        if (task_of(key, static_cast<std::size_t>(tasks)) != static_cast<std::size_t>(i)) continue;
        state.put_int(key, state.get_int(key) + 1);
      }
      state.checkpoint();
    }
  }
  const std::vector<std::string> keys_{"a", "b", "c", "driver-1", "driver-2", std::string("\0\xff", 2), ""};
};
INSTANTIATE_TEST_SUITE_P(All, Rehashing, testing::Values("memory", "rocksdb"),
                         [](const auto& each) { return std::string(each.param); });

TEST_P(Rehashing, AnotherNumberOfTasksHasEachKeyWhereItsTuplesComeNow) {
  int times = 0;
  for (const int tasks : {2, 3, 2, 1, 4}) {
    count(tasks);
    ++times;
    std::size_t found = 0;
    for (int i = 0; i < tasks; ++i) {
      const KeyValueState state = task(i, tasks);
      for (const auto& [key, value] : state.entries()) {
        EXPECT_EQ(task_of(key, static_cast<std::size_t>(tasks)), static_cast<std::size_t>(i)) << key;
        EXPECT_EQ(value, std::to_string(times)) << key << " with " << tasks << " tasks";
      }
      found += state.size();
    }
    EXPECT_EQ(found, keys_.size()) << tasks << " tasks";
  }
}

TEST_P(Rehashing, WithoutKnowingWhoUsesAKeyAnotherNumberIsRefusedWithWhatToDoAndNothingIsLost) {
  count(2);
  const auto nobody_knows = [](std::string_view, std::size_t) { return std::nullopt; };
  for (const auto& problem : {problem_of([&] { task(0, 3, {}); }), problem_of([&] { task(0, 3, nobody_knows); })}) {
    EXPECT_THAT(problem, AllOf(HasSubstr("written by 2 tasks, and now there are 3"), HasSubstr("state.keys: grouping"),
                               HasSubstr("grouping_key"), HasSubstr("Set the old number of tasks again"),
                               HasSubstr("Redis"), HasSubstr("state.store")));
  }
  EXPECT_EQ(task(0, 2).size() + task(1, 2).size(), keys_.size());
  const KeyValueState other(make_state_store(url()), StateOwner{"t", "other", 0, 3});
  EXPECT_EQ(other.size(), 0U) << "another component may have any number";
}

TEST_P(Rehashing, AKeyThatWasNotWhereItsTuplesWentIsRefused) {
  for (int i = 0; i < 2; ++i) {
    KeyValueState state = task(i, 2);
    state.put_int("total", 7);  // each task has its own
    state.checkpoint();
  }
  EXPECT_THAT(problem_of([&] { task(0, 3); }),
              AllOf(HasSubstr("has the key \"total\""), HasSubstr("not what the tuples are grouped by")));
  EXPECT_EQ(task(0, 2).get_int("total") + task(1, 2).get_int("total"), 14);
}

TEST_P(Rehashing, OneTaskGetsAllKeysAlsoWhenNothingSaysWhoUsesThem) {
  count(3);
  EXPECT_EQ(task(0, 1, {}).size(), keys_.size());
  EXPECT_EQ(task(0, 1, {}).get_int("driver-1"), 1);
  EXPECT_THAT(problem_of([&] { task(0, 3, {}); }), HasSubstr("written by 1 tasks, and now there are 3"));
}

TEST_P(Rehashing, OneTaskIsNotGivenOneOfTwoValuesOfAKey) {
  for (int i = 0; i < 2; ++i) {
    KeyValueState state = task(i, 2, {});
    state.put_int("total", 7);
    state.checkpoint();
  }
  EXPECT_THAT(problem_of([&] { task(0, 1, {}); }), AllOf(HasSubstr("more than one task has the key \"total\""),
                                                         HasSubstr("Set the old number of tasks again")));
  EXPECT_EQ(task(0, 2, {}).get_int("total") + task(1, 2, {}).get_int("total"), 14);
}

TEST_P(Rehashing, ATaskOfTheOldNumberWritesNothingAnyMore) {
  count(2);
  KeyValueState old = task(0, 2);
  for (const std::string& key : keys_) old.put(key, "old");
  const KeyValueState first = task(0, 3);
  EXPECT_THAT(problem_of([&] { old.checkpoint(); }), HasSubstr("was given to 3 tasks, and this is one of 2"));
  EXPECT_EQ(task(0, 3).entries(), first.entries());
}

TEST(StateStore, OtherUrlsAreRefusedWithWhatWouldBeRight) {
  for (const char* url : {"", "memory://", "rocksdb://", "rocksdb://relative", "mysql://host", "/path"}) {
    EXPECT_THAT(problem_of([url] { make_state_store(url); }), HasSubstr("rocksdb:///absolute/path")) << url;
  }
}

TEST(StateStore, AFolderOfSomethingElseIsRefusedAndLeftAlone) {
  const Folder folder;
  std::ofstream(folder.path() + "/letter.txt") << "dear";
  EXPECT_THAT(problem_of([&] { make_state_store("rocksdb://" + folder.path()); }), HasSubstr("is empty or not there"));
  EXPECT_THAT(problem_of([&] { make_state_store("rocksdb://" + folder.path() + "/letter.txt"); }),
              HasSubstr("is empty or not there"));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()), 1);
}

TEST(StateStore, ADamagedDatabaseIsRefused) {
  const Folder folder;
  {
    KeyValueState state(make_state_store(folder.url()), {"t", "count", 0, 1});
    state.put("a", std::string(1000, 'a'));
    state.checkpoint();
  }
  std::ofstream(folder.path() + "/db/CURRENT") << "nonsense\n";
  EXPECT_THAT(problem_of([&] { make_state_store(folder.url()); }), HasSubstr("cannot be opened"));
}

TEST(StateStore, ATornWriteIsDroppedAndWhatWasBeforeItIsThere) {
  const Folder folder;
  {
    KeyValueState state(make_state_store(folder.url()), {"t", "count", 0, 1});
    state.put("a", "1");
    state.checkpoint();
    state.put("a", "2");
    state.put("b", "2");
    state.checkpoint();
  }
  fs::path log;
  for (const auto& file : fs::directory_iterator(folder.path() + "/db")) {
    if (file.path().extension() == ".log" && file.file_size() > 0) log = file.path();
  }
  ASSERT_FALSE(log.empty());
  fs::resize_file(log, fs::file_size(log) - 5);
  const KeyValueState state(make_state_store(folder.url()), {"t", "count", 0, 1});
  EXPECT_THAT(state.entries(), ElementsAre(Pair("a", "1")));
  EXPECT_EQ(state.version(), 1U);
}

/// A shared store that any task may write, with a failover in which it loses what it has.
class ForgetfulStore final : public StateStore {
 public:
  bool shared() const override { return true; }
  StoredState load(const StateOwner&) override { return {}; }
  ClaimedValue claim(const StateOwner&, const std::string& key) override { return entries[key]; }
  void commit(const StateOwner&, const Checkpoint& checkpoint) override {
    for (const auto& [key, value] : checkpoint.changes) {
      entries[key].value = value;
      ++entries[key].changes;
    }
  }
  std::map<std::string, ClaimedValue> entries;
};

TEST(StateStore, OfASharedStoreATaskNoticesTheLossOfTheKeysThatItWroteLastAndForgetsOlderOnes) {
  auto store = std::make_shared<ForgetfulStore>();
  constexpr std::size_t most = 100, more = most / 2, all = most + more;
  KeyValueState state(store, {"t", "count", 0, 1}, most);
  const auto key = [](std::size_t i) { return "key " + std::to_string(i); };
  for (std::size_t i = 0; i < all;) {
    for (const std::size_t end = i + 10; i < end; ++i) state.put(key(i), "x");
    state.checkpoint();
  }
  store->entries.clear();
  for (const std::size_t i : {std::size_t{0}, all - more, all - 1}) static_cast<void>(state.find(key(i)));
  EXPECT_THAT(state.take_losses(),
              ElementsAre(HasSubstr("\"" + key(all - more) + "\""), HasSubstr("\"" + key(all - 1) + "\"")));
}

TEST(StateStore, KeysOfAnyBytesAreReadableInMessages) {
  EXPECT_EQ(internal::quoted("driver 1"), "\"driver 1\"");
  EXPECT_EQ(internal::quoted(std::string("\0\xff\"\\", 4)), R"("\x00\xff\x22\x5c")");
  EXPECT_EQ(internal::quoted(std::string(65, 'a')), "\"" + std::string(64, 'a') + "...\"");
}

TEST(StateStore, WhatATaskRemembersOfItsLastWritesIsBounded) {
  internal::LastWrites writes(4);
  for (int i = 0; i < 100; ++i) {
    writes.set(std::to_string(i), static_cast<std::uint64_t>(i));
    EXPECT_LE(writes.size(), 4U);
  }
  EXPECT_EQ(writes.find("99"), 99U);
  EXPECT_EQ(writes.find("98"), 98U) << "half of the limit is remembered in any case";
  EXPECT_EQ(writes.find("95"), std::nullopt);
  writes.set("98", 1000);
  EXPECT_EQ(writes.find("98"), 1000U);
  writes.forget("98");
  EXPECT_EQ(writes.find("98"), std::nullopt);
}

TEST(StateStore, AValueThatIsNoNumberSaysSo) {
  KeyValueState state(make_state_store("memory://no number"), {"t", "count", 0, 1});
  state.put("a", "12x");
  EXPECT_THAT(problem_of([&] { static_cast<void>(state.get_int("a")); }), HasSubstr("\"12x\""));
  EXPECT_EQ(state.get_int("b", 5), 5);
}

TEST(StateStore, AfterAKillInTheMiddleOfWritingEveryDurableCheckpointIsThereAndWhole) {
  const Folder folder;
  const std::string url = folder.url();
  std::int64_t confirmed = 0;
  for (int round = 0; round < 3; ++round) {
    int ends[2];
    ASSERT_EQ(pipe(ends), 0);
    const pid_t child = fork();
    if (child == 0) {
      dup2(ends[1], STDOUT_FILENO);
      close(ends[0]);
      close(ends[1]);
      execl(STATE_WRITER, STATE_WRITER, url.c_str(), nullptr);
      _exit(127);
    }
    close(ends[1]);
    std::int64_t said = 0;
    for (int i = 0; i < 10 + round; ++i) ASSERT_EQ(read(ends[0], &said, sizeof said), ssize_t{sizeof said});
    kill(child, SIGKILL);
    while (read(ends[0], &said, sizeof said) == ssize_t{sizeof said}) continue;
    close(ends[0]);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFSIGNALED(status));
    confirmed += said;

    KeyValueState state(make_state_store(folder.url()), {"t", "count", 0, 1});
    const std::int64_t found = std::stoll(state.get("a"));
    EXPECT_GE(found, said);
    EXPECT_LE(found, said + 1) << "one that was under way at most";
    EXPECT_EQ(state.get("b"), state.get("a")) << "all keys of one checkpoint or none";
    EXPECT_EQ(state.get("c"), state.get("a"));
    EXPECT_GE(state.version(), static_cast<std::uint64_t>(confirmed));
    confirmed = static_cast<std::int64_t>(state.version());
  }
}

}  // namespace
}  // namespace iotcloud::topology::workshop
