#include <iotcloud/master/cli/start/templates.h>

namespace iotcloud::master::cli {

namespace {

constexpr const char* cmake_head = R"(cmake_minimum_required(VERSION 3.25)
project(@NAME@ LANGUAGES CXX)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
set(CMAKE_LIBRARY_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/plugins)

find_package(iotcloud REQUIRED)
find_package(GTest REQUIRED)
enable_testing()
)";

constexpr const char* cmake_driver = R"(
# The driver: a plugin that gateways load.
add_library(@NAME@_driver MODULE @NAME@_driver.cc)
target_link_libraries(@NAME@_driver PRIVATE iotcloud::drivers)
set_target_properties(@NAME@_driver PROPERTIES PREFIX "" CXX_VISIBILITY_PRESET hidden)
add_executable(@NAME@_driver_test @NAME@_driver_test.cc @NAME@_driver.cc)
target_link_libraries(@NAME@_driver_test PRIVATE iotcloud::drivers_testing GTest::gtest_main)
add_test(NAME @NAME@_driver COMMAND @NAME@_driver_test)
)";

constexpr const char* cmake_bolts = R"(
# The bolts: a component library that topology workers load.
add_library(@NAME@_bolts MODULE @NAME@_bolts.cc)
target_link_libraries(@NAME@_bolts PRIVATE iotcloud::topology)
set_target_properties(@NAME@_bolts PROPERTIES PREFIX "" CXX_VISIBILITY_PRESET hidden)
add_executable(@NAME@_bolts_test @NAME@_bolts_test.cc @NAME@_bolts.cc)
target_link_libraries(@NAME@_bolts_test PRIVATE iotcloud::topology_runtime GTest::gtest_main)
add_test(NAME @NAME@_bolts COMMAND @NAME@_bolts_test)
)";

constexpr const char* cmake_topology = R"(
# Workers look for component libraries beside the topology's file.
configure_file(topology.yaml ${CMAKE_LIBRARY_OUTPUT_DIRECTORY}/topology.yaml COPYONLY)
)";

constexpr const char* driver = R"(#include <array>
#include <chrono>
#include <string>

#include <@SDK@/drivers/plugin.h>

using namespace iotcloud::drivers;

/// Sends a number every `period_ms`, and logs what comes back.
class @CLASS@ : public Driver {
 public:
  static constexpr std::string_view description = "What the device is";
  static constexpr std::array declared_properties{PropertySpec{.name = "period_ms",
                                                               .type = PropertyType::integer,
                                                               .unit = "ms",
                                                               .min = 1,
                                                               .max = 60'000,
                                                               .default_value = "100",
                                                               .text = "time between two readings"}};

  std::vector<ChannelSpec> channels(const PropertyMap&) override {
    return {{.name = "readings", .direction = Direction::out, .when_full = WhenFull::block},
            {.name = "answers", .direction = Direction::in}};
  }
  void open(DriverContext& context) override {
    context_ = &context;
    context.every(std::chrono::milliseconds(context.integer("period_ms")), [this] { send(); });
  }
  void activate() override { active_ = true; }
  void deactivate() override { active_ = false; }
  void on_message(std::string_view, Message message) override {
    context_->log(LogLevel::debug, "answered: " + std::string(message.payload.text()));
  }

 private:
  void send() {
    if (!active_) return;
    // A reading that the channel has no room for is sent the next time.
    const auto status = context_->publish("readings", Payload::copy(std::to_string(next_)));
    if (status == PublishStatus::accepted) ++next_;
  }

  DriverContext* context_ = nullptr;
  bool active_ = false;
  int next_ = 1;
};

IOTCLOUD_DRIVER(@CLASS@, "@NAME@", "1.0")
)";

constexpr const char* driver_test = R"(#include <chrono>

#include <gtest/gtest.h>

#include <@SDK@/drivers/testing/mock_host.h>

using namespace iotcloud::drivers;
using namespace std::chrono_literals;
using iotcloud::drivers::testing::MockInstance;

extern "C" const Descriptor* iotcloud_driver_descriptor();  // what IOTCLOUD_DRIVER exports

TEST(@CLASS@, sends_a_reading_in_every_period) {
  MockInstance device(*iotcloud_driver_descriptor(), {{"period_ms", "100"}});
  ASSERT_TRUE(device.start()) << device.error();
  device.host().advance(1s);  // nothing sleeps: time is simulated
  ASSERT_EQ(device.host().published("readings").size(), 10u);
  EXPECT_EQ(device.host().published("readings")[9].message.payload.text(), "10");
}

TEST(@CLASS@, keeps_a_reading_that_the_channel_has_no_room_for) {
  MockInstance device(*iotcloud_driver_descriptor());
  ASSERT_TRUE(device.start()) << device.error();
  device.host().answer_publish("readings", PublishStatus::would_block);
  device.host().advance(1s);
  device.host().answer_publish("readings", PublishStatus::accepted);
  device.host().advance(100ms);
  EXPECT_EQ(device.host().published("readings")[0].message.payload.text(), "1");
}
)";

constexpr const char* bolts = R"(#include <cstdint>
#include <map>
#include <string>

#include <@SDK@/topology/plugin.h>

using namespace iotcloud::topology;

/// Counts the messages of each driver instance, and answers each with its number.
class @CLASS@ : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"answer", "driverID", "time"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const auto& driver = tuple.get<std::string>("driverID");
    const std::string answer = "message " + std::to_string(++counts_[driver]);
    collector.emit(Values(Payload::copy(answer), driver, tuple.at("time")));
  }

 private:
  std::map<std::string, std::int64_t> counts_;
};

IOTCLOUD_TOPOLOGY_LIBRARY(registry) { registry.add_bolt<@CLASS@>("@NAME@.@CLASS@"); }
)";

constexpr const char* bolts_test = R"(#include <variant>

#include <gtest/gtest.h>

#include <@SDK@/topology/plugin.h>
#include <@SDK@/topology/runtime/complete_topology.h>

using namespace iotcloud::topology;

extern "C" const LibraryDescriptor* iotcloud_topology_library();  // what IOTCLOUD_TOPOLOGY_LIBRARY exports

/// Stands for the spout that reads a broker: the test says what it emits.
class Messages : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"data", "driverID", "time"});
  }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }
};

TEST(@CLASS@, answers_with_the_number_of_the_drivers_message) {
  ComponentRegistry components;
  iotcloud_topology_library()->fill(components);
  TopologyBuilder builder;
  builder.set_spout<Messages>("messages");
  builder.set_bolt("answer", *components.bolt("@NAME@.@CLASS@")).fields_grouping("messages", {"driverID"});
  SimulatedTopology topology(builder.build("test"), {.inputs = {"messages"}});
  for (const char* driver : {"a", "a", "b"})
    topology.put("messages", Values(Payload::copy("x"), driver, std::int64_t{0}));

  const auto answers = topology.tuples("answer");
  ASSERT_EQ(answers.size(), 3u);
  EXPECT_EQ(std::get<Payload>(answers[1][0]).text(), "message 2");
  EXPECT_EQ(std::get<Payload>(answers[2][0]).text(), "message 1");
}
)";

constexpr const char* topology_of_loadgen = R"(zk.servers: ["127.0.0.1:2181"]
topology.name: "@NAME@"
topology.library: "@NAME@_bolts.so"

spouts:
  messages:
    broker: "rabbitmq"
    driver: "loadgen"  # which driver's messages come, and on which channel
    channel: "data"
    fields: ["data", "driverID", "time"]

bolts:
  answer:
    class: "@NAME@.@CLASS@"
    inputs: [{from: messages, grouping: fields, fields: [driverID]}]
)";

constexpr const char* topology_of_project = R"(zk.servers: ["127.0.0.1:2181"]
topology.name: "@NAME@"
topology.library: "@NAME@_bolts.so"

spouts:
  messages:
    broker: "rabbitmq"
    driver: "@NAME@"
    channel: "readings"
    fields: ["data", "driverID", "time"]

bolts:
  answer:
    class: "@NAME@.@CLASS@"
    inputs: [{from: messages, grouping: fields, fields: [driverID]}]
  send:  # the answers go back to the driver
    broker: "rabbitmq"
    driver: "@NAME@"
    channel: "answers"
    fields: ["answer", "driverID", "time"]
    inputs: [{from: answer, grouping: fields, fields: [driverID]}]
)";

constexpr const char* manifest_head =
    R"(# The fleet as it should be: `iotcloud diff -f manifest.yaml` shows what differs, `iotcloud apply -f manifest.yaml` changes it.
fleet: @NAME@
)";
constexpr const char* manifest_driver = R"(
deployments:
  @NAME@:
    plugin: ./build/plugins/@NAME@_driver.so
    gateways: all
    count: 1
    properties: {period_ms: 100}
    metadata: {site: lab}
)";
constexpr const char* manifest_no_driver = R"(
deployments: {}
)";
constexpr const char* manifest_topology = R"(
topologies:
  @NAME@: {file: build/plugins/topology.yaml, workers: 1}
)";

constexpr const char* readme_build = R"(
```sh
cmake -B build -DCMAKE_PREFIX_PATH=PREFIX   # where IoTCloud is installed: ~/iotcloud
cmake --build build && ctest --test-dir build
)";
constexpr const char* readme_driver = R"(# @NAME@: a driver of IoTCloud
)";
constexpr const char* readme_driver_run = R"(iotcloud plugin check build/plugins/@NAME@_driver.so
iotcloud apply -f manifest.yaml
```

`@NAME@_driver.cc` is the driver, `@NAME@_driver_test.cc` its test with a mock host.
)";
constexpr const char* readme_bolt = R"(# @NAME@: a bolt of IoTCloud
)";
constexpr const char* readme_bolt_run =
    R"(iotcloud run build/plugins/topology.yaml --plugin PREFIX/lib/iotcloud/plugins/loadgen.so
iotcloud apply -f manifest.yaml
```

`@NAME@_bolts.cc` is the bolt `@NAME@.@CLASS@`, for `class` in any topology's file, as in `topology.yaml`; `@NAME@_bolts_test.cc` tests it in simulated time.
)";
constexpr const char* readme_topology = R"(# @NAME@: a topology of IoTCloud
)";
constexpr const char* readme_topology_run =
    R"(iotcloud run build/plugins/topology.yaml --plugin PREFIX/lib/iotcloud/plugins/loadgen.so
iotcloud apply -f manifest.yaml
```

`topology.yaml` says what is read and done, `@NAME@_bolts.cc` has its bolts, `@NAME@_bolts_test.cc` tests them in simulated time.
)";
constexpr const char* readme_project = R"(# @NAME@: a driver and a topology of IoTCloud
)";
constexpr const char* readme_project_run =
    R"(iotcloud run build/plugins/topology.yaml --plugin build/plugins/@NAME@_driver.so -n 2
iotcloud apply -f manifest.yaml
```

`@NAME@_driver.cc` is the driver, `@NAME@_bolts.cc` has the bolts of `topology.yaml`; their tests need no server.
)";

std::string joined(std::initializer_list<const char*> parts) {
  std::string text;
  for (const char* part : parts) text += part;
  return text;
}

}  // namespace

Templates templates_of(const std::string& kind) {
  Templates files{{".gitignore", "/build/\n"}};
  const bool with_driver = kind == "driver" || kind == "project";
  const bool with_topology = kind != "driver";
  if (with_driver) {
    files["@NAME@_driver.cc"] = driver;
    files["@NAME@_driver_test.cc"] = driver_test;
  }
  if (with_topology) {
    files["@NAME@_bolts.cc"] = bolts;
    files["@NAME@_bolts_test.cc"] = bolts_test;
    files["topology.yaml"] = kind == "project" ? topology_of_project : topology_of_loadgen;
  }
  files["CMakeLists.txt"] = joined({cmake_head, with_driver ? cmake_driver : "", with_topology ? cmake_bolts : "",
                                    with_topology ? cmake_topology : ""});
  files["manifest.yaml"] = joined(
      {manifest_head, with_driver ? manifest_driver : manifest_no_driver, with_topology ? manifest_topology : ""});
  files["README.md"] = kind == "driver"     ? joined({readme_driver, readme_build, readme_driver_run})
                       : kind == "bolt"     ? joined({readme_bolt, readme_build, readme_bolt_run})
                       : kind == "topology" ? joined({readme_topology, readme_build, readme_topology_run})
                                            : joined({readme_project, readme_build, readme_project_run});
  return files;
}

}  // namespace iotcloud::master::cli
