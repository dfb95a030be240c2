#include <random>

#include <gtest/gtest.h>

#include <iotcloud/discovery/selection/selection.h>

namespace iotcloud::discovery {
namespace {

std::string message(std::string_view expression) {
  try {
    static_cast<void>(Selection::parse(expression));
  } catch (const SelectionError& error) {
    return error.what();
  }
  return "no error";
}

struct Wrong {
  const char* expression;
  int column;
  const char* expected;
};

TEST(SelectionErrors, PointAtTheCharacterAndSayWhatWasExpected) {
  for (const Wrong& wrong : std::vector<Wrong>{
           {"", 1, "expected a condition such as"},
           {"battery", 8, "expected ==, !=, <, <=, >, >=, in or not in, but the expression ends"},
           {"battery = 20", 9, "\"=\" is no comparison, write =="},
           {"battery > ", 11, "expected a number, a text in quotes, true or false, but the expression ends"},
           {"site == lab", 9, "but there is \"lab\"; write \"lab\" for a text"},
           {"site == \"lab", 9, "the closing \" is missing"},
           {"site == 'a\\n'", 11, "after a backslash"},
           {"20 < battery", 1, "the key stands on the left"},
           {"a == 1 b == 2", 8, "expected and, or, or the end, but there is \"b\""},
           {"a == 1 and", 11, "expected a condition"},
           {"a == 1 && b == 2", 8, "write and"},
           {"a == 1 || b == 2", 8, "write or"},
           {"!a", 1, "write not"},
           {"(a == 1", 8, "expected and, or, or \")\", but the expression ends"},
           {"a == 1)", 7, "there is \")\""},
           {"a in (1)", 6, "expected \"[\""},
           {"a in []", 7, "but there is \"]\""},
           {"a in [1,]", 9, "expected a number"},
           {"a not == 1", 7, "expected in, but there is \"==\""},
           {"exist(a)", 1, "there is no function \"exist\"; there are exists,"},
           {"exists('a')", 8, "expected a key, but there is the text \"a\""},
           {"exists(and)", 8, "expected a key, but there is \"and\""},
           {"starts_with(a, b)", 16, "expected a text in quotes"},
           {"within(place, 1, 2, 3 m)", 8, "expected location (latitude and longitude in degrees) or position"},
           {"within(location, 91, 0, 1 m)", 18, "the latitude in degrees, -90 to 90"},
           {"within(location, 0, 181, 1 m)", 21, "the longitude in degrees, -180 to 180"},
           {"within(location, 0, 0, 500)", 27, "the distance's unit, m or km"},
           {"within(location, 0, 0, 500 miles)", 28, "the distance's unit, m or km"},
           {"within(location, 0, 0, -5 m)", 24, "a distance such as 500 m or 2.5 km"},
           {"within(location, 0, 0)", 22, "expected \",\" and a distance"},
           {"a == 1.2.3", 6, "\"1.2.3\" is not a number"},
           {"a == 1e999", 6, "is not a number"},
           {"a == $b", 6, "\"$\" means nothing here"},
           {"ä == 1", 1, "beyond ASCII"},
           {"a == \"ä\" x", 10, "there is \"x\""},
           {"`` == 1", 1, "a key has at least one character"},
       }) {
    try {
      static_cast<void>(Selection::parse(wrong.expression));
      ADD_FAILURE() << wrong.expression << ": taken";
    } catch (const SelectionError& error) {
      EXPECT_EQ(error.column(), wrong.column) << error.what();
      EXPECT_NE(error.problem().find(wrong.expected), std::string::npos) << error.what();
    }
  }
}

TEST(SelectionErrors, ShowTheLineWithACaret) {
  EXPECT_EQ(message("site == lab and battery > 20"),
            "column 9: expected a number, a text in quotes, true or false, but there is \"lab\"; write \"lab\" for a "
            "text\n"
            "  site == lab and battery > 20\n"
            "          ^");
}

TEST(SelectionErrors, CountLinesOfExpressionsThatHaveSeveral) {
  EXPECT_EQ(message("site == 'lab'\n  and battery = 20\n  and a == 1"),
            "line 2, column 15: \"=\" is no comparison, write ==\n"
            "    and battery = 20\n"
            "                ^");
}

TEST(SelectionErrors, ShowOnlyTheNeighbourhoodInLongLines) {
  const std::string chain = [] {
    std::string text = "a == 1";
    for (int i = 0; i < 100; ++i) text += " and a == 1";
    return text;
  }();
  const std::string text = message(chain + " = 2 and " + chain);
  EXPECT_LT(text.size(), 400U);
  const std::size_t line = text.find('\n');
  const std::size_t caret = text.rfind('\n');
  EXPECT_EQ(text[line + (text.size() - caret) - 1], '=') << text;
}

TEST(SelectionErrors, RefuseWhatIsTooLongOrTooDeep) {
  EXPECT_NE(message(std::string(Selection::max_size + 1, ' ')).find("more than 4096 bytes"), std::string::npos);
  const std::string deep = std::string(64, '(') + "a == 1" + std::string(64, ')');
  EXPECT_EQ(message(deep), "no error");
  EXPECT_NE(message("(" + deep + ")").find("more than 64 parentheses"), std::string::npos);
  std::string nots;
  for (int i = 0; i < 65; ++i) nots += "not ";
  EXPECT_NE(message(nots + "a == 1").find("more than 64"), std::string::npos);
}

/// Any text is an expression that can be evaluated, or throws a SelectionError whose place is in the text.
void try_it(const std::string& text) {
  DriverRecord record;
  record.metadata = {{"a", "1"}, {"location", "39.17,-86.52"}, {"x", ""}};
  try {
    static_cast<void>(Selection::parse(text).matches(record));
  } catch (const SelectionError& error) {
    EXPECT_LE(error.offset(), text.size());
    EXPECT_GE(error.column(), 1);
    EXPECT_FALSE(error.problem().empty());
  }
}

TEST(SelectionErrors, AreAllThatHostileTextCanCause) {
  const std::vector<std::string> pieces{"a",        "b.c",      "and ",
                                        "or ",      "not ",     "in ",
                                        "(",        ")",        "[",
                                        "]",        ",",        "==",
                                        "!=",       "<",        ">=",
                                        "\"x\"",    "'y'",      "`k`",
                                        "1",        "-2.5",     " ",
                                        "\n",       "\\",       "within(",
                                        "location", "position", "m",
                                        "km",       "exists(",  "contains(",
                                        "\xc3\xa4", "\x80",     std::string(1, '\0')};
  std::mt19937 random(20261121);
  for (int round = 0; round < 2'000; ++round) {
    std::string text;
    for (auto count = random() % 24; count > 0; --count) text += pieces[random() % pieces.size()];
    try_it(text);
  }
  const std::string good = "site == \"lab\" and (battery > 20 or not a in [1, 'b']) and within(location, 1, 2, 5 m)";
  for (int round = 0; round < 2'000; ++round) {
    std::string text = good;
    for (auto count = 1 + random() % 3; count > 0; --count) text[random() % text.size()] = static_cast<char>(random());
    try_it(text.substr(0, random() % 8 == 0 ? random() % text.size() : text.size()));
  }
  std::string chain = "a<1";
  while (chain.size() + 6 <= Selection::max_size) chain += " or a<1";
  try_it(chain.substr(0, Selection::max_size));
}

}  // namespace
}  // namespace iotcloud::discovery
