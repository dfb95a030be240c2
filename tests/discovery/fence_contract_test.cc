// Writes that depend on a node take effect while it exists, and never afterwards, on every registry.
#include <atomic>
#include <thread>

#include <iotcloud/tests/discovery/contract_fixture.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::ElementsAre;
using Code = RegistryErrorCode;

class FenceContract : public RegistryContract {
 protected:
  const Fence fence_{"/fences/one"};
  GuardPtr standing_ = other_->hold(fence_.path, "");

  void end_fence() {
    standing_.reset();  // asks for its removal; another session's write may come first
    ASSERT_FALSE(other_->get(fence_.path)) << "after what its own session asked for";
  }
};

TEST_P(FenceContract, AWriteTakesEffectWhileItsFenceStands) {
  registry_->create("/a/b", "1", true, fence_);
  EXPECT_EQ(other_->get("/a/b")->data, "1");
  registry_->set("/a/b", "2", 0, fence_);
  EXPECT_EQ(other_->get("/a/b")->data, "2");
  const std::string large(max_node_size, 'x');
  registry_->set("/a/b", large, -1, fence_);
  EXPECT_EQ(other_->get("/a/b")->data, large);
  EXPECT_TRUE(registry_->remove("/a/b", 2, fence_));
  put(*registry_, "/a/c/d", "3", fence_);
  remove_tree(*registry_, "/a", fence_);
  EXPECT_THAT(other_->children("/").value(), ElementsAre("fences"));
}

TEST_P(FenceContract, AWriteThatFailsForAnotherReasonSaysSo) {
  registry_->create("/a/b", "");
  EXPECT_EQ(code_of([&] { registry_->create("/a/b", "", true, fence_); }), Code::exists);
  EXPECT_EQ(code_of([&] { registry_->create("/c/d", "", false, fence_); }), Code::no_node);
  EXPECT_EQ(code_of([&] { registry_->create(fence_.path + "/child", "", true, fence_); }), Code::bad_path);
  EXPECT_EQ(code_of([&] { registry_->set("/none", "", -1, fence_); }), Code::no_node);
  EXPECT_EQ(code_of([&] { registry_->set("/a/b", "", 7, fence_); }), Code::bad_version);
  EXPECT_EQ(code_of([&] { registry_->remove("/a/b", 7, fence_); }), Code::bad_version);
  EXPECT_EQ(code_of([&] { registry_->remove("/a", -1, fence_); }), Code::not_empty);
  EXPECT_FALSE(registry_->remove("/none", -1, fence_));
}

TEST_P(FenceContract, WithoutItsFenceNothingIsWritten) {
  registry_->create("/a", "1");
  end_fence();
  EXPECT_EQ(code_of([&] { registry_->create("/new/node", "", true, fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { registry_->create("/new", "", true, fence_); }), Code::fenced);
  EXPECT_FALSE(other_->get("/new"));
  EXPECT_EQ(code_of([&] { registry_->set("/a", "2", 0, fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { put(*registry_, "/a", "2", fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { registry_->remove("/a", 0, fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { remove_tree(*registry_, "/a", fence_); }), Code::fenced);
  EXPECT_EQ(other_->get("/a")->data, "1");
  EXPECT_EQ(other_->get("/a")->version, 0);
  // The fence is checked before all other errors.
  EXPECT_EQ(code_of([&] { registry_->create("/a", "", true, fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { registry_->set("/none", "", -1, fence_); }), Code::fenced);
  EXPECT_EQ(code_of([&] { registry_->remove("/none", -1, fence_); }), Code::fenced);
}

TEST_P(FenceContract, AFenceGoesWithItsSession) {
  registry_->create("/a", "");
  Seen<std::string> paths;
  const auto numbered = other_->hold("/fences/n-", "", true, [&](const auto& path) { paths.add(path); });
  ASSERT_TRUE(paths.wait_for_count(1));
  const Fence before{paths.all().front()};
  registry_->set("/a", "1", -1, before);
  place_->expire(other_->get(before.path)->owner_session);
  ASSERT_TRUE(paths.wait_for_count(2));  // the next session's
  EXPECT_EQ(code_of([&] { registry_->set("/a", "2", -1, before); }), Code::fenced);
  registry_->set("/a", "3", -1, {paths.all().back()});
  EXPECT_EQ(other_->get("/a")->data, "3");
}

/// Writers do not notice when their fence goes; the registry does.
TEST_P(FenceContract, NoWriteComesAfterTheEndOfItsFence) {
  registry_->create("/w", "");
  std::atomic<int> written{0}, refused{0};
  std::vector<std::jthread> writers;
  for (int writer = 0; writer < 4; ++writer) {
    writers.emplace_back([&, writer](const std::stop_token& stop) {
      const auto registry = client();
      std::optional<Code> code;
      for (int i = 0; !code && !stop.stop_requested(); ++i) {
        const std::string path = "/w/" + std::to_string(writer) + "-" + std::to_string(i);
        code = code_of([&] { registry->create(path, "", false, fence_); });
        ++(code ? refused : written);
      }
      EXPECT_EQ(code, Code::fenced);
    });
  }
  ASSERT_TRUE(eventually([&] { return written > 40; }));
  end_fence();
  registry_->create("/after", "");
  const std::int64_t after = registry_->get("/after")->created;
  EXPECT_TRUE(eventually([&] { return refused == 4; }));
  writers.clear();
  std::vector<std::string> paths;
  const auto names = registry_->children("/w").value();
  for (const auto& name : names) paths.push_back("/w/" + name);
  EXPECT_EQ(paths.size(), static_cast<std::size_t>(written));
  for (const auto& node : registry_->get_all(paths)) EXPECT_LT(node->created, after);
}

INSTANTIATE_TEST_SUITE_P(Registries, FenceContract, testing::Values("embedded", "zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
