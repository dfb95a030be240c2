#include <algorithm>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/fleet/manifest.h>

namespace iotcloud::master::cli {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;
using testing::SizeIs;
using testing::UnorderedElementsAre;

Manifest read(const std::string& text) {
  return read_manifest(config::YamlSection::parse(text, "fleet.yaml"));
}

/// What is said of a manifest with these lines in its only deployment, which is good otherwise.
std::string error_of(const std::string& lines) {
  try {
    read("fleet: lab\ndeployments:\n  meter:\n    plugin: a.so\n    gateways: all\n" + lines);
  } catch (const config::ConfigError& e) {
    return e.what();
  }
  return "";
}

std::string error_of_whole(const std::string& text) {
  try {
    read(text);
  } catch (const config::ConfigError& e) {
    return e.what();
  }
  return "";
}

TEST(Manifest, TellsAllErrorsAtOnce) {
  const std::string text = error_of_whole(R"(fleet: a/b
deployments:
  one: {plugin: a.so, gateways: [x, all, x], count: many, metadat: {a: b}}
  two: {gateways: all, state: off, channels: {data: {deadline_ms: soon}}}
)");
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 7) << text;
  for (const char* part :
       {"fleet.yaml:1:1: fleet: \"a/b\" cannot be a name", "deployments.one.gateways: \"all\" stands beside others",
        "deployments.one.gateways: x stands here twice", "deployments.one.count: \"many\"",
        "deployments.one.metadat: unknown key; did you mean \"metadata\"?", "the key \"plugin\" is missing",
        "deployments.two.state: \"off\" is not known", "deployments.two.channels.data.deadline_ms:"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST(Manifest, SaysTopologiesWithTheirFilesAndWorkers) {
  const auto manifest =
      read("fleet: lab\ntopologies:\n  second: {file: b.yaml}\n  echo: {file: dir/echo.yaml, workers: 3}\n");
  ASSERT_THAT(manifest.topologies, SizeIs(2));
  EXPECT_EQ(manifest.topologies[0].name, "second");  // in the order of the file
  EXPECT_EQ(manifest.topologies[0].workers, 1);
  EXPECT_EQ(manifest.topologies[1].name, "echo");
  EXPECT_EQ(manifest.topologies[1].file, "dir/echo.yaml");
  EXPECT_EQ(manifest.topologies[1].workers, 3);
  EXPECT_EQ(manifest.topologies[1].place.line, 4);
  EXPECT_THAT(manifest.deployments, IsEmpty());
}

TEST(Manifest, RefusesTopologiesThatItCannotRead) {
  const std::string text = error_of_whole(
      "fleet: lab\ntopologies:\n  a/b: {file: a.yaml}\n  one: {workers: 2}\n  two: {file: t.yaml, workers: 0}\n"
      "  three: {file: t.yaml, worker: 2}\n");
  for (const char* part : {"fleet.yaml:3:", "topologies.one: the key \"file\" is missing", "topologies.two.workers",
                           "topologies.three.worker: unknown key; did you mean \"workers\"?"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST(Manifest, SaysDeploymentsWithWhatTheirInstancesAreToBe) {
  const auto manifest = read(R"(
fleet: lab
deployments:
  second: {plugin: turtle.so, gateways: all, state: inactive}
  meter:
    plugin: meter.so
    driver: thermometer
    gateways: [lab1, lab2]
    count: 3
    properties: {rate: 5, empty: ""}
    metadata: {site: lab}
    channels:
      data: {when_full: spool, spool_fsync: always, deadline_ms: 100}
      my.control: {keep_last: 2, durable: true}
)");
  EXPECT_EQ(manifest.fleet, "lab");
  ASSERT_THAT(manifest.deployments, SizeIs(2));
  const auto& second = manifest.deployments[0];  // in the order of the file
  EXPECT_EQ(second.name, "second");
  EXPECT_TRUE(second.all_gateways);
  EXPECT_FALSE(second.active);
  EXPECT_EQ(second.count, 1);
  EXPECT_THAT(second.properties, IsEmpty());
  const auto& meter = manifest.deployments[1];
  EXPECT_EQ(meter.plugin, "meter.so");
  EXPECT_EQ(meter.driver, "thermometer");
  EXPECT_FALSE(meter.all_gateways);
  EXPECT_THAT(meter.gateways, ElementsAre("lab1", "lab2"));
  EXPECT_EQ(meter.count, 3);
  EXPECT_TRUE(meter.active);
  EXPECT_THAT(meter.metadata, UnorderedElementsAre(Pair("site", "lab")));
  EXPECT_THAT(
      meter.properties,
      UnorderedElementsAre(Pair("rate", "5"), Pair("empty", ""), Pair("channel.data.when_full", "spool"),
                           Pair("channel.data.spool_fsync", "always"), Pair("channel.data.deadline_ms", "100"),
                           Pair("channel.my.control.keep_last", "2"), Pair("channel.my.control.durable", "true")));
}

TEST(Manifest, TheShippedFileIsGood) {
  const auto manifest = load_manifest(IOTCLOUD_SOURCE_DIR "/config/fleet.yaml");
  ASSERT_THAT(manifest.deployments, SizeIs(1));
  EXPECT_EQ(manifest.deployments[0].properties.at("channel.data.when_full"), "spool");
}

TEST(Manifest, NeedsItsNameAndDeploymentsSoThatAnEmptyFileTakesNothingAway) {
  EXPECT_THAT(error_of_whole("deployments: {}\n"), AllOf(HasSubstr("fleet.yaml:"), HasSubstr("\"fleet\"")));
  EXPECT_THAT(error_of_whole("fleet: lab\n"), AllOf(HasSubstr("\"deployments\""), HasSubstr("{}")));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n"), HasSubstr("\"deployments\""));
  EXPECT_THAT(read("fleet: lab\ndeployments: {}\n").deployments, IsEmpty());
  EXPECT_THAT(error_of_whole("fleet: a/b\ndeployments: {}\n"), AllOf(HasSubstr("a/b"), HasSubstr("no slash")));
}

TEST(Manifest, AMistakeIsNamedWithFileLineKeyAndRemedy) {
  EXPECT_THAT(error_of("    gateway: lab1\n"),
              AllOf(HasSubstr("fleet.yaml:6:"), HasSubstr("deployments.meter.gateway"), HasSubstr("\"gateways\"")));
  EXPECT_THAT(error_of("    count: many\n"), AllOf(HasSubstr(":6:"), HasSubstr("0 to 10000")));
  EXPECT_THAT(error_of("    state: stopped\n"), AllOf(HasSubstr(":6:"), HasSubstr("\"inactive\"")));
  EXPECT_THAT(error_of("    count: 1\n    count: 2\n"), HasSubstr("twice"));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n  meter: {gateways: all}\n"), HasSubstr("plugin"));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n  meter: {plugin: a.so}\n"), HasSubstr("gateways"));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n  a/b: {plugin: a.so, gateways: all}\n"),
              HasSubstr("no slash"));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n  m: {plugin: a.so, gateways: [a, all]}\n"),
              HasSubstr("beside others"));
  EXPECT_THAT(error_of_whole("fleet: lab\ndeployments:\n  m: {plugin: a.so, gateways: [a, a]}\n"), HasSubstr("twice"));
  EXPECT_THAT(error_of("    metadata: {site: \"\"}\n"), HasSubstr("deployments.meter.metadata.site"));
}

TEST(Manifest, OptionsOfChannelsAreChecked) {
  EXPECT_THAT(error_of("    channels: {data: {deadline: 5}}\n"),
              AllOf(HasSubstr(":6:"), HasSubstr("channels.data.deadline"), HasSubstr("deadline_ms")));
  EXPECT_THAT(error_of("    channels: {data: {priority: 10}}\n"), HasSubstr("0 to 9"));
  EXPECT_THAT(error_of("    channels: {data: {durable: yes}}\n"), HasSubstr("true, false"));
  EXPECT_THAT(error_of("    channels: {data: {when_full: block, spool_full: block}}\n"),
              AllOf(HasSubstr("spool_full"), HasSubstr("set when_full to spool")));
  EXPECT_EQ(error_of("    channels: {data: {spool_full: block}}\n"), "") << "the driver may ask for the spool itself";
  EXPECT_THAT(error_of("    properties: {channel.data.priority: 5}\n"), HasSubstr("say it under \"channels\""));
}

TEST(Manifest, APluginWithASlashIsAFileThatIsLookedFor) {
  const auto top = [](const std::string& plugin) {
    return config::YamlSection::parse("fleet: lab\ndeployments:\n  meter: {plugin: " + plugin + ", gateways: all}\n",
                                      "fleet.yaml");
  };
  const auto find = [](const std::string& named) { return PluginFile{"/builds/" + named, std::string(64, 'a')}; };
  const auto sent = read_manifest(top("out/meter.so"), find).deployments.at(0);
  EXPECT_EQ(sent.plugin, "meter.so");
  EXPECT_EQ(sent.file, "/builds/out/meter.so");
  EXPECT_EQ(sent.sha256, std::string(64, 'a'));
  const auto theirs = read_manifest(top("meter.so"), find).deployments.at(0);
  EXPECT_EQ(theirs.plugin, "meter.so");
  EXPECT_EQ(theirs.file + theirs.sha256, "");
  EXPECT_THROW(read_manifest(top("out/"), find), config::ConfigError) << "a folder's name";
  EXPECT_THROW(read_manifest(top("out/meter.so")), config::ConfigError) << "nobody looks for files";
}

}  // namespace
}  // namespace iotcloud::master::cli
