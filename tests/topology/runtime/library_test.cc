#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/runtime/component_library.h>

namespace iotcloud::topology {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::string error_of(const std::string& path) {
  try {
    ComponentRegistry registry;
    load_components(path, registry);
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

TEST(ComponentLibrary, RegistersItsComponents) {
  ComponentRegistry registry;
  const ComponentLibrary library = load_components(GOOD_LIBRARY, registry);
  EXPECT_THAT(registry.bolt_names(), ElementsAre("good.Echo"));
  ASSERT_NE(registry.bolt("good.Echo"), nullptr);
  EXPECT_NE((*registry.bolt("good.Echo"))(), nullptr);
  EXPECT_EQ(library.path(), GOOD_LIBRARY);
}

TEST(ComponentLibrary, LogsAsItsProcess) {
  static std::vector<std::string> lines;
  lines.clear();
  config::set_log_target([](config::LogLevel level, std::string_view part, std::string_view text) noexcept {
    lines.push_back(std::to_string(static_cast<int>(level)) + " " + std::string(part) + ": " + std::string(text));
  });
  ComponentRegistry registry;
  const ComponentLibrary library = load_components(GOOD_LIBRARY, registry);
  const BoltFactory& echo = *registry.bolt("good.Echo");
  const config::LogLevel before = config::log_level();
  config::set_log_level(config::LogLevel::info);
  static_cast<void>(echo());
  EXPECT_THAT(lines, testing::IsEmpty());
  config::set_log_level(config::LogLevel::debug);
  static_cast<void>(echo());
  EXPECT_THAT(lines, ElementsAre("0 good: an Echo is made"));
  config::set_log_target(nullptr);
  config::set_log_level(before);
}

TEST(ComponentLibrary, CatchesWhatALibraryThrowsWhileItRegisters) {
  EXPECT_THAT(error_of(THROWING_LIBRARY), HasSubstr("failed to register its components: no licence"));
}

TEST(ComponentLibrary, RefusesALibraryOfAnotherSdk) {
  EXPECT_THAT(error_of(OLD_LIBRARY), HasSubstr("was built with topology SDK 0"));
}

TEST(ComponentLibrary, SaysWhyAFileCannotBeLoaded) {
  EXPECT_THAT(error_of("/nowhere/at-all.so"), HasSubstr("the component library /nowhere/at-all.so cannot be loaded: "));
  EXPECT_THAT(error_of("libm.so.6"), HasSubstr("is no component library"));
}

}  // namespace
}  // namespace iotcloud::topology
