#include <filesystem>
#include <fstream>
#include <iterator>

#include <gmock/gmock.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/child_process.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::processes {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;
namespace fs = std::filesystem;

class ChildProcessTest : public ::testing::Test {
 protected:
  ChildProcessTest() {
    std::string pattern = fs::temp_directory_path() / "iotcloud-child-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    log_ = folder_ / "child.log";
  }
  ~ChildProcessTest() override { fs::remove_all(folder_); }
  ChildProcess start(const std::string& script) const { return {spawn({"/bin/sh", "-c", script}, log_), true}; }

  fs::path folder_;
  std::string log_;
};

TEST_F(ChildProcessTest, WritesToTheEndOfItsLogAndItsStatusIsKnown) {
  std::ofstream(log_) << "before\n";
  const auto child = start("echo out; echo err >&2; exit 3");
  ASSERT_TRUE(child.wait(tests::patience));
  EXPECT_EQ(child.how_it_ended(), "exited with status 3");
  EXPECT_EQ(tests::read_file(log_), "before\nout\nerr\n");
}

TEST_F(ChildProcessTest, GoesOnUntilItIsKilled) {
  const auto child = start("echo up; exec sleep 600");
  EXPECT_FALSE(child.wait(10ms));
  child.kill();
  ASSERT_TRUE(child.wait(tests::patience));
  EXPECT_THAT(child.how_it_ended(), HasSubstr("crashed (signal 9"));
  child.kill();  // nothing more happens
}

TEST_F(ChildProcessTest, IsKnownByAnArgumentThatOnlyItWasGiven) {
  // The shell stops itself: it would give its process, arguments and all, to another program that it runs last.
  const ChildProcess child(spawn({"/bin/sh", "-c", "kill -STOP $$", "abc.sock"}, log_), true);
  // spawn() may return before the kernel has written the arguments of the new program.
  EXPECT_TRUE(tests::eventually([&] { return has_argument(child.id(), "abc.sock") == true; }));
  EXPECT_EQ(has_argument(child.id(), "abc.soc"), false);
  EXPECT_EQ(has_argument(getpid(), "abc.sock"), false);
  child.kill();
  ASSERT_TRUE(child.wait(tests::patience));
  EXPECT_EQ(has_argument(child.id(), "abc.sock"), false) << "it has ended";
  EXPECT_THAT(child.how_it_ended(), HasSubstr("signal 9"));
  EXPECT_EQ(has_argument(child.id(), "abc.sock"), false) << "there is no such process";
}

TEST_F(ChildProcessTest, WhoseCommandLineCannotBeReadIsNotTakenForAnother) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit none = before;
  none.rlim_cur = 0;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  const auto known = has_argument(getpid(), "abc.sock");
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_EQ(known, std::nullopt);
}

TEST_F(ChildProcessTest, InheritsNoDescriptorAndNoBlockedSignal) {
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  sigset_t blocked;
  sigset_t before;
  sigemptyset(&blocked);
  sigaddset(&blocked, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &blocked, &before);
  const std::string both = std::to_string(pipe_ends[0]) + " " + std::to_string(pipe_ends[1]);
  const auto child =
      start("for fd in " + both + "; do [ -e /proc/$$/fd/$fd ] && echo $fd; done; kill -TERM $$; exit 0");
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
  ASSERT_TRUE(child.wait(tests::patience));
  EXPECT_THAT(child.how_it_ended(), HasSubstr("crashed (signal 15"));
  EXPECT_EQ(tests::read_file(log_), "");
}

TEST_F(ChildProcessTest, OneOfAnEarlierLifeCanBeEndedButNotAskedHow) {
  const int process = spawn({"/bin/sh", "-c", "exec sleep 600"}, log_);
  const ChildProcess adopted(process, false);
  adopted.kill();
  EXPECT_TRUE(adopted.wait(tests::patience));
  EXPECT_EQ(adopted.how_it_ended(), "died");
  EXPECT_THAT(ChildProcess(process, true).how_it_ended(), HasSubstr("signal 9"));
}

TEST_F(ChildProcessTest, AProgramThatIsNotThereIsNamed) {
  try {
    spawn({"/nowhere/program"}, log_);
    FAIL() << "it was started";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), HasSubstr("/nowhere/program cannot be started"));
  }
}

}  // namespace
}  // namespace iotcloud::processes
