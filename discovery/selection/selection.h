#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::discovery {

/// An expression that cannot be parsed. what() has three lines: the place and what was expected, the expression's line,
/// and a caret below the character.
class SelectionError : public config::Error {
 public:
  /// \param offset of the character in `text`, in bytes; text.size() is the end.
  SelectionError(std::string_view text, std::size_t offset, const std::string& problem);

  std::size_t offset() const { return offset_; }                 ///< bytes from the beginning of the expression
  int line() const { return line_; }                             ///< in the expression, from 1
  int column() const { return column_; }                         ///< in that line, in characters, from 1
  const std::string& problem() const { return problem_; }        ///< what was expected
  const std::string& pointer_lines() const { return pointer_; }  ///< the expression's line, and the caret below it

 private:
  std::size_t offset_;
  int line_;
  int column_;
  std::string problem_;
  std::string pointer_;
};

/// Selects drivers by their records, with an expression (discovery/selection/README.md):
/// `site == "lab" and battery > 20 and within(location, 39.17, -86.52, 500 m)`.
/// Immutable: cheap to copy; many threads may use it at once.
class Selection {
 public:
  /// Selects every driver.
  Selection() = default;
  /// \throws SelectionError, also for more than max_size bytes or max_depth nested parentheses and `not`s.
  static Selection parse(std::string_view text);

  /// Takes time in proportion to the expression's length at most; allocates nothing.
  bool matches(const DriverRecord& driver) const noexcept;
  bool everything() const { return program_ == nullptr; }
  const std::string& text() const;  ///< the text that was parsed; empty: selects every driver

  static constexpr std::size_t max_size = 4096;
  static constexpr int max_depth = 64;

  struct Program;

 private:
  explicit Selection(std::shared_ptr<const Program> program) : program_(std::move(program)) {}
  std::shared_ptr<const Program> program_;
};

}  // namespace iotcloud::discovery
