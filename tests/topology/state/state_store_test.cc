// What a store keeps, of its own, and after a kill.
#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/tests/topology/state/state_fixture.h>
#include <iotcloud/topology/state/key_value_state.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::workshop {
namespace {

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

TEST_P(StateStores, AnotherNumberOfTasksIsRefused) {
  {
    KeyValueState state = open("count", 0, 2);
    state.put("a", "1");
    state.checkpoint();
  }
  const std::string problem = problem_of([this] { open("count", 0, 3); });
  EXPECT_THAT(problem, HasSubstr("written by 2 tasks, and now there are 3"));
  EXPECT_EQ(open("other", 0, 3).size(), 0U) << "another component may have any number";
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
