// Bolts with state: what is acked was kept, and what was kept counts once.
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/state/counting.h>
#include <iotcloud/tests/topology/state/state_fixture.h>
#include <iotcloud/topology/state/state_store.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
using testing::UnorderedElementsAre;

TEST(StatefulBolts, AcksAreHeldUntilTheCheckpointIsDurable) {
  const Folder folder;
  Counting counting(make_stateful_bolt<Count>({.store = folder.url(), .checkpoint = 100ms}));
  counting.put("a");
  counting.put("b");
  EXPECT_THAT(counting.seen(), ElementsAre("a=1", "b=1")) << "emits are not held";
  counting.pass(99ms);
  EXPECT_THAT(counting.source->acked(), IsEmpty());
  counting.pass(1ms);
  EXPECT_THAT(counting.source->acked(), UnorderedElementsAre(1, 2));
  counting.put("!");
  EXPECT_THAT(counting.source->failed(), ElementsAre(3)) << "fails are not held";
}

TEST(StatefulBolts, ANewLifeBeginsWithTheLastCheckpointAndTheReplayOfTheRest) {
  const Folder folder;
  const auto factory = make_stateful_bolt<Count>({.store = folder.url(), .checkpoint = 100ms});
  {
    Counting counting(factory, {}, 2);
    for (const char* word : {"a", "b", "a"}) counting.put(word);
    counting.pass(100ms);
    EXPECT_EQ(counting.source->acked().size(), 3U);
    counting.put("a");
    counting.put("b");
    EXPECT_EQ(counting.source->acked().size(), 3U);
  }
  Counting counting(factory, {}, 2);
  counting.put("a");  // the spout's replay
  counting.put("b");
  EXPECT_THAT(counting.seen(), ElementsAre("a=3", "b=2")) << "not acked, so not counted";
}

/// A store whose commits fail while `broken` is set, before or after they were written.
class FailingStore final : public StateStore {
 public:
  StoredState load(const StateOwner&) override { return stored; }
  void commit(const StateOwner&, const Checkpoint& checkpoint) override {
    if (broken && !after) throw StateError("the disk is full");
    stored.version = checkpoint.version;
    for (const auto& [key, value] : checkpoint.changes) {
      if (value) {
        stored.entries[key] = *value;
      } else {
        stored.entries.erase(key);
      }
    }
    if (broken) throw StateError("the disk went away");
  }
  bool broken = false, after = false;
  StoredState stored;
};

TEST(StatefulBolts, AFailedCheckpointTakesTheStateBack) {
  auto store = std::make_shared<FailingStore>();
  KeyValueState state(store, {"t", "count", 0, 1});
  state.put("changed", "1");
  state.put("erased", "1");
  state.checkpoint();
  store->broken = true;
  state.put("changed", "2");
  state.put("changed", "3");
  state.erase("erased");
  state.put("new", "1");
  EXPECT_THAT(problem_of([&] { state.checkpoint(); }), HasSubstr("disk is full"));
  EXPECT_THAT(state.entries(), ElementsAre(Pair("changed", "1"), Pair("erased", "1")));
  EXPECT_EQ(state.version(), 1U);
}

TEST(StatefulBolts, ACheckpointWhoseOutcomeIsUnknownIsPutRightByTheNext) {
  auto store = std::make_shared<FailingStore>();
  KeyValueState state(store, {"t", "count", 0, 1});
  state.put("a", "1");
  state.checkpoint();
  store->broken = store->after = true;
  state.put("a", "2");
  state.put("b", "2");
  EXPECT_THROW(state.checkpoint(), StateError);
  EXPECT_THAT(store->stored.entries, ElementsAre(Pair("a", "2"), Pair("b", "2"))) << "it was written after all";
  store->broken = false;
  state.checkpoint();
  EXPECT_THAT(store->stored.entries, ElementsAre(Pair("a", "1")));
}

/// Fails its next checkpoint when told.
struct Fragile : Count {
  explicit Fragile(std::shared_ptr<bool> broken) : broken_(std::move(broken)) {}
  void pre_checkpoint() override {
    if (*broken_) throw std::runtime_error("not now");
  }
  void rolled_back() override { *broken_ = false; }
  std::shared_ptr<bool> broken_;
};

TEST(StatefulBolts, AFailedCheckpointFailsTheTuplesSinceTheLastOneAndTheirReplayCountsOnce) {
  auto broken = std::make_shared<bool>(false);
  Counting counting(make_stateful_bolt<Fragile>({.store = "memory://fragile", .checkpoint = 100ms}, broken));
  counting.put("a");
  counting.pass(100ms);
  *broken = true;
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(1));
  EXPECT_THAT(counting.source->failed(), ElementsAre(2));
  EXPECT_THAT(counting.runtime->snapshot().component("count").last_error, HasSubstr("not now"));
  EXPECT_FALSE(*broken) << "the bolt was told";
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.seen(), ElementsAre("a=1", "a=2", "a=2"));
  EXPECT_THAT(counting.source->acked(), ElementsAre(1, 3));
}

/// Acks a tuple when the next one has come, and fails its next checkpoint when told.
struct Hesitant : Fragile {
  using Fragile::Fragile;
  void execute(const Tuple& tuple) override {
    state_->put_int("a", state_->get_int("a") + 1);
    if (before_) out_->ack(before_);
    before_ = tuple;
  }
  Tuple before_{};
};

TEST(StatefulBolts, AFailedCheckpointFailsATupleThatTheBoltAcksOnlyLater) {
  auto broken = std::make_shared<bool>(true);
  Counting counting(make_stateful_bolt<Hesitant>({.store = "memory://hesitant", .checkpoint = 100ms}, broken));
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.source->failed(), ElementsAre(1)) << "its change is undone, so its ack would be wrong";
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), IsEmpty());
}

TEST(StatefulBolts, TheConfigurationNamesStoreAndPeriod) {
  const Folder folder;
  {
    Counting counting(make_stateful_bolt<Count>(), {{"state.store", folder.url()}, {"state.checkpoint", "20ms"}});
    counting.put("a");
    counting.pass(20ms);
    EXPECT_EQ(counting.source->acked().size(), 1U);
  }
  EXPECT_EQ(KeyValueState(make_state_store(folder.url()), {"t", "count", 0, 1}).get_int("a"), 1);
}

TEST(StatefulBolts, WithoutAStoreOrWithAPeriodThatIsNoneTheTopologyIsNotBuilt) {
  EXPECT_THAT(problem_of([] { const Counting none(make_stateful_bolt<Count>()); }), HasSubstr("state.store"));
  EXPECT_THAT(
      problem_of([] {
        const Counting none(make_stateful_bolt<Count>(), {{"state.store", "memory://x"}, {"state.checkpoint", "5"}});
      }),
      HasSubstr("\"5\" is no period"));
}

TEST(StatefulBolts, AChangedNumberOfTasksIsRefusedAtStartUnlessItIsKnownWhoUsesWhichKey) {
  const Folder folder;
  const auto factory = make_stateful_bolt<Count>({.store = folder.url(), .checkpoint = 10ms});
  {
    Counting counting(factory, {}, 2);
    counting.put("a");
    counting.pass(10ms);
  }
  EXPECT_THAT(problem_of([&] { const Counting three(factory, {}, 3); }),
              AllOf(HasSubstr("2 tasks, and now there are 3"), HasSubstr("\"state.keys: grouping\"")));
}

TEST(StatefulBolts, EveryCountIsKeptWhenTheNumberOfTasksChangesAndKeysAreTheGroupings) {
  const Folder folder;
  expect_counts_to_go_on(make_stateful_bolt<Count>({.store = folder.url(), .checkpoint = 10ms}),
                         {{"state.keys", "grouping"}}, 10ms);
}

/// Has a key of its own form, and says which words use it.
struct CountOfWord : Count {
  std::optional<Values> grouping_key(std::string_view key) const override {
    return key.starts_with("count of ") ? std::optional(Values(std::string(key.substr(9)))) : std::nullopt;
  }
  void execute(const Tuple& tuple) override {
    const auto& word = tuple.get<std::string>("value");
    const std::string key = "count of " + word;
    state_->put_int(key, state_->get_int(key) + 1);
    out_->emit(tuple, Values(word, state_->get_int(key)));
    out_->ack(tuple);
  }
};

TEST(StatefulBolts, EveryCountIsKeptWhenTheNumberOfTasksChangesAndTheBoltSaysWhoUsesAKey) {
  const Folder folder;
  expect_counts_to_go_on(make_stateful_bolt<CountOfWord>({.store = folder.url(), .checkpoint = 10ms}), {}, 10ms);
}

/// Counts under one key for all words, although it says that a key is a word.
struct CountOfAll : Count {
  void execute(const Tuple& tuple) override {
    state_->put_int("all", state_->get_int("all") + 1);
    out_->ack(tuple);
  }
};

TEST(StatefulBolts, AKeyThatIsNotTheTuplesFailsItAtOnceAlsoWithOneTask) {
  Counting counting(
      make_stateful_bolt<CountOfAll>({.store = "memory://all", .checkpoint = 10ms, .keys_of_grouping = true}));
  counting.put("a");
  counting.pass(10ms);
  EXPECT_THAT(counting.source->failed(), ElementsAre(1));
  EXPECT_THAT(counting.runtime->snapshot().component("count").last_error,
              AllOf(HasSubstr("the key \"all\" for a tuple of another key"), HasSubstr("state.keys")));
  counting.put("all");
  counting.pass(10ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(2));
}

TEST(StatefulBolts, KeysOfTheGroupingNeedAGroupingByOneField) {
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("count", make_stateful_bolt<Count>({.store = "memory://shuffled", .keys_of_grouping = true}))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("t"), {});
  EXPECT_THAT(problem_of([&] { runtime.start(); }), HasSubstr("not all inputs have the grouping fields"));
}

TEST(StatefulBolts, OtherWordsForKeysAreRefused) {
  EXPECT_THAT(
      problem_of([] {
        const Counting none(make_stateful_bolt<Count>(), {{"state.store", "memory://x"}, {"state.keys", "fields"}});
      }),
      AllOf(HasSubstr("\"fields\""), HasSubstr("write \"grouping\"")));
}

TEST(StatefulBolts, AStopWaitsForTheCheckpointOfWhatIsUnderWay) {
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("count", make_stateful_bolt<Count>({.store = "memory://stop", .checkpoint = 20ms}))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("t"), {});
  runtime.start();
  for (int i = 0; i < 100; ++i) source->put(Values("a"));
  ASSERT_TRUE(eventually([&] { return source->waiting() == 0; }));
  EXPECT_TRUE(runtime.stop(20s));
  EXPECT_EQ(source->acked().size(), 100U);
  EXPECT_EQ(KeyValueState(make_state_store("memory://stop"), {"t", "count", 0, 1}).get_int("a"), 100);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
