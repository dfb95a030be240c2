// Creations that took effect although their answer was lost. A killed ZooKeeper does this rarely; the embedded server
// does it when told to.
#include <future>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::ElementsAre;

class Doubt : public testing::Test {
 protected:
  std::unique_ptr<Registry> client() const { return make_registry({.url = "embedded://doubt"}); }
  void SetUp() override {
    other_->create("/h", "");
    registry_->get("/");
    server_->partition_before_next_answer(session_);
  }
  void wait_until_cut_off() const {
    while (registry_->session() == SessionState::connected) std::this_thread::yield();
  }
  std::vector<std::string> held() const { return other_->children("/h").value(); }

  const std::shared_ptr<embedded::RegistryServer> server_ = embedded::RegistryServer::named("doubt");
  const std::unique_ptr<Registry> registry_ = client();
  const std::int64_t session_ = [this] {
    registry_->get("/");
    return server_->sessions().front();
  }();
  const std::unique_ptr<Registry> other_ = client();
  Seen<std::string> created_;
};

TEST_F(Doubt, ANumberedNodeIsRecognisedAndNotMadeTwice) {
  auto guard = registry_->hold_eventually("/h/n-", "data", true, [&](const auto& path) { created_.add(path); });
  wait_until_cut_off();
  EXPECT_THAT(held(), ElementsAre("n-0000000000"));
  server_->restore(session_);
  ASSERT_TRUE(created_.wait_for_last("/h/n-0000000000"));
  EXPECT_THAT(held(), ElementsAre("n-0000000000"));
  guard.reset();
  EXPECT_TRUE(held().empty());
}

TEST_F(Doubt, APlainNodeIsRecognisedAsOurs) {
  const auto guard =
      registry_->hold_eventually("/h/alive", "data", false, [&](const auto& path) { created_.add(path); });
  wait_until_cut_off();
  server_->restore(session_);
  ASSERT_TRUE(created_.wait_for_last("/h/alive"));
  EXPECT_EQ(other_->get("/h/alive")->owner_session, session_);
}

TEST_F(Doubt, ANodeOfAGuardThatDiedMeanwhileIsRemoved) {
  auto guard = registry_->hold_eventually("/h/n-", "data", true);
  wait_until_cut_off();
  guard.reset();
  EXPECT_EQ(held().size(), 1U);
  Seen<std::string> seen;
  const auto watch = other_->watch_children("/h", [&](const auto& names) { seen.add(text(names)); });
  server_->restore(session_);
  EXPECT_TRUE(seen.wait_for_last(""));
}

TEST_F(Doubt, ACreationSaysThatItsOutcomeIsUnknown) {
  auto call = std::async(std::launch::async, [&] { registry_->create("/h/persistent", "data"); });
  wait_until_cut_off();
  server_->restore(session_);
  try {
    call.get();
    ADD_FAILURE() << "it cannot know";
  } catch (const RegistryError& error) {
    EXPECT_EQ(error.code(), RegistryErrorCode::away);
  }
}

TEST_F(Doubt, ACreationWhoseFenceWentMeanwhileDoesNotSayThatItWasRefused) {
  other_->create("/fence", "");
  auto call = std::async(std::launch::async, [&] { registry_->create("/h/persistent", "data", true, {"/fence"}); });
  wait_until_cut_off();
  other_->remove("/fence");
  server_->restore(session_);
  try {
    call.get();
    ADD_FAILURE() << "it took effect";
  } catch (const RegistryError& error) {
    EXPECT_EQ(error.code(), RegistryErrorCode::away);
  }
  EXPECT_TRUE(other_->get("/h/persistent"));
}

}  // namespace
}  // namespace iotcloud::discovery::tests
