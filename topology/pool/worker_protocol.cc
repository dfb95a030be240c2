#include <iotcloud/discovery/description/json.h>
#include <iotcloud/processes/durable_file.h>
#include <iotcloud/processes/frames.h>
#include <iotcloud/topology/pool/worker_protocol.h>

namespace iotcloud::topology::pooled {

namespace {

constexpr std::size_t most_bytes = std::size_t{1} << 20;

template <typename Struct>
std::string text_of(const Struct& value) {
  return discovery::to_text(discovery::to_json<nlohmann::json>(value));
}

template <typename Struct>
Struct read(const std::string& path) {
  return discovery::from_text<Struct>(processes::read_file(path, most_bytes), path);
}

}  // namespace

std::string encode(const WorkerSpec& spec) {
  return text_of(spec);
}
std::string encode(const WorkerEnd& end) {
  return text_of(end);
}
std::string frame_of(const WorkerReport& report) {
  return processes::frame(text_of(report));
}
std::string frame_of(const PoolCommand& command) {
  return processes::frame(text_of(command));
}

WorkerSpec read_spec(const std::string& folder) {
  return read<WorkerSpec>(folder + "/" + spec_name);
}

std::optional<WorkerEnd> read_end(const std::string& folder) try {
  return read<WorkerEnd>(folder + "/" + end_name);
} catch (const config::Error&) {
  return std::nullopt;
}

WorkerReport decode_report(const std::string& body) {
  return discovery::from_text<WorkerReport>(body, "a worker's report");
}
PoolCommand decode_command(const std::string& body) {
  return discovery::from_text<PoolCommand>(body, "a pool's command");
}

}  // namespace iotcloud::topology::pooled
