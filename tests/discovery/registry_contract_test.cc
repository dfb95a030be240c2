// What every registry does: nodes, versions, errors, watches. Other files cover sessions and elections.
#include <atomic>
#include <future>
#include <thread>

#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using Code = RegistryErrorCode;

TEST_P(RegistryContract, CreatesANodeWithItsMissingParents) {
  registry_->create("/a/b/c", "data");
  EXPECT_EQ(registry_->get("/a/b/c")->data, "data");
  EXPECT_EQ(registry_->get("/a/b")->data, "");
  EXPECT_THAT(registry_->children("/a").value(), ElementsAre("b"));
  EXPECT_THAT(registry_->children("/").value(), ElementsAre("a"));
}

TEST_P(RegistryContract, KeepsDataOfAnyBytesAndSizes) {
  const std::string all_bytes = [] {
    std::string bytes;
    for (int i = 0; i < 256; ++i) bytes += static_cast<char>(i);
    return bytes;
  }();
  registry_->create("/bytes", all_bytes);
  EXPECT_EQ(other_->get("/bytes")->data, all_bytes);
  const std::string large(max_node_size, 'x');
  registry_->set("/bytes", large);
  EXPECT_EQ(other_->get("/bytes")->data, large);
  registry_->set("/bytes", "");
  EXPECT_EQ(other_->get("/bytes")->data, "");
  EXPECT_EQ(code_of([&] { registry_->set("/bytes", large + "x"); }), Code::too_large);
  EXPECT_EQ(code_of([&] { registry_->create("/more", large + "x"); }), Code::too_large);
}

TEST_P(RegistryContract, SaysWhyACreationIsRefused) {
  registry_->create("/there", "1");
  EXPECT_EQ(code_of([&] { registry_->create("/there", "2"); }), Code::exists);
  EXPECT_EQ(registry_->get("/there")->data, "1");
  EXPECT_EQ(code_of([&] { registry_->create("/no/parent", "", false); }), Code::no_node);
  EXPECT_EQ(code_of([&] { registry_->create("/", ""); }), Code::exists);
  const auto held = registry_->hold("/ephemeral", "");
  EXPECT_EQ(code_of([&] { registry_->create("/ephemeral/child", ""); }), Code::bad_path);
  EXPECT_EQ(code_of([&] { registry_->hold("/ephemeral/child", ""); }), Code::bad_path);
  EXPECT_EQ(code_of([&] { registry_->hold("/there", ""); }), Code::exists);
}

TEST_P(RegistryContract, RefusesPathsThatAreNone) {
  for (const std::string& path :
       {std::string(), std::string("a"), std::string("//"), std::string("/a/"), std::string("/a//b"),
        std::string("/a/../b"), std::string("/./a"), std::string("/a\0b", 4), std::string("/a\nb")}) {
    EXPECT_EQ(code_of([&] { registry_->create(path, ""); }), Code::bad_path) << path;
    EXPECT_EQ(code_of([&] { registry_->get(path); }), Code::bad_path) << path;
    EXPECT_EQ(code_of([&] { registry_->watch_node(path, {}); }), Code::bad_path) << path;
    EXPECT_EQ(code_of([&] { registry_->hold_eventually(path, ""); }), Code::bad_path) << path;
  }
  registry_->create("/..a/Größe 1", "");
  EXPECT_TRUE(other_->get("/..a/Größe 1"));
}

TEST_P(RegistryContract, KnowsWhatIsNotThere) {
  EXPECT_FALSE(registry_->get("/none"));
  EXPECT_FALSE(registry_->children("/none"));
  EXPECT_FALSE(registry_->remove("/none"));
  EXPECT_EQ(code_of([&] { registry_->set("/none", ""); }), Code::no_node);
}

TEST_P(RegistryContract, SaysWhenANodesDataWereWritten) {
  registry_->create("/when", "0");
  const auto made = registry_->get("/when")->modified_ms;
  EXPECT_GT(made, 0);
  EXPECT_EQ(other_->get("/when")->modified_ms, made);
  EXPECT_TRUE(iotcloud::tests::eventually([&] {  // the clock may not have moved yet
    registry_->set("/when", "1");
    return other_->get("/when")->modified_ms > made;
  }));
}

TEST_P(RegistryContract, CountsVersionsAndRefusesOldOnes) {
  registry_->create("/v", "0");
  EXPECT_EQ(registry_->get("/v")->version, 0);
  registry_->set("/v", "1", 0);
  EXPECT_EQ(registry_->get("/v")->version, 1);
  EXPECT_EQ(code_of([&] { registry_->set("/v", "2", 0); }), Code::bad_version);
  EXPECT_EQ(code_of([&] { registry_->remove("/v", 0); }), Code::bad_version);
  EXPECT_EQ(registry_->get("/v")->data, "1");
  EXPECT_TRUE(registry_->remove("/v", 1));
  EXPECT_FALSE(registry_->get("/v"));
}

TEST_P(RegistryContract, TellsTheOrderOfCreation) {
  registry_->create("/first", "");
  other_->create("/second", "");
  registry_->set("/first", "changed");
  EXPECT_LT(registry_->get("/first")->created, registry_->get("/second")->created);
}

TEST_P(RegistryContract, RemovesOnlyWhatHasNoChildren) {
  registry_->create("/p/c", "");
  EXPECT_EQ(code_of([&] { registry_->remove("/p"); }), Code::not_empty);
  EXPECT_EQ(code_of([&] { registry_->remove("/"); }), Code::bad_path);
  EXPECT_TRUE(registry_->remove("/p/c"));
  EXPECT_TRUE(registry_->remove("/p"));
}

TEST_P(RegistryContract, ListsChildrenSorted) {
  for (const char* name : {"m", "a", "z", "b"}) registry_->create(std::string("/list/") + name, "");
  EXPECT_THAT(other_->children("/list").value(), ElementsAre("a", "b", "m", "z"));
  EXPECT_THAT(other_->children("/list/a").value(), IsEmpty());
}

TEST_P(RegistryContract, ReadsThousandsOfNodesAtOnceInTheOrderAsked) {
  constexpr int count = 1200;  // several batches
  std::vector<std::string> paths;
  for (int i = 0; i < count; ++i) {
    paths.push_back("/many/n" + std::to_string(i));
    if (i % 3 != 0) registry_->create(paths.back(), std::to_string(i));
  }
  const auto nodes = other_->get_all(paths);
  const auto lists = other_->children_of_all(paths);
  ASSERT_EQ(nodes.size(), paths.size());
  ASSERT_EQ(lists.size(), paths.size());
  for (std::size_t i = 0; i < count; ++i) {
    ASSERT_EQ(text(nodes[i]), i % 3 != 0 ? std::to_string(i) : "(none)");
    ASSERT_EQ(text(lists[i]), i % 3 != 0 ? "" : "(none)");
  }
  EXPECT_TRUE(other_->get_all({}).empty());
  EXPECT_EQ(text(other_->children_of_all({"/many"}).front()), text(other_->children("/many")));
  EXPECT_EQ(code_of([&] { other_->get_all({"/many", "none"}); }), Code::bad_path);
}

TEST_P(RegistryContract, PutsAndRemovesWholeTrees) {
  put(*registry_, "/t/a/b", "1");
  put(*registry_, "/t/a/b", "2");
  put(*registry_, "/t/c", "3");
  EXPECT_EQ(other_->get("/t/a/b")->data, "2");
  remove_tree(*other_, "/t");
  EXPECT_FALSE(registry_->get("/t"));
  remove_tree(*other_, "/t");
}

TEST_P(RegistryContract, TwoClientsThatPutTheSameNodeBothSucceed) {
  std::thread rival([&] {
    for (int i = 0; i < 20; ++i) put(*other_, "/race/" + std::to_string(i), "other");
  });
  for (int i = 0; i < 20; ++i) put(*registry_, "/race/" + std::to_string(i), "mine");
  rival.join();
  EXPECT_EQ(registry_->children("/race")->size(), 20U);
}

TEST_P(RegistryContract, AHeldNodeLivesAsLongAsItsGuard) {
  auto guard = registry_->hold("/deep/held", "data");
  const auto node = other_->get("/deep/held");
  ASSERT_TRUE(node);
  EXPECT_EQ(node->data, "data");
  EXPECT_TRUE(node->ephemeral);
  EXPECT_NE(node->owner_session, 0);
  EXPECT_FALSE(registry_->get("/deep")->ephemeral);
  guard.reset();
  EXPECT_FALSE(registry_->get("/deep/held"));
}

TEST_P(RegistryContract, AHeldNodeGoesWithItsClient) {
  auto third = client();
  GuardPtr guard = third->hold("/held", "data");
  ASSERT_TRUE(other_->get("/held"));
  guard.reset();
  guard = third->hold("/held", "again");
  Seen<std::string> seen;
  const auto watch = other_->watch_node("/held", [&](const auto& node) { seen.add(text(node)); });
  ASSERT_TRUE(seen.wait_for_last("again"));
  third.reset();
  EXPECT_TRUE(seen.wait_for_last("(none)"));
}

TEST_P(RegistryContract, SequentialNodesGetNumbersThatGrow) {
  Seen<std::string> created;
  std::vector<GuardPtr> guards;
  for (int i = 0; i < 12; ++i) {
    guards.push_back((i % 2 == 0 ? registry_ : other_)->hold("/queue/n-", "", true, [&](const std::string& path) {
      created.add(path);
    }));
    ASSERT_TRUE(created.wait_for_count(static_cast<std::size_t>(i) + 1));
  }
  const auto paths = created.all();
  for (std::size_t i = 0; i < paths.size(); ++i) {
    EXPECT_EQ(paths[i].size(), std::string("/queue/n-").size() + 10);
    EXPECT_TRUE(i == 0 || paths[i - 1] < paths[i]);
  }
}

TEST_P(RegistryContract, HoldEventuallyWaitsForItsPlace) {
  auto first = registry_->hold("/alive", "first");
  Seen<std::string> created;
  const auto second =
      other_->hold_eventually("/alive", "second", false, [&](const std::string& path) { created.add(path); });
  EXPECT_EQ(registry_->get("/alive")->data, "first");
  first.reset();
  EXPECT_TRUE(created.wait_for_last("/alive"));
  EXPECT_EQ(registry_->get("/alive")->data, "second");
}

TEST_P(RegistryContract, AWatchReportsTheStateAndEachChange) {
  registry_->create("/w", "1");
  Seen<std::string> seen;
  const auto watch = other_->watch_node("/w", [&](const auto& node) { seen.add(text(node)); });
  ASSERT_TRUE(seen.wait_for_last("1"));
  registry_->set("/w", "2");
  ASSERT_TRUE(seen.wait_for_last("2"));
  registry_->remove("/w");
  ASSERT_TRUE(seen.wait_for_last("(none)"));
  registry_->create("/w", "3");
  EXPECT_TRUE(seen.wait_for_last("3"));
  EXPECT_THAT(seen.all(), ElementsAre("1", "2", "(none)", "3"));
}

TEST_P(RegistryContract, AWatchWaitsForANodeThatIsNotThereYet) {
  Seen<std::string> nodes;
  Seen<std::string> names;
  const auto watch = other_->watch_node("/not/yet", [&](const auto& node) { nodes.add(text(node)); });
  const auto list = other_->watch_children("/not", [&](const auto& children) { names.add(text(children)); });
  ASSERT_TRUE(nodes.wait_for_last("(none)"));
  ASSERT_TRUE(names.wait_for_last("(none)"));
  registry_->create("/not/yet", "now");
  EXPECT_TRUE(nodes.wait_for_last("now"));
  EXPECT_TRUE(names.wait_for_last("yet"));
  remove_tree(*registry_, "/not");
  EXPECT_TRUE(names.wait_for_last("(none)"));
}

TEST_P(RegistryContract, AWatchOfChildrenReportsTheirNamesSorted) {
  Seen<std::string> seen;
  registry_->create("/c/b", "");
  const auto watch = other_->watch_children("/c", [&](const auto& names) { seen.add(text(names)); });
  ASSERT_TRUE(seen.wait_for_last("b"));
  registry_->create("/c/a", "");
  ASSERT_TRUE(seen.wait_for_last("a b"));
  registry_->set("/c/a", "data is none of its business");
  const auto held = registry_->hold("/c/held", "");
  ASSERT_TRUE(seen.wait_for_last("a b held"));
  EXPECT_THAT(seen.all(), ElementsAre("b", "a b", "a b held"));
}

TEST_P(RegistryContract, FastChangesAreSeenAsFewAndTheLastIsNeverMissed) {
  registry_->create("/fast", "start");
  Seen<std::string> seen;
  const auto watch = other_->watch_node("/fast", [&](const auto& node) { seen.add(text(node)); });
  for (int i = 0; i < 300; ++i) registry_->set("/fast", std::to_string(i));
  ASSERT_TRUE(seen.wait_for_last("299"));
  const auto values = seen.all();
  EXPECT_LT(values.size(), 301U);
  int before = -1;  // never backwards, never twice
  for (std::size_t i = values.front() == "start" ? 1 : 0; i < values.size(); ++i) {
    EXPECT_LT(before, std::stoi(values[i]));
    before = std::stoi(values[i]);
  }
}

TEST_P(RegistryContract, SeveralWatchesOfOneNodeAllReport) {
  Seen<std::string> first;
  Seen<std::string> second;
  auto watch = registry_->watch_node("/shared", [&](const auto& node) { first.add(text(node)); });
  const auto list = registry_->watch_children("/shared", [&](const auto& names) { second.add(text(names)); });
  const auto again = registry_->watch_node("/shared", [&](const auto& node) { second.add(text(node)); });
  ASSERT_TRUE(first.wait_for_last("(none)"));
  ASSERT_TRUE(second.wait_for_count(2));
  other_->create("/shared", "here");
  ASSERT_TRUE(first.wait_for_last("here"));
  ASSERT_TRUE(second.wait_for_count(4));
  watch.reset();
  other_->set("/shared", "on");
  EXPECT_TRUE(second.wait_for_last("on"));
  EXPECT_EQ(first.all().back(), "here");
}

TEST_P(RegistryContract, CallbacksMayCallTheRegistry) {
  Seen<std::string> seen;
  const auto watch = registry_->watch_children("/in", [&](const auto& names) {
    if (!names) return;
    for (const std::string& name : *names) {
      put(*registry_, "/out/" + name, registry_->get("/in/" + name)->data);
      const auto held = registry_->hold("/held-by-callback", "");
      seen.add(registry_->get("/out/" + name)->data + (registry_->get("/held-by-callback") ? " held" : ""));
    }
  });
  other_->create("/in/a", "data");
  EXPECT_TRUE(seen.wait_for_last("data held"));
  EXPECT_EQ(other_->get("/out/a")->data, "data");
}

TEST_P(RegistryContract, AGuardMayDieInItsOwnCallback) {
  Seen<std::string> seen;
  GuardPtr watch;
  std::mutex mutex;
  std::unique_lock lock(mutex);
  watch = registry_->watch_node("/once", [&](const auto& node) {
    const std::lock_guard wait_for_assignment(mutex);
    seen.add(text(node));
    watch.reset();
  });
  lock.unlock();
  ASSERT_TRUE(seen.wait_for_last("(none)"));
  Seen<std::string> control;
  const auto other_watch = registry_->watch_node("/once", [&](const auto& node) { control.add(text(node)); });
  other_->create("/once", "more");
  ASSERT_TRUE(control.wait_for_last("more"));
  EXPECT_THAT(seen.all(), ElementsAre("(none)"));
}

TEST_P(RegistryContract, AGuardsEndWaitsForTheCallbackThatRuns) {
  std::promise<void> entered;
  std::promise<void> leave;
  std::atomic<bool> left{false};
  auto watch = registry_->watch_node("/slow", [&](const auto&) {
    entered.set_value();
    leave.get_future().wait();
    left = true;
  });
  entered.get_future().wait();
  std::thread releaser([&] { leave.set_value(); });
  watch.reset();
  EXPECT_TRUE(left);
  releaser.join();
}

TEST_P(RegistryContract, ACallbackThatThrowsHarmsNobodyElse) {
  Seen<std::string> seen;
  const auto bad = registry_->watch_node("/x", [](const auto&) { throw std::runtime_error("from a callback"); });
  const auto good = registry_->watch_node("/x", [&](const auto& node) { seen.add(text(node)); });
  ASSERT_TRUE(seen.wait_for_last("(none)"));
  other_->create("/x", "1");
  EXPECT_TRUE(seen.wait_for_last("1"));
}

INSTANTIATE_TEST_SUITE_P(Registries, RegistryContract, testing::Values("embedded", "zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
