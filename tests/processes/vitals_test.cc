#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>

#include <gmock/gmock.h>
#include <stdlib.h>
#include <unistd.h>

#include <iotcloud/processes/vitals.h>

namespace iotcloud::processes {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using namespace std::chrono_literals;
namespace fs = std::filesystem;

/// A process as /proc shows it, played by the test.
class VitalsTest : public ::testing::Test {
 protected:
  VitalsTest() {
    std::string pattern = fs::temp_directory_path() / "iotcloud-vitals-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    fs::create_directories(folder_ / "task/7");
    std::ofstream(folder_ / "statm") << "1000 100 50 1 0 1 0";
    std::ofstream(folder_ / "task/7/comm") << "camera\n";
    vitals_ = std::make_unique<Vitals>(folder_, VitalLimits{0, 3s});
  }
  ~VitalsTest() override { fs::remove_all(folder_); }

  /// Time passes, of which the thread runs, or waits for a processor, for so long.
  std::string pass(std::chrono::milliseconds time, std::chrono::milliseconds running,
                   std::chrono::milliseconds waiting) {
    now_ += time;
    running_ += running;
    waiting_ += waiting;
    std::ofstream(folder_ / "task/7/schedstat") << running_.count() << ' ' << waiting_.count() << " 12";
    return vitals_->examine(now_);
  }

  fs::path folder_;
  Vitals::Instant now_{};
  std::chrono::nanoseconds running_{5s}, waiting_{1s};
  std::unique_ptr<Vitals> vitals_;
};

TEST_F(VitalsTest, AThreadThatNeverSleepsIsNamed) {
  EXPECT_THAT(pass(0s, 0s, 0s), IsEmpty());
  EXPECT_THAT(pass(1s, 1s, 0s), IsEmpty());
  EXPECT_THAT(pass(1s, 990ms, 0s), IsEmpty());
  EXPECT_THAT(pass(1s, 1s, 0s), HasSubstr("its thread camera has not slept for 3000 ms"));
}

TEST_F(VitalsTest, AThreadThatSpinsOnAMachineThatOthersUseTooIsNamed) {
  EXPECT_THAT(pass(0s, 0s, 0s), IsEmpty());
  EXPECT_THAT(pass(1s, 600ms, 400ms), IsEmpty());
  EXPECT_THAT(pass(2s, 1000ms, 950ms), HasSubstr("its thread camera"));
}

TEST_F(VitalsTest, AThreadThatMostlyWaitsForAProcessorIsNotAccused) {
  EXPECT_THAT(pass(0s, 0s, 0s), IsEmpty());
  EXPECT_THAT(pass(2s, 100ms, 1900ms), IsEmpty());
  EXPECT_THAT(pass(2s, 100ms, 1900ms), IsEmpty());
  EXPECT_THAT(pass(2s, 1400ms, 600ms), HasSubstr("its thread camera"));  // until it has run for half of the limit
}

TEST_F(VitalsTest, AThreadThatSleepsNowAndThenIsWellHoweverHardItWorks) {
  EXPECT_THAT(pass(0s, 0s, 0s), IsEmpty());
  for (int second = 0; second < 100; ++second) EXPECT_THAT(pass(1s, 800ms, 0s), IsEmpty());
}

TEST_F(VitalsTest, AThreadThatSpunForAWhileAndSleptAgainIsWell) {
  EXPECT_THAT(pass(0s, 0s, 0s), IsEmpty());
  for (int round = 0; round < 10; ++round) {
    EXPECT_THAT(pass(2s, 2s, 0s), IsEmpty());
    EXPECT_THAT(pass(1s, 0s, 0s), IsEmpty());
  }
}

TEST_F(VitalsTest, WithoutALimitItMaySpin) {
  vitals_ = std::make_unique<Vitals>(folder_, VitalLimits{0, 0s});
  for (int round = 0; round < 3; ++round) EXPECT_THAT(pass(100s, 100s, 0s), IsEmpty());
}

TEST_F(VitalsTest, MoreMemoryThanTheLimitIsTold) {
  const auto page = static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  vitals_ = std::make_unique<Vitals>(folder_, VitalLimits{100 * page, 0s});
  EXPECT_THAT(vitals_->examine(now_), IsEmpty());
  EXPECT_EQ(vitals_->memory_bytes(), 100 * page);
  std::ofstream(folder_ / "statm") << "9000 101 50 1 0 1 0";
  EXPECT_THAT(vitals_->examine(now_), HasSubstr("MiB of memory, more than its limit of"));
}

TEST_F(VitalsTest, AProcessThatIsGoneIsNobodysExcess) {
  vitals_ = std::make_unique<Vitals>(folder_ / "gone", VitalLimits{1, 1ms});
  EXPECT_THAT(vitals_->examine(now_), IsEmpty());
}

TEST(Vitals, OfThisProcessAreRead) {
  Vitals own("/proc/self", VitalLimits{1, 0s});
  EXPECT_THAT(own.examine({}), HasSubstr("MiB of memory"));
  EXPECT_GT(own.memory_bytes(), 1u << 20);
}

}  // namespace
}  // namespace iotcloud::processes
