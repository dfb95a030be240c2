#include <filesystem>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/component_library.h>
#include <iotcloud/topology/storm/job/classes.h>

namespace iotcloud::topology::storm {

namespace {

using Json = nlohmann::ordered_json;

class JsonOfStreams final : public OutputFieldsDeclarer {
 public:
  void declare_stream(const std::string& stream, Fields fields, bool direct) override {
    streams[stream] = {{"fields", std::vector<std::string>(fields.begin(), fields.end())}, {"direct", direct}};
  }
  Json streams = Json::object();
};

template <typename Factory>
Json streams_of(const std::string& library, const std::string& name, const Factory& factory) {
  JsonOfStreams declared;
  try {
    factory()->declare_output_fields(declared);
  } catch (const std::exception& error) {
    throw config::Error(
        fmt::format("{}: {} could not be made and asked for its fields: {}", library, name, error.what()));
  }
  return std::move(declared.streams);
}

}  // namespace

std::string classes_of(const std::string& library) {
  ComponentRegistry registry;
  load_components(library, registry);
  Json classes{{"spout", Json::object()}, {"bolt", Json::object()}, {"grouping", Json::object()}};
  for (const auto& name : registry.spout_names())
    classes["spout"][name] = streams_of(library, name, *registry.spout(name));
  for (const auto& name : registry.bolt_names())
    classes["bolt"][name] = streams_of(library, name, *registry.bolt(name));
  for (const auto& name : registry.grouping_names()) classes["grouping"][name] = Json::object();
  return classes.dump();
}

}  // namespace iotcloud::topology::storm
