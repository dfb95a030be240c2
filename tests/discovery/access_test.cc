// Access to the nodes that a process created in ZooKeeper: digest authentication.
#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

using Code = RegistryErrorCode;

class Access : public RegistryContract {
 protected:
  std::unique_ptr<Registry> as(const std::string& user, const std::string& password,
                               bool others_may_read = false) const {
    RegistryOptions options;
    options.url = place_->url() + "/guarded";
    options.operation_timeout = patience;
    options.user = user;
    options.password = password;
    options.others_may_read = others_may_read;
    return make_registry(options);
  }
};

TEST_P(Access, AUsersNodesAreForThoseWithItsPassword) {
  const auto owner = as("fleet", "secret: with a colon");
  owner->create("/a/b", "data");
  const auto held = owner->hold("/held", "data");
  const auto friendly = as("fleet", "secret: with a colon");
  EXPECT_EQ(friendly->get("/a/b")->data, "data");
  friendly->set("/a/b", "changed");
  const auto stranger = as("fleet", "guessed");
  const auto nobody = as("", "");
  for (Registry* other : {stranger.get(), nobody.get()}) {
    EXPECT_EQ(code_of([&] { other->get("/a/b"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->set("/a/b", "stolen"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->create("/a/c", ""); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->remove("/a/b"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->get_all({"/a", "/a/b"}); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->children_of_all({"/a"}); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->hold("/a/mine", ""); }), Code::denied);
  }
  EXPECT_EQ(owner->get("/a/b")->data, "changed");
}

TEST_P(Access, OthersMayReadWhenTheOwnerSaysSo) {
  const auto owner = as("fleet", "secret", true);
  owner->create("/a/b", "data");
  const auto nobody = as("", "");
  EXPECT_EQ(nobody->get("/a/b")->data, "data");
  EXPECT_EQ(nobody->children("/a")->size(), 1U);
  EXPECT_EQ(code_of([&] { nobody->set("/a/b", "stolen"); }), Code::denied);
  EXPECT_EQ(code_of([&] { nobody->create("/a/c", ""); }), Code::denied);
}

TEST_P(Access, AUserIsKnownAgainAfterAnExpiredSessionAndALostConnection) {
  const auto owner = as("fleet", "secret");
  Seen<std::string> created;
  const auto held = owner->hold("/held", "", false, [&](const auto& path) { created.add(path); });
  ASSERT_TRUE(created.wait_for_count(1));
  place_->expire(owner->get("/held")->owner_session);
  ASSERT_TRUE(created.wait_for_count(2));
  place_->stop();
  place_->start();
  EXPECT_TRUE(owner->get("/held"));
  EXPECT_EQ(code_of([&] { as("", "")->get("/held"); }), Code::denied);
}

TEST_P(Access, AWatchOfWhatBelongsToOthersWaitsUntilItMayBeRead) {
  const auto owner = as("fleet", "secret");
  owner->create("/shut", "");
  const auto nobody = as("", "");
  Seen<std::string> seen;
  const auto watch = nobody->watch_node("/shut", [&](const auto& node) { seen.add(text(node)); });
  owner->remove("/shut");
  EXPECT_TRUE(seen.wait_for_last("(none)"));
}

INSTANTIATE_TEST_SUITE_P(Registries, Access, testing::Values("zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
