#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/topology/pool/pool_config.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

class PoolConfigTest : public testing::Test {
 protected:
  PoolConfigTest() { std::filesystem::create_directories(folder_); }
  ~PoolConfigTest() override { std::filesystem::remove_all(folder_); }

  PoolConfig load(const std::string& more) const {
    return PoolConfig::load(tests::write_file(
        folder_ / "pool.yaml", "id: p1\nregistry: embedded://x\nstate: " + (folder_ / "state").string() + "\n" + more));
  }
  std::string error_of(const std::string& more) const {
    try {
      load(more);
      return "no error";
    } catch (const config::ConfigError& error) {
      return error.what();
    }
  }
  const std::filesystem::path folder_ =
      std::filesystem::temp_directory_path() / ("iotcloud-pool-config-" + std::to_string(getpid()));
};

TEST_F(PoolConfigTest, TheShippedFileSaysWhatHoldsWithoutIt) {
  const auto shipped = PoolConfig::load(SHIPPED_CONFIG), bare = load("");
  EXPECT_EQ(shipped.pool.record.id, "pool-1");
  EXPECT_EQ(shipped.workers.hang_limit, bare.workers.hang_limit);
  EXPECT_EQ(shipped.workers.call_limit, bare.workers.call_limit);
  EXPECT_EQ(shipped.workers.stop_limit, bare.workers.stop_limit);
  EXPECT_EQ(shipped.workers.limits.spin, bare.workers.limits.spin);
  EXPECT_EQ(shipped.workers.limits.memory_bytes, bare.workers.limits.memory_bytes);
  EXPECT_EQ(shipped.workers.log_limit_mb, bare.workers.log_limit_mb);
  EXPECT_EQ(shipped.workers.confinement.filter_calls, bare.workers.confinement.filter_calls);
  EXPECT_EQ(shipped.workers.confinement.debuggable, bare.workers.confinement.debuggable);
  EXPECT_EQ(shipped.pool.restart.first, bare.pool.restart.first);
  EXPECT_EQ(shipped.pool.restart.longest, bare.pool.restart.longest);
  EXPECT_EQ(shipped.pool.restart.healthy_after, bare.pool.restart.healthy_after);
  EXPECT_EQ(shipped.pool.restart.give_up_after, bare.pool.restart.give_up_after);
  EXPECT_EQ(shipped.upload_limit, bare.upload_limit);
  EXPECT_EQ(shipped.pool.record.most_workers, bare.pool.record.most_workers);
}

TEST_F(PoolConfigTest, IsReadAsItStands) {
  const auto config = load(R"(most_workers: 3
worker_stop_limit: 20s
worker_memory_limit_mb: 100
worker_environment: [SECRET]
worker_files: {read: [/etc/iotcloud], write: []}
worker_restart: {first: 1s, give_up_after: 0}
)");
  EXPECT_EQ(config.pool.record.most_workers, 3);
  EXPECT_EQ(config.pool.stop_limit, 20s);
  EXPECT_EQ(config.workers.stop_limit, 20s);
  EXPECT_EQ(config.workers.limits.memory_bytes, std::uint64_t{100} << 20);
  EXPECT_THAT(config.workers.environment, ElementsAre("SECRET"));
  EXPECT_THAT(config.workers.confinement.files.value().read, ElementsAre("/etc/iotcloud"));
  EXPECT_TRUE(config.workers.confinement.no_new_privileges);
  EXPECT_EQ(config.pool.restart.first, 1s);
  EXPECT_EQ(config.pool.restart.give_up_after, 0);
}

TEST_F(PoolConfigTest, SaysWhatIsWrong) {
  EXPECT_THAT(error_of("worker_hang_limt: 3s"), HasSubstr("did you mean \"worker_hang_limit\"?"));
  EXPECT_THAT(error_of("libraries.require_signature: true"), HasSubstr("libraries.require_signature"));
  EXPECT_THAT(error_of("libraries.require_version: true"),
              AllOf(HasSubstr("libraries.require_version"), HasSubstr("libraries.require_signature: true")));
  EXPECT_THAT(
      error_of(
          "libraries.require_version: true\nlibraries.require_signature: true\nlibraries.trusted_keys: [/nowhere]"),
      HasSubstr("/nowhere"));
  EXPECT_THAT(error_of("thrift: {host: 0.0.0.0, port: 1}"),
              AllOf(HasSubstr("thrift.host"), HasSubstr("TLS and tokens")));
  EXPECT_THAT(error_of("worker_ports: {follower: [1]}"), HasSubstr("all: [5672]"));
  const auto file = tests::write_file(folder_ / "bad.yaml", "id: a/b\nregistry: embedded://x\nstate: s\n");
  EXPECT_THROW(PoolConfig::load(file), config::ConfigError);
}

TEST_F(PoolConfigTest, ItsWorkersMayHaveAUserOfTheirOwn) {
  if (geteuid() == 0) {
    EXPECT_EQ(load("worker_user: nobody").workers.confinement.user, "nobody");
  } else {
    EXPECT_THAT(error_of("worker_user: nobody"),
                AllOf(HasSubstr("only a pool that runs as root"), HasSubstr("worker_starter: /run/iotcloud-worker")));
  }
  const auto config = load("worker_user: nobody\nworker_starter: /run/workers");
  EXPECT_EQ(config.workers.confinement.user, "nobody");
  EXPECT_EQ(config.workers.starter, "/run/workers");
  EXPECT_THAT(error_of("worker_starter: /run/workers"),
              AllOf(HasSubstr("worker_starter"), HasSubstr("worker_user: iotcloud-worker")));
  EXPECT_THAT(error_of("worker_user: root"), AllOf(HasSubstr("worker_user"), HasSubstr("root")));
}

}  // namespace
}  // namespace iotcloud::topology
