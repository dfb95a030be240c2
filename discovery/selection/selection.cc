#include <algorithm>
#include <utility>

#include <iotcloud/discovery/selection/program.h>
#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery {
namespace {

/// Messages show at most this much of a line.
constexpr std::size_t shown = 100;

bool continues_character(char c) {
  return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U;
}

std::size_t characters(std::string_view text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return !continues_character(c); }));
}

std::size_t line_begin(std::string_view text, std::size_t offset) {
  const std::size_t line_break = offset == 0 ? std::string_view::npos : text.rfind('\n', offset - 1);
  return line_break == std::string_view::npos ? 0 : line_break + 1;
}

int line_of(std::string_view text, std::size_t offset) {
  const std::string_view before = text.substr(0, offset);
  return 1 + static_cast<int>(std::count(before.begin(), before.end(), '\n'));
}

int column_of(std::string_view text, std::size_t offset) {
  const std::size_t begin = line_begin(text, offset);
  return 1 + static_cast<int>(characters(text.substr(begin, offset - begin)));
}

std::string place_words(std::string_view text, std::size_t offset) {
  const int line = line_of(text, offset);
  const std::string column = "column " + std::to_string(column_of(text, offset));
  return line > 1 ? "line " + std::to_string(line) + ", " + column : column;
}

/// The line at `offset`, shortened if it is long, and a caret below the character.
std::string point_at(std::string_view text, std::size_t offset) {
  std::size_t begin = line_begin(text, offset);
  std::size_t end = std::min(text.find('\n', offset), text.size());
  const char* before = "";
  const char* after = "";
  if (offset - begin > shown / 2) {
    begin = offset - shown / 2;
    while (begin < offset && continues_character(text[begin])) ++begin;
    before = "... ";
  }
  if (end - offset > shown / 2) {
    end = offset + shown / 2;
    while (end > offset && continues_character(text[end])) --end;
    after = " ...";
  }
  std::string line = before + std::string(text.substr(begin, end - begin)) + after;
  std::replace_if(
      line.begin(), line.end(), [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7f; }, ' ');
  const std::size_t indent = std::string_view(before).size() + characters(text.substr(begin, offset - begin));
  return "  " + line + "\n  " + std::string(indent, ' ') + "^";
}

}  // namespace

SelectionError::SelectionError(std::string_view text, std::size_t offset, const std::string& problem)
    : Error(place_words(text, offset) + ": " + problem + "\n" + point_at(text, offset)),
      offset_(offset),
      line_(line_of(text, offset)),
      column_(column_of(text, offset)),
      problem_(problem),
      pointer_(point_at(text, offset)) {}

Selection Selection::parse(std::string_view text) {
  return Selection(std::make_shared<const Program>(internal::compile(text)));
}

bool Selection::matches(const DriverRecord& driver) const noexcept {
  return !program_ || internal::holds(*program_, driver);
}

const std::string& Selection::text() const {
  static const std::string none;
  return program_ ? program_->text : none;
}

}  // namespace iotcloud::discovery
