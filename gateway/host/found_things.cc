#include <utility>

#include <fmt/format.h>

#include <iotcloud/gateway/host/found_things.h>

namespace iotcloud::gateway {

namespace {

/// A report longer than this is cut into several.
constexpr std::size_t moderate_bytes = std::size_t{1} << 20;

std::size_t bytes_of(const FoundThing& thing) {
  std::size_t bytes = thing.key.size();
  for (const auto& [name, value] : thing.attributes) bytes += name.size() + value.size();
  return bytes;
}

}  // namespace

std::string problem_of(const FoundThing& thing) {
  if (thing.key.empty() || thing.key.size() > longest_found_key)
    return fmt::format("its key has {} bytes; 1 to {} are allowed", thing.key.size(), longest_found_key);
  if (thing.attributes.empty() || thing.attributes.size() > most_attributes)
    return fmt::format("it has {} attributes; 1 to {} are allowed", thing.attributes.size(), most_attributes);
  if (const std::size_t bytes = bytes_of(thing) - thing.key.size(); bytes > most_attribute_bytes)
    return fmt::format("its attributes have {} bytes; {} are the most", bytes, most_attribute_bytes);
  return "";
}

std::string FoundThings::found(FoundThing thing) {
  const auto known = things_.find(thing.key);
  std::string problem = problem_of(thing);
  if (problem.empty() && known == things_.end() && things_.size() >= most_found)
    problem = fmt::format("{} things were found already, which are the most", things_.size());
  if (!problem.empty()) {
    ++refused_;
    return problem;
  }
  if (known != things_.end() && known->second == thing) return "";
  gone_.erase(thing.key);
  fresh_.insert(thing.key);
  changed_ = true;
  const std::string key = thing.key;
  things_.insert_or_assign(key, std::move(thing));
  return "";
}

void FoundThings::gone(std::string_view key) {
  const auto known = things_.find(key);
  if (known == things_.end()) return;
  if (const auto fresh = fresh_.find(key); fresh != fresh_.end()) fresh_.erase(fresh);
  gone_.insert(known->first);
  things_.erase(known);
  changed_ = true;
}

void FoundThings::sight(bool sees) {
  if (std::exchange(sees_, sees) == sees) return;
  changed_ = true;
  if (!sees) return;
  things_.clear();
  fresh_.clear();
  gone_.clear();
  anew_ = true;
}

std::vector<FoundReport> FoundThings::take(const discovery::InstanceId& finder, bool whole) {
  std::vector<FoundReport> reports;
  if (whole && !told_) return reports;
  whole = std::exchange(anew_, false) || whole || !told_;
  told_ = true;
  changed_ = false;
  const auto begin = [&] { reports.push_back({finder, whole && reports.empty(), sees_, {}, {}}); };
  begin();
  std::size_t bytes = 0;
  const auto add = [&](std::size_t more, const auto& put) {
    bytes += more;
    if (bytes > moderate_bytes) {
      begin();
      bytes = more;
    }
    put(reports.back());
  };
  if (!whole) {
    for (const auto& key : gone_) add(key.size(), [&](FoundReport& report) { report.gone.push_back(key); });
  }
  for (const auto& [key, thing] : things_) {
    if (whole || fresh_.contains(key))
      add(bytes_of(thing), [&found = thing](FoundReport& report) { report.found.push_back(found); });
  }
  fresh_.clear();
  gone_.clear();
  return reports;
}

}  // namespace iotcloud::gateway
