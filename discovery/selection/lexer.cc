#include <cmath>

#include <iotcloud/config/number.h>
#include <iotcloud/discovery/selection/lexer.h>
#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery::internal {
namespace {

bool is_space(char c) {
  return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}
bool is_digit(char c) {
  return c >= '0' && c <= '9';
}
bool begins_word(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}
bool continues_word(char c) {
  return begins_word(c) || is_digit(c) || c == '.' || c == '-';
}
bool is_control(char c) {
  return static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
}

}  // namespace

bool to_number(std::string_view text, double& number) noexcept {
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto found = config::parse_number<double>(text);
  number = found.value_or(number);
  return found && std::isfinite(*found);
}

std::string describe(const Token& token, std::string_view text) {
  if (token.kind == TokenKind::end) return "the expression ends";
  std::size_t size = 1;
  if (token.kind == TokenKind::word || token.kind == TokenKind::number) {
    while (token.offset + size < text.size() && continues_word(text[token.offset + size])) ++size;
  } else if (token.kind == TokenKind::text || token.kind == TokenKind::key) {
    return (token.kind == TokenKind::text ? "there is the text \"" : "there is the key \"") + token.text + "\"";
  } else if (token.kind != TokenKind::open && token.offset + 1 < text.size() && text[token.offset + 1] == '=') {
    size = 2;
  }
  return "there is \"" + std::string(text.substr(token.offset, size)) + "\"";
}

void Lexer::fail(std::size_t offset, const std::string& problem) const {
  throw SelectionError(text_, offset, problem);
}

Token Lexer::next() {
  while (at_ < text_.size() && is_space(text_[at_])) ++at_;
  Token token;
  token.offset = at_;
  if (at_ == text_.size()) return token;
  const char c = text_[at_];
  if (c == '"' || c == '\'' || c == '`') return quoted(c);
  const bool digit_follows = at_ + 1 < text_.size() && (is_digit(text_[at_ + 1]) || text_[at_ + 1] == '.');
  if (is_digit(c) || ((c == '-' || c == '+' || c == '.') && digit_follows)) return number();
  if (!begins_word(c)) return sign();
  while (at_ < text_.size() && continues_word(text_[at_])) ++at_;
  token.kind = TokenKind::word;
  token.text = text_.substr(token.offset, at_ - token.offset);
  return token;
}

Token Lexer::quoted(char quote) {
  Token token;
  token.kind = quote == '`' ? TokenKind::key : TokenKind::text;
  token.offset = at_++;
  for (; at_ < text_.size() && text_[at_] != quote; ++at_) {
    if (text_[at_] == '\\' && at_ + 1 < text_.size()) {
      const char escaped = text_[++at_];
      if (escaped != quote && escaped != '\\') {
        fail(at_ - 1, std::string("after a backslash ") + quote + " or another backslash is expected");
      }
    }
    token.text += text_[at_];
  }
  if (at_ == text_.size()) fail(token.offset, std::string("the closing ") + quote + " is missing");
  ++at_;
  if (token.kind == TokenKind::key && token.text.empty()) fail(token.offset, "a key has at least one character");
  return token;
}

Token Lexer::number() {
  Token token;
  token.kind = TokenKind::number;
  token.offset = at_;
  const auto is_sign = [](char c) { return c == '-' || c == '+'; };
  if (is_sign(text_[at_])) ++at_;
  while (at_ < text_.size() && (is_digit(text_[at_]) || text_[at_] == '.')) ++at_;
  if (at_ < text_.size() && (text_[at_] == 'e' || text_[at_] == 'E')) {
    const std::size_t first = at_ + 1 < text_.size() && is_sign(text_[at_ + 1]) ? at_ + 2 : at_ + 1;
    if (first < text_.size() && is_digit(text_[first])) {
      for (at_ = first; at_ < text_.size() && is_digit(text_[at_]);) ++at_;
    }
  }
  const std::string_view digits = text_.substr(token.offset, at_ - token.offset);
  if (!to_number(digits, token.number)) fail(token.offset, "\"" + std::string(digits) + "\" is not a number");
  return token;
}

Token Lexer::sign() {
  const auto follows = [&](char c) { return at_ + 1 < text_.size() && text_[at_ + 1] == c; };
  Token token;
  token.offset = at_;
  const auto one = [&](TokenKind kind) {
    token.kind = kind;
    ++at_;
    return token;
  };
  const auto two = [&](TokenKind kind) {
    token.kind = kind;
    at_ += 2;
    return token;
  };
  switch (text_[at_]) {
    case '(':
      return one(TokenKind::open);
    case ')':
      return one(TokenKind::close);
    case '[':
      return one(TokenKind::open_list);
    case ']':
      return one(TokenKind::close_list);
    case ',':
      return one(TokenKind::comma);
    case '<':
      return follows('=') ? two(TokenKind::less_equal) : one(TokenKind::less);
    case '>':
      return follows('=') ? two(TokenKind::greater_equal) : one(TokenKind::greater);
    case '=':
      if (!follows('=')) fail(at_, "\"=\" is no comparison, write ==");
      return two(TokenKind::equal);
    case '!':
      if (!follows('=')) fail(at_, "\"!\" is no operator, write not");
      return two(TokenKind::not_equal);
    case '&':
      fail(at_, "\"&\" is no operator, write and");
    case '|':
      fail(at_, "\"|\" is no operator, write or");
    default:
      break;
  }
  const char c = text_[at_];
  if (is_control(c)) fail(at_, "a control character stands here");
  if (static_cast<unsigned char>(c) >= 0x80) {
    fail(at_, "letters beyond ASCII stand in quotes only: \"text\", or `key` for a key");
  }
  fail(at_, std::string("\"") + c + "\" means nothing here");
}

}  // namespace iotcloud::discovery::internal
