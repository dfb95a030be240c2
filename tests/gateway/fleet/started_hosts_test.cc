// Driver hosts that systemd starts under another account.
#include <atomic>
#include <functional>
#include <string>

#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>
#include <iotcloud/tests/processes/systemd_stand_in.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

/// systemd with the units for driver hosts.
struct Systemd : processes::SystemdStandIn {
  Systemd(const fs::path& folder, std::string user)
      : SystemdStandIn(folder, std::move(user), HOST_PROGRAM, "--for-gateway") {}
};

class StartedHosts : public ProcessTest {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "only root can start processes of another user";
    fs::copy(fs::path(TEST_PLUGINS) / "confined.so", plugins_ / "confined.so");
    chmod(folder_.c_str(), 0711);  // to the state folder and the plugins
    confinement_.user = "nobody";
    starter_ = folder_ / "starter";
  }
  void TearDown() override { gateway_.reset(); }

  std::string user_of(int process) const {
    struct stat status {};
    return stat(("/proc/" + std::to_string(process)).c_str(), &status) == 0 ? std::to_string(status.st_uid) : "none";
  }
  /// Starts a host by itself. \return how it ended.
  HostEnd end_of(const std::string& plugin, const std::function<void(int)>& end) {
    std::atomic<bool> ended{false};
    HostEnd how;
    const auto link = new_launcher()->launch({plugin, "gw"_gateway, false}, {[](const auto&) {},
                                                                             [&](const HostEnd& e) {
                                                                               how = e;
                                                                               ended = true;
                                                                             }});
    int process = 0;
    EXPECT_TRUE(eventually([&] {
      process = host_process();
      return ended || process != 0;
    }));
    if (process != 0) end(process);  // 0: it has ended, and would mean this process group
    EXPECT_TRUE(eventually([&] { return ended.load(); }));
    return how;
  }
  const processes::Account nobody_ = processes::find_account("nobody");
};

TEST_F(StartedHosts, AreOfTheOtherUserAndServeTheirGateway) {
  const Systemd systemd(folder_, "nobody");
  start_gateway();
  give(quiet("a", "confined.so", {{"forbidden_file", state_ / "id"}, {"victim", std::to_string(getpid())}}));
  ASSERT_TRUE(comes_to("a", DriverState::active, "confined"));
  ASSERT_TRUE(eventually([&] { return record("a", "confined")->metadata.contains("user"); }));
  auto found = record("a", "confined")->metadata;
  EXPECT_EQ(found["user"], std::to_string(nobody_.user));
  EXPECT_EQ(found["forbidden_file"], "EACCES");
  EXPECT_EQ(found["signal_to_victim"], "EPERM");
  const int process = host_process();
  EXPECT_EQ(user_of(process), found["user"]);
  take_back("a");
  EXPECT_TRUE(has_ended(process));
  EXPECT_TRUE(eventually([&] { return sockets().empty(); }));
}

TEST_F(StartedHosts, SayHowTheyEnd) {
  const Systemd systemd(folder_, "nobody");
  const auto how = end_of("probe.so", [](int process) { kill(process, SIGKILL); });
  EXPECT_EQ(how.how, HostEnd::How::crashed);
  EXPECT_THAT(how.reason, HasSubstr("crashed (signal 9"));
}

TEST_F(StartedHosts, ThatHangAreEndedByTheirOwnUser) {
  hang_limit_ = std::chrono::seconds{4};  // in which a busy machine starts it
  const Systemd systemd(folder_, "nobody");
  const auto how = end_of("probe.so", [](int process) { kill(process, SIGSTOP); });
  EXPECT_THAT(how.reason, HasSubstr("hung"));
}

TEST_F(StartedHosts, AreEndedWithTheRightsOfTheirUserOnly) {
  const Systemd systemd(folder_, "nobody");
  const auto starter = std::make_shared<const processes::ProcessStarter>(starter_, "iotcloud-host");
  const processes::OwnedDescriptor log(open("/dev/null", O_WRONLY | O_CLOEXEC));
  auto started = starter->start({"", "--check", "/nowhere.so"}, {}, log, log);
  const processes::ChildProcess checked(std::move(started), starter);
  EXPECT_TRUE(checked.wait(tests::patience));
  EXPECT_EQ(checked.how_it_ended(), "exited with status 1");
  const processes::OwnedDescriptor of_root(static_cast<int>(syscall(SYS_pidfd_open, getpid(), 0)));
  EXPECT_FALSE(starter->kill(of_root.get())) << "a process of root, such as this one";
}

TEST_F(StartedHosts, OfAnotherUserThanTheConfigurationSaysAreEnded) {
  const Systemd systemd(folder_, "daemon");
  const auto how = end_of("probe.so", [](int) {});
  EXPECT_EQ(how.how, HostEnd::How::refused);
  EXPECT_THAT(how.reason, HasSubstr("another user than host_user says"));
}

TEST_F(StartedHosts, WithoutTheSocketTheGatewayDoesNotStart) {
  EXPECT_THROW(new_launcher(), config::Error);
}

}  // namespace
}  // namespace iotcloud::gateway
