#include <ostream>
#include <sstream>
#include <utility>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/log_lines.h>

namespace iotcloud::master::cli {

namespace {

constexpr std::chrono::milliseconds follow_pause{500};

void print_lines(const std::deque<std::string>& lines, Format format, std::ostream& out) {
  for (const auto& line : lines) {
    if (format == Format::table) {
      out << printable(line) << '\n';
    } else {
      out << (format == Format::yaml ? "- " : "") << discovery::to_text(nlohmann::ordered_json(line)) << '\n';
    }
  }
  out << std::flush;
}

}  // namespace

std::deque<std::string> last_lines(const std::string& text, const std::string& word, std::size_t most) {
  std::deque<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    if (!word.empty() && line.find(word) == std::string::npos) continue;
    lines.push_back(std::move(line));
    if (lines.size() > most) lines.pop_front();
  }
  return lines;
}

int show_log(Call& call, const LogChoice& choice, const std::function<LogPart(const std::string& position)>& read) {
  auto part = read("");
  const auto lines = last_lines(part.text, choice.word, static_cast<std::size_t>(choice.lines));
  if (!choice.follow && call.format == Format::json) {
    print_data(call.out, call.format, lines);
    return exit_ok;
  }
  print_lines(lines, call.format, call.out);
  // After a large part there is probably more to read, so it is read at once.
  const auto rest = [&] { return part.text.size() < most_log_bytes / 2 ? follow_pause : follow_pause.zero(); };
  while (choice.follow && pause(rest())) {
    part = read(part.position);
    print_lines(last_lines(part.text, choice.word, most_log_bytes), call.format, call.out);
  }
  return exit_ok;
}

}  // namespace iotcloud::master::cli
