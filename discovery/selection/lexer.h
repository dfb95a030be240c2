#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace iotcloud::discovery::internal {

enum class TokenKind {
  end,
  word,    ///< a key, a function or a keyword
  key,     ///< `any key` in back quotes
  text,    ///< "lab" or 'lab'
  number,  ///< 20, -86.52, 1e3
  equal,
  not_equal,
  less,
  less_equal,
  greater,
  greater_equal,
  open,        ///< (
  close,       ///< )
  open_list,   ///< [
  close_list,  ///< ]
  comma,
};

struct Token {
  TokenKind kind = TokenKind::end;
  std::size_t offset = 0;  ///< where the token begins in the expression, in characters
  std::string text;        ///< a word, key or text, without quotes and escapes
  double number = 0;
};

/// Cuts an expression into tokens.
class Lexer {
 public:
  explicit Lexer(std::string_view text) : text_(text) {}
  /// The next token; at the end always `end`. \throws SelectionError if there is no valid token.
  Token next();

 private:
  Token quoted(char quote);
  Token number();
  Token sign();
  [[noreturn]] void fail(std::size_t offset, const std::string& problem) const;

  const std::string_view text_;
  std::size_t at_ = 0;
};

/// Describes a token for messages: `"lab"`, `the end`.
std::string describe(const Token& token, std::string_view text);

/// Converts a text that is one number. \return false if it is not, or not finite.
bool to_number(std::string_view text, double& number) noexcept;

}  // namespace iotcloud::discovery::internal
