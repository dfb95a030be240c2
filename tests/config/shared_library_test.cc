#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/shared_library.h>

namespace iotcloud::config {
namespace {

constexpr SdkMark mark{"toy SDK", "toy-plugin: sdk=", 7};

class SharedLibrary : public testing::Test {
 protected:
  std::string write(const std::string& bytes) const {
    const std::string path = testing::TempDir() + "shared_library_test-" + std::to_string(getpid());
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  static std::string why(const std::string& path, const std::string& reason) {
    return why_not_loaded(path, "toy.so", mark, reason);
  }
};

TEST_F(SharedLibrary, SaysInItsBytesWithWhichSdkItWasBuilt) {
  const std::string zero(1, '\0');
  EXPECT_EQ(marked_sdk_version(write("abc" + zero + "toy-plugin: sdk=12;" + zero), mark), 12U);
  EXPECT_EQ(marked_sdk_version(write("toy-plugin: sdk=" + zero + "toy-plugin: sdk=3;"), mark), 3U)
      << "the text without a number is that of a program that reads such marks";
  for (const std::string bytes : {"", "toy-plugin: sdk=", "toy-plugin: sdk=1", "toy-plugin: sdk=12345678901;"})
    EXPECT_EQ(marked_sdk_version(write(bytes), mark), 0U) << bytes;
  EXPECT_EQ(marked_sdk_version("/nowhere/at-all.so", mark), 0U);
}

TEST_F(SharedLibrary, ASymbolThatIsMissingIsNamedAsInTheSource) {
  EXPECT_EQ(
      why(write("toy-plugin: sdk=6;"), write("toy-plugin: sdk=6;") + ": undefined symbol: _ZN3toy4spinEid"),
      "toy.so cannot be loaded: nothing defines toy::spin(int, double); add the source or the library that does to "
      "what it links, and link it with -Wl,-z,defs to hear of this from the linker; it was built with toy SDK version "
      "6, this program has version 7");
}

TEST_F(SharedLibrary, ASymbolThatALibraryOfItsMissesIsNamedWithThatLibrary) {
  EXPECT_THAT(why("/tmp/toy.so", "/usr/lib/libwheel.so: undefined symbol: turn, version WHEEL_2"),
              testing::AllOf(testing::HasSubstr("nothing defines turn (in /usr/lib/libwheel.so);"),
                             testing::HasSubstr("it does not say with which toy SDK it was built")));
}

TEST_F(SharedLibrary, ThePathOfACopyIsNotShown) {
  EXPECT_THAT(why("/proc/self/fd/7", "/proc/self/fd/7: invalid ELF header"),
              testing::StartsWith("toy.so cannot be loaded: invalid ELF header; "));
  EXPECT_THROW(open_library("/nowhere/at-all.so", "toy.so", mark, 2), Error);
}

}  // namespace
}  // namespace iotcloud::config
