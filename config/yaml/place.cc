#include <algorithm>

#include <iotcloud/config/yaml/place.h>

namespace iotcloud::config::internal {
namespace {

bool is_space(char c) {
  return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

/// Walks through the source and counts lines and columns.
class Cursor {
 public:
  Cursor(std::string_view source, const Location& begin) : source_(source), place_(begin) {
    for (int line = 1; line < begin.line && at_ < source.size(); ++line) {
      at_ = std::min(source.find('\n', at_), source.size() - 1) + 1;
    }
    at_ = std::min(at_ + static_cast<std::size_t>(begin.column - 1), source.size());
  }
  bool ended() const { return at_ == source_.size(); }
  char current() const { return source_[at_]; }
  bool next_is(char c) const { return at_ + 1 < source_.size() && source_[at_ + 1] == c; }
  const Location& place() const { return place_; }
  void step() {
    if (source_[at_++] == '\n') {
      ++place_.line;
      place_.column = 1;
    } else {
      ++place_.column;
    }
  }
  void skip_line() {
    while (!ended() && current() != '\n') step();
  }
  void skip_space() {
    while (!ended() && is_space(current())) step();
  }

 private:
  const std::string_view source_;
  std::size_t at_ = 0;
  Location place_;
};

}  // namespace

/// Folding changes white space only, so the n-th other character of the value is the n-th other one of the source.
Location place_in_scalar(std::string_view source, const Location& begin, std::string_view value, std::size_t offset) {
  if (begin.line < 1 || begin.column < 1) return begin;
  Cursor cursor(source, begin);
  while (!cursor.ended() && (cursor.current() == '&' || cursor.current() == '!')) {  // an anchor, a tag
    while (!cursor.ended() && !is_space(cursor.current())) cursor.step();
    cursor.skip_space();
  }
  if (cursor.ended()) return begin;
  const char style = cursor.current();
  const bool quoted = style == '"' || style == '\'';
  if (quoted) cursor.step();
  if (style == '|' || style == '>') cursor.skip_line();
  Location behind_last = cursor.place();
  for (std::size_t i = 0; i <= value.size(); ++i) {
    if (i == value.size()) return behind_last;
    if (is_space(value[i])) continue;
    cursor.skip_space();
    if (cursor.ended()) return begin;
    const Location here = cursor.place();
    // The first character of an escape: \\ escapes the next character, '' stands for one quote.
    if (style == '"' && cursor.current() == '\\') cursor.step();
    if (style == '\'' && cursor.current() == '\'' && cursor.next_is('\'')) cursor.step();
    if (cursor.ended() || cursor.current() != value[i]) return begin;
    if (i >= offset) return here;
    cursor.step();
    behind_last = cursor.place();
  }
  return begin;
}

}  // namespace iotcloud::config::internal
