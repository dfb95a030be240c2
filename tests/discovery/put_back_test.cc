// Clients of a server whose state was emptied or put back: it refuses those that have seen a later state, without a
// word.
#include <set>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/discovery/contract_fixture.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::discovery {
namespace {

using iotcloud::tests::eventually;
using tests::Seen;

class PutBack : public testing::Test {
 protected:
  static std::unique_ptr<Registry> client(std::chrono::milliseconds timeout = std::chrono::milliseconds(50),
                                          std::chrono::milliseconds operation_timeout = tests::patience) {
    RegistryOptions options;
    options.url = "embedded://put-back";
    options.session_timeout = timeout;
    options.operation_timeout = operation_timeout;
    return make_registry(options);
  }
  const std::shared_ptr<embedded::RegistryServer> server_ = embedded::RegistryServer::named("put-back");
};

TEST_F(PutBack, AClientOfAnEmptiedServerComesBackWithANewSession) {
  const auto registry = client();
  registry->create("/kept", "data");
  Seen<std::string> created, seen;
  const auto held = registry->hold("/a/held", "mine", false, [&](const auto& path) { created.add(path); });
  const auto watch = registry->watch_node("/kept", [&](const auto& node) { seen.add(node ? node->data : "(none)"); });
  ASSERT_TRUE(created.wait_for_count(1));
  ASSERT_TRUE(seen.wait_for_last("data"));
  server_->put_back(nullptr);
  EXPECT_TRUE(created.wait_for_count(2));
  EXPECT_TRUE(seen.wait_for_last("(none)"));
  EXPECT_EQ(registry->get("/a/held")->data, "mine");
}

TEST_F(PutBack, AClientOfAnEmptiedServerIsBackAfterItsTimeOutAndSaysMeanwhileWhatItWaitsFor) {
  const std::chrono::seconds timeout(6);
  const auto registry = client(timeout, std::chrono::milliseconds(1200));
  registry->create("/kept", "data");
  server_->put_back(nullptr);
  std::set<std::string> said;
  ASSERT_TRUE(eventually([&] {
    try {
      return !registry->get("/kept");
    } catch (const RegistryError& e) {
      said.insert(e.what());
      return false;
    }
  }));
  // Less than one time-out; wiped_registry_test.py measures it.
  EXPECT_THAT(said, testing::Contains(testing::HasSubstr("A new session begins within 5000 ms")));
}

TEST_F(PutBack, AServerThatIsOnlyAwayCostsNoSession) {
  const auto registry = client();
  const auto held = registry->hold("/held", "");
  const auto session = registry->get("/held")->owner_session;
  for (int round = 0; round < 3; ++round) {
    server_->stop();
    // Meanwhile the client asks whether a server takes new sessions: none answers.
    ASSERT_TRUE(eventually([&] { return registry->session() == SessionState::expired; }));
    ASSERT_TRUE(eventually([&] { return server_->is_asked(); }));
    server_->start();
    ASSERT_TRUE(eventually([&] { return registry->session() == SessionState::connected; }));
    EXPECT_EQ(registry->get("/held")->owner_session, session);
  }
}

TEST_F(PutBack, ABackupHasThePersistentNodesOfItsTime) {
  const auto registry = client();
  registry->create("/a/b", "1");
  const auto held = registry->hold("/a/held", "");
  const auto backup = server_->image();
  registry->set("/a/b", "2");
  registry->create("/c", "");
  server_->put_back(backup);
  EXPECT_EQ(registry->get("/a/b")->data, "1");
  EXPECT_FALSE(registry->get("/c"));
  EXPECT_TRUE(eventually([&] { return registry->get("/a/held").has_value(); }));
}

}  // namespace
}  // namespace iotcloud::discovery
