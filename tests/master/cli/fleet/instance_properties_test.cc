// Properties of single instances in a manifest, and the check of all against what plugins declare.
#include <algorithm>
#include <functional>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/fleet/instance_properties.h>
#include <iotcloud/master/cli/fleet/property_check.h>

namespace iotcloud::master::cli {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

constexpr const char* station = R"({"driver":"station","properties":[
  {"name":"rate","type":"number","min":0.1,"max":1000,"default":"10"},
  {"name":"base","type":"integer"},
  {"name":"api_key","type":"integer"},
  {"name":"site","type":"text","required":true,"text":"where it stands"}]})";

std::vector<DeclaredPlugin> declared(const ManifestDeployment&) {
  return {{"station.so", config::parse_declaration(station)}};
}

Manifest read_fleet(const std::string& deployments, const std::string& csv = "") {
  return read_manifest(config::YamlSection::parse("fleet: lab\ndeployments:\n" + deployments, "fleet.yaml"), {},
                       [csv](const std::string&) { return csv; });
}

std::string told_by(const std::function<void()>& call) {
  try {
    call();
  } catch (const config::ConfigError& e) {
    return e.what();
  }
  return "";
}

std::string check_error(const std::string& deployments, const std::string& csv = "") {
  const auto manifest = read_fleet(deployments, csv);
  return told_by([&] { check_properties(manifest, declared); });
}

TEST(PropertyCheck, AllMistakesOfAManifestAreToldAtOnceEachWithItsLine) {
  const auto error = check_error(R"(  north:
    plugin: station.so
    gateways: all
    count: 11
    properties:
      site: roof
      rat: 5
      base: high
  south:
    plugin: station.so
    gateways: all
    properties: {rate: 2000}
)");
  EXPECT_THAT(
      error,
      AllOf(HasSubstr("fleet.yaml:9:7: deployments.north.properties.rat: unknown property; did you mean \"rate\"?"),
            HasSubstr("fleet.yaml:10:7: deployments.north.properties.base: \"high\"; it takes a whole number"),
            HasSubstr(
                "fleet.yaml:14:18: deployments.south.properties.rate: \"2000\"; it takes a number from 0.1 to 1000"),
            HasSubstr("deployments.south.properties.site: missing; it takes any text (where it stands)"),
            HasSubstr("(station.so)")));
  EXPECT_EQ(std::count(error.begin(), error.end(), '\n'), 3);  // one error for all eleven
}

TEST(PropertyCheck, WhatAPluginDeclaresNothingOfIsAccepted) {
  const auto manifest = read_fleet("  a: {plugin: a.so, gateways: all, properties: {any: thing}}\n");
  EXPECT_NO_THROW(check_properties(manifest, [](const ManifestDeployment&) { return std::vector<DeclaredPlugin>{}; }));
  EXPECT_NO_THROW(check_properties(manifest, [](const ManifestDeployment&) {
    return std::vector<DeclaredPlugin>{{"a.so", config::DriverDeclaration{}}};
  }));
}

TEST(PropertyCheck, ASecretIsNotShown) {
  const auto error = check_error("  a: {plugin: a.so, gateways: all, properties: {site: x, api_key: hunter2}}\n");
  EXPECT_THAT(error, AllOf(HasSubstr("api_key"), Not(HasSubstr("hunter2"))));
}

TEST(InstanceProperties, AListHasAValueForEachInstanceAndANumberStandsForTheMark) {
  const auto manifest = read_fleet(
      "  a: {plugin: a.so, gateways: all, count: 2, properties: {site: 'room {index}', base: [15, 30], rate: 5}}\n");
  const auto& deployment = manifest.deployments.at(0);
  EXPECT_EQ(deployment.properties_of(1), (Texts{{"site", "room 1"}, {"base", "15"}, {"rate", "5"}}));
  EXPECT_EQ(deployment.properties_of(2), (Texts{{"site", "room 2"}, {"base", "30"}, {"rate", "5"}}));
  EXPECT_THAT(told_by([] { read_fleet("  a: {plugin: a.so, gateways: all, count: 3, properties: {base: [1, 2]}}\n"); }),
              AllOf(StartsWith("fleet.yaml:3:"), HasSubstr("a list of 2 values for 3 instances")));
}

TEST(InstanceProperties, ACsvFileSaysHowManyInstancesThereAreAndWhatEachHas) {
  const auto manifest = read_fleet("  a: {plugin: a.so, gateways: all, each: s.csv, properties: {rate: 5, base: 9}}\n",
                                   "\xef\xbb\xbfsite,base\r\n\"roof, \"\"north\"\"\",30\r\n\r\ncellar {index},\r\n");
  const auto& deployment = manifest.deployments.at(0);
  EXPECT_EQ(deployment.count, 2);
  EXPECT_EQ(deployment.properties_of(1), (Texts{{"site", "roof, \"north\""}, {"base", "30"}, {"rate", "5"}}));
  EXPECT_EQ(deployment.properties_of(2), (Texts{{"site", "cellar 2"}, {"base", "9"}, {"rate", "5"}}));
  EXPECT_THAT(check_error("  a: {plugin: a.so, gateways: all, each: s.csv}\n", "site,base\nroof,1\ncellar,hot\n"),
              StartsWith("s.csv:3: deployments.a.properties.base: \"hot\""));
}

TEST(InstanceProperties, AWrongCsvFileIsNamedWithItsLine) {
  const auto error = [](const std::string& csv) { return told_by([&] { read_csv(csv, "s.csv"); }); };
  EXPECT_THAT(error(""), HasSubstr("the file is empty"));
  EXPECT_THAT(error("a,a\n1,2\n"), AllOf(StartsWith("s.csv:1"), HasSubstr("stands here twice")));
  EXPECT_THAT(error("a,\n1,2\n"), HasSubstr("a column has no name"));
  EXPECT_THAT(error("a,b\n1,2\n1\n"), AllOf(StartsWith("s.csv:3"), HasSubstr("1 values, the head has 2")));
  EXPECT_THAT(error("a\n\"1\n\n"), AllOf(StartsWith("s.csv:2"), HasSubstr("not closed")));
  EXPECT_THAT(error("a\n\"1\"2\n"), HasSubstr("behind a closing quote"));
  EXPECT_THAT(error("a\n"), HasSubstr("a head only"));
  EXPECT_THAT(read_csv("a,b\n\"x\ny\",2\n3,4", "s.csv"),
              ElementsAre(Texts{{"a", "x\ny"}, {"b", "2"}}, Texts{{"a", "3"}, {"b", "4"}}));
  EXPECT_THAT(told_by([] { read_fleet("  a: {plugin: a.so, gateways: all, count: 3, each: s.csv}\n", "a\n1\n"); }),
              HasSubstr("s.csv has 1 instances, count says 3"));
  EXPECT_THAT(told_by([] { read_fleet("  a: {plugin: a.so, gateways: all, each: s.csv}\n", "channel.a.b\n1\n"); }),
              HasSubstr("which is of a channel"));
}

}  // namespace
}  // namespace iotcloud::master::cli
