#include <filesystem>
#include <utility>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/provisioning/kept_things.h>
#include <iotcloud/processes/durable_file.h>

namespace iotcloud::gateway {

namespace {

constexpr unsigned of_the_gateway_only = 0600;
/// The file of a gateway that keeps 10 000 things of the greatest size is smaller.
constexpr std::size_t longest_file = std::size_t{512} << 20;

}  // namespace

std::size_t write_kept_things(const std::string& file, const std::vector<KeptThing>& things) {
  std::string text;
  for (const auto& thing : things) text += discovery::to_text(discovery::to_json<nlohmann::json>(thing)) + '\n';
  config::replace_file(file, text, of_the_gateway_only);
  return text.size();
}

std::vector<KeptThing> read_kept_things(const std::string& file) {
  std::vector<KeptThing> things;
  if (!std::filesystem::exists(file)) return things;
  std::string text;
  try {
    text = processes::read_file(file, longest_file);
  } catch (const config::Error& e) {
    logger.error("what an earlier run found is not known, and is found again: {}", e.what());
    return things;
  }
  for (std::size_t at = 0, end = 0; (end = text.find('\n', at)) != std::string::npos; at = end + 1) {
    try {
      auto line = discovery::from_text<KeptThing>(text.substr(at, end - at), file);
      if (const std::string problem = problem_of(line.thing); !problem.empty()) throw config::Error(problem);
      things.push_back(std::move(line));
    } catch (const config::Error& e) {
      logger.warn("a line of what an earlier run found is passed over: {}", e.what());
    }
  }
  return things;
}

}  // namespace iotcloud::gateway
