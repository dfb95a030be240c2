#include <cerrno>
#include <cstring>
#include <deque>
#include <fstream>
#include <sstream>

#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/console/audit_lines.h>

namespace iotcloud::master {

namespace {

constexpr std::streamoff looked_at = std::streamoff{8} << 20;

}  // namespace

std::string last_audit_lines(const std::string& file, const std::string& text, std::size_t most) {
  std::ifstream in(file, std::ios::binary | std::ios::ate);
  if (!in) throw config::Error("the audit log " + file + " cannot be read: " + std::strerror(errno));
  const std::streamoff size = in.tellg();
  bool more = size > looked_at;
  in.seekg(more ? size - looked_at : 0);
  std::string line;
  if (more) std::getline(in, line);  // its beginning is not there
  std::deque<nlohmann::ordered_json> lines;
  while (std::getline(in, line)) {
    if (!text.empty() && line.find(text) == std::string::npos) continue;
    auto entry = nlohmann::ordered_json::parse(line, nullptr, false);
    if (!entry.is_object()) continue;  // the daemon is at writing it
    entry.erase("previous");
    lines.push_back(std::move(entry));
    if (lines.size() <= most) continue;
    lines.pop_front();
    more = true;
  }
  return discovery::to_text(nlohmann::ordered_json{{"lines", lines}, {"more", more}});
}

}  // namespace iotcloud::master
