// What every registry does when its server or its session is lost.
#include <future>

#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::IsSupersetOf;
using Code = RegistryErrorCode;

TEST_P(RegistryContract, TellsTheSessionsState) {
  Seen<SessionState> states;
  const auto listener = registry_->on_session([&](SessionState state) { states.add(state); });
  ASSERT_TRUE(states.wait_for_last(SessionState::connected));
  place_->stop();
  ASSERT_TRUE(states.wait([](const auto& all) { return all.back() != SessionState::connected; }));
  place_->start();
  ASSERT_TRUE(states.wait_for_last(SessionState::connected));
  EXPECT_EQ(registry_->session(), SessionState::connected);
}

TEST_P(RegistryContract, AnExpiredSessionsHoldsAndWatchesComeBack) {
  Seen<std::string> created;
  Seen<std::string> watched;
  Seen<std::string> names;
  Seen<SessionState> states;
  const auto on_created = [&](const std::string& path) { created.add(path); };
  const auto plain = registry_->hold("/held/plain", "plain data", false, on_created);
  const auto numbered = registry_->hold("/held/n-", "numbered", true, on_created);
  const auto listener = registry_->on_session([&](SessionState state) { states.add(state); });
  const auto watch = registry_->watch_node("/watched", [&](const auto& node) { watched.add(text(node)); });
  const auto list = registry_->watch_children("/list", [&](const auto& children) { names.add(text(children)); });
  ASSERT_TRUE(created.wait_for_count(2));
  ASSERT_TRUE(watched.wait_for_last("(none)"));
  ASSERT_TRUE(names.wait_for_last("(none)"));

  const std::int64_t before = registry_->get("/held/plain")->owner_session;
  place_->expire(before);

  ASSERT_TRUE(created.wait_for_count(4));
  EXPECT_THAT(states.all(), IsSupersetOf({SessionState::expired, SessionState::connected}));
  EXPECT_EQ(states.all().back(), SessionState::connected);
  const auto paths = created.all();
  EXPECT_EQ(other_->get("/held/plain")->data, "plain data");
  EXPECT_NE(other_->get("/held/plain")->owner_session, before);
  ASSERT_TRUE(other_->children("/held"));
  EXPECT_EQ(other_->children("/held")->size(), 2U);  // the old numbered node is gone
  other_->create("/watched", "after");
  other_->create("/list/entry", "");
  EXPECT_TRUE(watched.wait_for_last("after"));
  EXPECT_TRUE(names.wait_for_last("entry"));
}

TEST_P(RegistryContract, NothingIsLostWhenTheServerIsKilledAndStartedAgain) {
  registry_->create("/kept", "before");
  const auto held = registry_->hold("/held", "data");
  const std::int64_t session = registry_->get("/held")->owner_session;
  Seen<std::string> seen;
  const auto watch = registry_->watch_node("/kept", [&](const auto& node) { seen.add(text(node)); });
  ASSERT_TRUE(seen.wait_for_last("before"));

  place_->stop();
  auto meanwhile = std::async(std::launch::async, [&] { put(*other_, "/kept", "meanwhile"); });
  place_->start();

  meanwhile.get();
  EXPECT_TRUE(seen.wait_for_last("meanwhile"));
  EXPECT_EQ(other_->get("/held")->owner_session, session);
}

TEST_P(RegistryContract, AChangeThatHappenedWhileAwayIsReported) {
  registry_->create("/w", "1");
  Seen<std::string> seen;
  Seen<std::string> names;
  const auto watch = registry_->watch_node("/w", [&](const auto& node) { seen.add(text(node)); });
  const auto list = registry_->watch_children("/gone", [&](const auto& children) { names.add(text(children)); });
  auto leaving = client();
  const auto held = leaving->hold("/gone/soon", "");
  ASSERT_TRUE(seen.wait_for_last("1"));
  ASSERT_TRUE(names.wait_for_last("soon"));
  place_->stop();
  auto change = std::async(std::launch::async, [&] {
    other_->set("/w", "2");
    remove_tree(*other_, "/gone");
  });
  place_->start();
  change.get();
  EXPECT_TRUE(seen.wait_for_last("2"));
  EXPECT_TRUE(names.wait_for_last("(none)"));
}

TEST_P(RegistryContract, WorksWhenTheServerComesLater) {
  place_->stop();
  const auto early = client();
  Seen<std::string> seen;
  Seen<std::string> created;
  const auto watch = early->watch_node("/later", [&](const auto& node) { seen.add(text(node)); });
  const auto held = early->hold_eventually("/early/bird", "", false, [&](const auto& path) { created.add(path); });
  auto call = std::async(std::launch::async, [&] { put(*early, "/later", "at last"); });
  EXPECT_EQ(early->session(), SessionState::connecting);
  place_->start();
  call.get();
  EXPECT_TRUE(seen.wait_for_last("at last"));
  EXPECT_TRUE(created.wait_for_last("/early/bird"));
  EXPECT_EQ(other_->get("/later")->data, "at last");
}

TEST_P(RegistryContract, ACallGivesUpAfterTheOperationTimeOut) {
  RegistryOptions options;
  options.url = place_->url();
  options.operation_timeout = std::chrono::milliseconds(100);
  place_->stop();
  const auto impatient = make_registry(options);
  EXPECT_EQ(code_of([&] { impatient->get("/a"); }), Code::away);
  EXPECT_EQ(code_of([&] { impatient->create("/a", ""); }), Code::away);
  EXPECT_EQ(code_of([&] { impatient->hold("/a", ""); }), Code::away);
  place_->start();
  EXPECT_FALSE(registry_->get("/a"));
}

TEST_P(RegistryContract, AGuardThatDiesWhileAwayLeavesNothingBehind) {
  auto held = registry_->hold("/held", "");
  auto numbered = registry_->hold("/n-", "", true);
  place_->stop();
  held.reset();
  numbered.reset();
  place_->start();
  EXPECT_TRUE(eventually([&] { return other_->children("/")->empty(); }));
}

TEST_P(RegistryContract, CreationsWithoutAnAnswerAreNeitherLostNorDoubled) {
  std::vector<GuardPtr> guards;
  std::vector<std::unique_ptr<Seen<std::string>>> created;
  for (int round = 0; round < 2; ++round) {
    auto harm = std::async(std::launch::async, [&] {
      place_->stop();
      place_->start();
    });
    do {
      created.push_back(std::make_unique<Seen<std::string>>());
      guards.push_back(registry_->hold_eventually(
          "/doubt/n-", "same data", true, [seen = created.back().get()](const auto& path) { seen->add(path); }));
      std::this_thread::yield();
    } while (created.size() < 2000 && harm.wait_for(std::chrono::milliseconds(1)) != std::future_status::ready);
    harm.get();
  }
  std::vector<std::string> reported;
  for (const auto& seen : created) {
    ASSERT_TRUE(seen->wait_for_count(1));
    ASSERT_EQ(seen->all().size(), 1U);
    reported.push_back(seen->all().front().substr(std::string("/doubt/").size()));
  }
  std::sort(reported.begin(), reported.end());
  EXPECT_EQ(other_->children("/doubt").value(), reported);
  guards.clear();
  EXPECT_TRUE(eventually([&] { return other_->children("/doubt")->empty(); }));
}

TEST_P(RegistryContract, ASessionOutOfContactForLongIsNoLongerCertain) {
  const auto short_lived = client(std::chrono::milliseconds(1500));
  Seen<SessionState> states;
  const auto listener = short_lived->on_session([&](SessionState state) { states.add(state); });
  const auto held = short_lived->hold("/held", "");
  ASSERT_TRUE(states.wait_for_last(SessionState::connected));
  place_->stop();
  ASSERT_TRUE(states.wait_for_last(SessionState::expired));
  place_->start();
  ASSERT_TRUE(states.wait_for_last(SessionState::connected));
  EXPECT_TRUE(eventually([&] { return other_->get("/held").has_value(); }));
}

TEST_P(RegistryContract, AServerThatHangsIsNoticedAndEverythingComesBackWhenItGoesOn) {
  const auto short_lived = client(std::chrono::milliseconds(1500));
  Seen<SessionState> states;
  Seen<std::string> seen;
  const auto listener = short_lived->on_session([&](SessionState state) { states.add(state); });
  const auto held = short_lived->hold("/held", "");
  const auto watch = short_lived->watch_node("/w", [&](const auto& node) { seen.add(text(node)); });
  ASSERT_TRUE(states.wait_for_last(SessionState::connected));
  place_->hang();
  ASSERT_TRUE(states.wait_for_last(SessionState::expired));
  auto change = std::async(std::launch::async, [&] { put(*short_lived, "/w", "changed"); });
  place_->go_on();
  change.get();
  EXPECT_TRUE(states.wait_for_last(SessionState::connected));
  EXPECT_TRUE(seen.wait_for_last("changed"));
  EXPECT_TRUE(eventually([&] {
    const auto node = other_->get("/held");
    return node && node->owner_session == session_of(*short_lived);
  }));
}

TEST_P(RegistryContract, ClosingEndsCallsThatWait) {
  auto third = client();
  third->get("/a");
  Seen<std::string> outcome;
  std::promise<void> calling;
  const auto listener = third->on_session([&, raw = third.get()](SessionState state) {
    if (state != SessionState::connecting) return;
    calling.set_value();
    const auto code = code_of([&] { raw->get("/a"); });
    outcome.add(code == Code::closed ? "closed" : "something else");
  });
  place_->stop();
  calling.get_future().wait();
  third.reset();
  EXPECT_THAT(outcome.all(), ElementsAre("closed"));
  place_->start();
}

}  // namespace
}  // namespace iotcloud::discovery::tests
