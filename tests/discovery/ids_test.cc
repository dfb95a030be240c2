#include <concepts>
#include <map>
#include <sstream>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <unordered_map>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// Text becomes an id only where that is written out, and an id never becomes another kind of id.
static_assert(!std::is_convertible_v<std::string, GatewayId>);
static_assert(!std::is_convertible_v<const char*, GatewayId>);
static_assert(!std::is_assignable_v<GatewayId&, std::string>);
static_assert(!std::is_constructible_v<InstanceId, GatewayId>);
static_assert(!std::is_assignable_v<InstanceId&, GatewayId>);
static_assert(std::is_constructible_v<GatewayId, std::string_view>);
static_assert(std::is_convertible_v<const GatewayId&, const std::string&>);

template <typename Left, typename Right>
concept Comparable = requires(const Left& left, const Right& right) {
  left == right;
  left < right;
};
static_assert(Comparable<GatewayId, GatewayId>);
static_assert(Comparable<GatewayId, std::string>);
static_assert(!Comparable<GatewayId, InstanceId>);

// Arguments that are swapped do not compile.
template <typename... Arguments>
concept AnOrdersPlace = requires(const Paths& paths, const Arguments&... arguments) {
  paths.order(arguments...);
};
static_assert(AnOrdersPlace<GatewayId, InstanceId>);
static_assert(!AnOrdersPlace<InstanceId, GatewayId>);
static_assert(!AnOrdersPlace<std::string, std::string>);
template <typename... Arguments>
concept AChannelsPlace = requires(const Paths& paths, const Arguments&... arguments) {
  paths.channel(arguments...);
};
static_assert(AChannelsPlace<DriverName, InstanceId, std::string>);
static_assert(!AChannelsPlace<InstanceId, DriverName, std::string>);
static_assert(!AChannelsPlace<std::string, InstanceId, DriverName>);
static_assert(std::is_invocable_v<decltype(list_workers), Registry&, const Paths&, const TopologyName&>);
static_assert(!std::is_invocable_v<decltype(list_workers), Registry&, const Paths&, const GatewayId&>);

TEST(Ids, AreComparedWithTheirKindAndWithText) {
  EXPECT_EQ("lab1"_gateway, "lab1"_gateway);
  EXPECT_NE("lab1"_gateway, "lab2"_gateway);
  EXPECT_LT("lab1"_gateway, "lab2"_gateway);
  EXPECT_EQ("lab1"_gateway, "lab1");
  EXPECT_EQ(std::string("lab1"), "lab1"_gateway);
  EXPECT_LT("lab1"_gateway, std::string("lab2"));
  EXPECT_GT("lab2", "lab1"_gateway);
  EXPECT_TRUE(GatewayId().empty());
  EXPECT_FALSE("lab1"_gateway.empty());
}

TEST(Ids, KeepBytesThatAreNoText) {
  const std::string bytes("a\0\xff", 3);
  EXPECT_EQ(InstanceId(bytes).str(), bytes);
  EXPECT_EQ(InstanceId(std::string_view(bytes)), InstanceId(bytes));
}

TEST(Ids, AreKeysThatTextFinds) {
  std::map<InstanceId, int, std::less<>> sorted{{"b"_instance, 2}, {"a"_instance, 1}};
  EXPECT_EQ(sorted.begin()->first, "a");
  EXPECT_EQ(sorted.at("b"_instance), 2);
  EXPECT_EQ(sorted.find(std::string("b"))->second, 2);
  EXPECT_FALSE(sorted.contains("c"));
  std::unordered_map<InstanceId, int, std::hash<InstanceId>, std::equal_to<>> hashed{{"b"_instance, 2}};
  EXPECT_EQ(hashed.at("b"_instance), 2);
  EXPECT_EQ(hashed.find(std::string_view("b"))->second, 2);
  EXPECT_FALSE(hashed.contains("c"_instance));
  EXPECT_EQ(std::hash<InstanceId>()("b"_instance), std::hash<InstanceId>()("b"));
}

TEST(Ids, AreWrittenAsTheirText) {
  EXPECT_EQ(fmt::format("{} on {}", "0a1b"_instance, "lab1"_gateway), "0a1b on lab1");
  std::ostringstream out;
  out << "turtle"_driver;
  EXPECT_EQ(out.str(), "turtle");
  EXPECT_EQ("topology " + "echo"_topology + "/workers", "topology echo/workers");
}

/// As it was before its texts were ids.
struct Plain {
  std::string gateway;
  std::vector<std::string> instances;
  std::map<std::string, std::string> silent;
  static constexpr const char* what = "a test";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(gateway, required), IOTCLOUD_FIELD(instances, usual), IOTCLOUD_FIELD(silent, usual)};
};
struct Typed {
  GatewayId gateway;
  std::vector<InstanceId> instances;
  std::map<GatewayId, std::string> silent;
  static constexpr const char* what = "a test";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(gateway, required), IOTCLOUD_FIELD(instances, usual), IOTCLOUD_FIELD(silent, usual)};
};
/// As Thrift generates it.
struct Wire {
  std::string gateway;
  std::vector<std::string> instances;
  std::map<std::string, std::string> silent;
};

Plain plain() {
  return {"lab1", {"b", "a"}, {{"lab2", "it is lost"}, {"lab3", ""}}};
}
Typed typed() {
  return {"lab1"_gateway, {"b"_instance, "a"_instance}, {{"lab2"_gateway, "it is lost"}, {"lab3"_gateway, ""}}};
}

TEST(Ids, StandInJsonAsTextDoes) {
  EXPECT_EQ(to_text(to_json<nlohmann::json>(typed())), to_text(to_json<nlohmann::json>(plain())));
  const auto read = from_text<Typed>(to_text(to_json<nlohmann::json>(plain())), "/x");
  EXPECT_EQ(read.gateway, "lab1");
  EXPECT_THAT(read.instances, ElementsAre("b", "a"));
  EXPECT_EQ(read.silent, typed().silent);
}

TEST(Ids, AreRefusedInJsonAsTextIs) {
  const auto refusal = [](const auto& value, const std::string& json) -> std::string {
    try {
      from_text<std::remove_cvref_t<decltype(value)>>(json, "/x");
    } catch (const config::Error& error) {
      return error.what();
    }
    return "";
  };
  for (const char* const bad : {R"({"gateway": 1})", R"({"gateway": "g", "instances": "a"})",
                                R"({"gateway": "g", "instances": [1]})", R"({"gateway": "g", "silent": []})"}) {
    EXPECT_THAT(refusal(Typed(), bad), HasSubstr("the key")) << bad;
    EXPECT_EQ(refusal(Typed(), bad), refusal(Plain(), bad));
  }
}

TEST(Ids, StandInThriftAsTextDoes) {
  const auto wire = as_wire<Wire>(typed());
  const auto same = as_wire<Wire>(plain());
  EXPECT_EQ(std::tie(wire.gateway, wire.instances, wire.silent), std::tie(same.gateway, same.instances, same.silent));
  const auto own = as_own<Typed>(wire);
  EXPECT_EQ(own.gateway, typed().gateway);
  EXPECT_EQ(own.instances, typed().instances);
  EXPECT_EQ(own.silent, typed().silent);
}

TEST(Ids, NewOnesDiffer) {
  EXPECT_NE(new_instance_id(), new_instance_id());
}

}  // namespace
}  // namespace iotcloud::discovery
