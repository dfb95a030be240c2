#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/cli/fleet/instance_properties.h>

namespace iotcloud::master::cli {

namespace {

/// Reads one record after the other.
class Records {
 public:
  Records(std::string_view text, std::string file) : rest_(text), file_(std::move(file)) {
    if (constexpr std::string_view mark = "\xef\xbb\xbf"; rest_.starts_with(mark)) rest_.remove_prefix(mark.size());
  }

  /// The next record that is not an empty line; empty: there is none.
  std::vector<std::string> next() {
    while (!rest_.empty()) {
      ++line_;
      auto values = record();
      line_ += std::exchange(breaks_, 0);
      if (values.size() > 1 || !values.front().empty()) return values;
    }
    return {};
  }
  [[nodiscard]] config::ConfigError error(const std::string& problem, const std::string& remedy) const {
    return config::ConfigError({file_, line_, 0}, "", problem, remedy);
  }

 private:
  std::vector<std::string> record() {
    std::vector<std::string> values;
    while (true) {
      values.push_back(rest_.starts_with('"') ? quoted() : plain());
      if (rest_.empty()) return values;
      const char end = rest_.front();
      rest_.remove_prefix(1);
      if (end == '\n') return values;
    }
  }
  std::string plain() {
    const auto end = std::min(rest_.find_first_of(",\n"), rest_.size());
    auto value = rest_.substr(0, end);
    rest_.remove_prefix(end);
    if (value.ends_with('\r')) value.remove_suffix(1);
    return std::string(value);
  }
  std::string quoted() {
    std::string value;
    rest_.remove_prefix(1);
    while (true) {
      const auto end = rest_.find('"');
      if (end == std::string_view::npos) throw error("a quote is not closed", "end the value with a double quote");
      value += rest_.substr(0, end);
      rest_.remove_prefix(end + 1);
      if (!rest_.starts_with('"')) break;
      value += '"';
      rest_.remove_prefix(1);
    }
    breaks_ += static_cast<int>(std::count(value.begin(), value.end(), '\n'));
    if (rest_.starts_with('\r')) rest_.remove_prefix(1);
    if (!rest_.empty() && rest_.front() != ',' && rest_.front() != '\n')
      throw error("text stands behind a closing quote", "two double quotes within a quoted value stand for one");
    return value;
  }

  std::string_view rest_;
  const std::string file_;
  int line_ = 0;
  int breaks_ = 0;  ///< line ends within values of the present record
};

}  // namespace

std::vector<Texts> read_csv(std::string_view text, const std::string& file) {
  Records records(text, file);
  const auto names = records.next();
  if (names.empty()) throw records.error("the file is empty", "begin with a line of properties' names");
  std::set<std::string> seen;
  for (const auto& name : names) {
    if (name.empty()) throw records.error("a column has no name", "begin with a line of properties' names");
    if (!seen.insert(name).second) throw records.error(fmt::format("the column {} stands here twice", name), "");
  }
  std::vector<Texts> instances;
  for (auto values = records.next(); !values.empty(); values = records.next()) {
    if (values.size() != names.size())
      throw records.error(fmt::format("this line has {} values, the head has {}", values.size(), names.size()),
                          "a value with a comma stands in double quotes");
    auto& instance = instances.emplace_back();
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (!values[i].empty()) instance[names[i]] = std::move(values[i]);
    }
  }
  if (instances.empty()) throw records.error("there is a head only", "write a line for each instance");
  return instances;
}

}  // namespace iotcloud::master::cli
