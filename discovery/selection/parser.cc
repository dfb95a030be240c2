#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include <iotcloud/discovery/selection/lexer.h>
#include <iotcloud/discovery/selection/program.h>

namespace iotcloud::discovery::internal {
namespace {

using Program = Selection::Program;
using Kind = Program::Kind;

constexpr double radians = std::numbers::pi / 180;

constexpr const char* literal_wanted = "a number, a text in quotes, true or false";
constexpr const char* condition_wanted =
    "a condition such as battery > 20, exists(battery) or within(location, 39.17, -86.52, 500 m)";

std::optional<Kind> comparison(TokenKind kind) {
  switch (kind) {
    case TokenKind::equal:
      return Kind::equal;
    case TokenKind::not_equal:
      return Kind::not_equal;
    case TokenKind::less:
      return Kind::less;
    case TokenKind::less_equal:
      return Kind::less_equal;
    case TokenKind::greater:
      return Kind::greater;
    case TokenKind::greater_equal:
      return Kind::greater_equal;
    default:
      return std::nullopt;
  }
}

bool is_keyword(std::string_view word) {
  for (const char* keyword : {"and", "or", "not", "in", "true", "false"}) {
    if (word == keyword) return true;
  }
  return false;
}

/// A recursive descent parser: one pass, one function for each rule, one token of look-ahead.
class Parser {
 public:
  explicit Parser(std::string_view text) : text_(text), lexer_(text) {
    program_.text = text;
    token_ = lexer_.next();
  }

  Program parse() {
    any();
    if (token_.kind != TokenKind::end) fail_here("and, or, or the end");
    return std::move(program_);
  }

 private:
  /// any = all { "or" all }
  std::uint32_t any() {
    std::uint32_t left = all();
    while (takes("or")) left = add(Kind::any_of, left, all());
    return left;
  }

  /// all = one { "and" one }
  std::uint32_t all() {
    std::uint32_t left = one();
    while (takes("and")) left = add(Kind::all_of, left, one());
    return left;
  }

  /// one = "not" one | "(" any ")" | function | key comparison
  std::uint32_t one() {
    const std::size_t here = token_.offset;
    if (takes("not")) {
      const Deeper deeper(*this, here);
      const std::uint32_t inner = one();
      return add(Kind::none_of, inner, inner);
    }
    if (token_.kind == TokenKind::open) {
      const Deeper deeper(*this, here);
      take();
      const std::uint32_t inner = any();
      expect(TokenKind::close, "and, or, or \")\"");
      return inner;
    }
    if (token_.kind == TokenKind::text || token_.kind == TokenKind::number || at_word("true") || at_word("false")) {
      fail_here("a key: the key stands on the left of a comparison");
    }
    if (token_.kind == TokenKind::key) return compare(key());
    if (token_.kind != TokenKind::word || is_keyword(token_.text)) fail_here(condition_wanted);
    const Token word = take();
    if (token_.kind == TokenKind::open) return function(word);
    return compare(key_of(word));
  }

  std::uint32_t function(const Token& name) {
    take();
    std::uint32_t made = 0;
    if (name.text == "exists") {
      made = add_condition(Kind::exists, key(), 0, 0);
    } else if (name.text == "starts_with" || name.text == "ends_with" || name.text == "contains") {
      made = text_function(name.text == "starts_with" ? Kind::starts_with
                           : name.text == "ends_with" ? Kind::ends_with
                                                      : Kind::contains);
    } else if (name.text == "within") {
      made = within();
    } else {
      fail(name.offset,
           "there is no function \"" + name.text + "\"; there are exists, starts_with, ends_with, contains and within");
    }
    expect(TokenKind::close, "\")\"");
    return made;
  }

  std::uint32_t text_function(Kind kind) {
    Program::Key of = key();
    expect(TokenKind::comma, "\",\"");
    if (token_.kind != TokenKind::text) fail_here("a text in quotes");
    const std::uint32_t first = literal();
    return add_condition(kind, std::move(of), first, first + 1);
  }

  /// within(location, latitude, longitude, distance) or within(position, x, y, distance)
  std::uint32_t within() {
    const bool sphere = at_word("location");
    if (!sphere && !at_word("position")) {
      fail_here("location (latitude and longitude in degrees) or position (x and y in metres)");
    }
    take();
    Program::Circle circle;
    if (sphere) {
      circle.first = radians * coordinate("the latitude in degrees, -90 to 90", 90);
      circle.second = radians * coordinate("the longitude in degrees, -180 to 180", 180);
      circle.cosine = std::cos(circle.first);
    } else {
      circle.first = coordinate("x in metres", HUGE_VAL);
      circle.second = coordinate("y in metres", HUGE_VAL);
    }
    expect(TokenKind::comma, "\",\" and a distance");
    circle.radius = distance();
    program_.circles.push_back(circle);
    const auto index = static_cast<std::uint32_t>(program_.circles.size() - 1);
    return add_condition(sphere ? Kind::within_location : Kind::within_position, {}, index, index + 1);
  }

  double coordinate(const std::string& what, double limit) {
    expect(TokenKind::comma, "\",\" and " + what);
    if (token_.kind != TokenKind::number || std::abs(token_.number) > limit) fail_here(what);
    return take().number;
  }

  double distance() {
    if (token_.kind != TokenKind::number || token_.number < 0) fail_here("a distance such as 500 m or 2.5 km");
    const double number = take().number;
    const double unit = at_word("m") ? 1 : at_word("km") ? 1000 : 0;
    if (unit == 0) fail_here("the distance's unit, m or km");
    take();
    return number * unit;
  }

  std::uint32_t compare(Program::Key of) {
    if (const auto kind = comparison(token_.kind)) {
      take();
      const std::uint32_t first = literal();
      return add_condition(*kind, std::move(of), first, first + 1);
    }
    const bool negated = takes("not");
    if (!takes("in")) fail_here(negated ? "in" : "==, !=, <, <=, >, >=, in or not in");
    expect(TokenKind::open_list, "\"[\"");
    const std::uint32_t first = literal();
    while (token_.kind == TokenKind::comma) {
      take();
      literal();
    }
    expect(TokenKind::close_list, "\",\" or \"]\"");
    return add_condition(negated ? Kind::not_in : Kind::in, std::move(of), first,
                         static_cast<std::uint32_t>(program_.literals.size()));
  }

  std::uint32_t literal() {
    Program::Literal made;
    if (token_.kind == TokenKind::number) {
      made.is_number = true;
      made.number = token_.number;
    } else if (token_.kind == TokenKind::text || at_word("true") || at_word("false")) {
      made.text = token_.text;
    } else if (token_.kind == TokenKind::word && !is_keyword(token_.text)) {
      fail_here(literal_wanted, "; write \"" + token_.text + "\" for a text");
    } else {
      fail_here(literal_wanted);
    }
    take();
    program_.literals.push_back(std::move(made));
    return static_cast<std::uint32_t>(program_.literals.size() - 1);
  }

  Program::Key key() {
    if (token_.kind == TokenKind::key) return {Program::Source::metadata, take().text};
    if (token_.kind != TokenKind::word || is_keyword(token_.text)) fail_here("a key");
    return key_of(take());
  }

  static Program::Key key_of(const Token& word) {
    if (word.text == "driver") return {Program::Source::driver, ""};
    if (word.text == "gateway") return {Program::Source::gateway, ""};
    if (word.text == "instance") return {Program::Source::instance, ""};
    if (word.text == "state") return {Program::Source::state, ""};
    return {Program::Source::metadata, word.text};
  }

  std::uint32_t add(Kind kind, std::uint32_t left, std::uint32_t right) {
    program_.nodes.push_back({kind, left, right, {}});
    return static_cast<std::uint32_t>(program_.nodes.size() - 1);
  }
  std::uint32_t add_condition(Kind kind, Program::Key of, std::uint32_t first, std::uint32_t last) {
    program_.nodes.push_back({kind, first, last, std::move(of)});
    return static_cast<std::uint32_t>(program_.nodes.size() - 1);
  }

  bool at_word(std::string_view word) const { return token_.kind == TokenKind::word && token_.text == word; }
  bool takes(std::string_view word) {
    if (!at_word(word)) return false;
    take();
    return true;
  }
  Token take() { return std::exchange(token_, lexer_.next()); }
  void expect(TokenKind kind, const std::string& what) {
    if (token_.kind != kind) fail_here(what);
    take();
  }

  [[noreturn]] void fail(std::size_t offset, const std::string& problem) const {
    throw SelectionError(text_, offset, problem);
  }
  [[noreturn]] void fail_here(const std::string& expected, const std::string& hint = "") const {
    fail(token_.offset, "expected " + expected + ", but " + describe(token_, text_) + hint);
  }

  struct Deeper {
    Deeper(Parser& of, std::size_t offset) : parser(of) {
      if (++parser.depth_ > Selection::max_depth) {
        parser.fail(offset, "more than " + std::to_string(Selection::max_depth) +
                                " parentheses and nots stand within each other");
      }
    }
    ~Deeper() { --parser.depth_; }
    Deeper(const Deeper&) = delete;
    Deeper& operator=(const Deeper&) = delete;
    Parser& parser;
  };

  const std::string_view text_;
  Lexer lexer_;
  Token token_;
  Program program_;
  int depth_ = 0;
};

}  // namespace

Selection::Program compile(std::string_view text) {
  if (text.size() > Selection::max_size) {
    throw SelectionError(text.substr(0, Selection::max_size), 0,
                         "the expression has more than " + std::to_string(Selection::max_size) + " bytes");
  }
  return Parser(text).parse();
}

}  // namespace iotcloud::discovery::internal
