#include <gtest/gtest.h>

#include <iotcloud/discovery/selection/selection.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

DriverRecord driver(std::map<std::string, std::string> metadata) {
  DriverRecord record;
  record.name = "turtle"_driver;
  record.instance = "3f2a9c"_instance;
  record.gateway = "lab1"_gateway;
  record.state = DriverState::active;
  record.metadata = std::move(metadata);
  return record;
}

bool chosen(std::string_view expression, std::map<std::string, std::string> metadata) {
  return Selection::parse(expression).matches(driver(std::move(metadata)));
}

TEST(Selection, ChoosesEveryDriverWithoutAnExpression) {
  EXPECT_TRUE(Selection().everything());
  EXPECT_TRUE(Selection().matches(driver({})));
  EXPECT_EQ(Selection().text(), "");
  EXPECT_FALSE(Selection::parse("a == 1").everything());
  EXPECT_EQ(Selection::parse(" a == 1").text(), " a == 1");
}

TEST(Selection, ComparesNumbersAsNumbers) {
  const std::map<std::string, std::string> nine{{"battery", "9"}};
  EXPECT_TRUE(chosen("battery < 20", nine));
  EXPECT_FALSE(chosen("battery > 20", nine));
  EXPECT_TRUE(chosen("battery == 9.0", nine));
  EXPECT_FALSE(chosen("battery != 9.0", nine));
  EXPECT_TRUE(chosen("battery <= 9 and battery >= 9", nine));
  EXPECT_FALSE(chosen("battery < 9 or battery > 9", nine));
  EXPECT_TRUE(chosen("t == -1.5e1", {{"t", "-15"}}));
  EXPECT_TRUE(chosen("t > -20", {{"t", "+15"}}));
  EXPECT_TRUE(chosen("t < .6", {{"t", ".5"}}));
}

TEST(Selection, ComparesWithTextInQuotesAsText) {
  const std::map<std::string, std::string> nine{{"version", "9"}};
  EXPECT_TRUE(chosen("version > \"20\"", nine));
  EXPECT_FALSE(chosen("version == '9.0'", nine));
  EXPECT_TRUE(chosen("version == '9'", nine));
  EXPECT_TRUE(chosen("site == \"say \\\"lab\\\" \\\\\"", {{"site", "say \"lab\" \\"}}));
  EXPECT_TRUE(chosen("site == 'Zürich'", {{"site", "Zürich"}}));
  EXPECT_TRUE(chosen("site == ''", {{"site", ""}}));
}

TEST(Selection, TakesWhatIsNoNumberForDifferentFromANumberAndNeitherMoreNorLess) {
  for (const char* text : {"full", "", "20%", "nan", "inf", "1e999", " 20", "0x14"}) {
    const std::map<std::string, std::string> metadata{{"battery", text}};
    EXPECT_FALSE(chosen("battery == 20", metadata)) << text;
    EXPECT_TRUE(chosen("battery != 20", metadata)) << text;
    EXPECT_FALSE(chosen("battery >= 20", metadata)) << text;
    EXPECT_FALSE(chosen("battery <= 20", metadata)) << text;
  }
}

TEST(Selection, KnowsTrueAndFalseAsTheirWords) {
  EXPECT_TRUE(chosen("charging == true", {{"charging", "true"}}));
  EXPECT_FALSE(chosen("charging == true", {{"charging", "false"}}));
  EXPECT_TRUE(chosen("charging != true", {{"charging", "false"}}));
}

TEST(Selection, LetsEveryConditionOnAMissingKeyFail) {
  for (const char* expression :
       {"battery == 1", "battery != 1", "battery < 1", "battery >= 1", "battery == 'a'", "battery != 'a'",
        "battery in [1]", "battery not in [1]", "exists(battery)", "starts_with(battery, '')", "ends_with(battery, '')",
        "contains(battery, '')", "within(location, 0, 0, 99999 km)", "within(position, 0, 0, 99999 km)"}) {
    EXPECT_FALSE(chosen(expression, {{"site", "lab"}})) << expression;
    EXPECT_TRUE(chosen(std::string("not ") + expression, {{"site", "lab"}})) << expression;
  }
  EXPECT_TRUE(chosen("not (exists(battery) and battery > 20)", {}));
}

TEST(Selection, FindsAValueInAList) {
  EXPECT_TRUE(chosen("site in ['lab', 'roof', 7]", {{"site", "roof"}}));
  EXPECT_TRUE(chosen("site in ['lab', 'roof', 7]", {{"site", "7.0"}}));
  EXPECT_FALSE(chosen("site in ['lab', 'roof', 7]", {{"site", "hall"}}));
  EXPECT_TRUE(chosen("site not in ['lab', 'roof']", {{"site", "hall"}}));
  EXPECT_FALSE(chosen("site not in ['lab', 'roof']", {{"site", "lab"}}));
}

TEST(Selection, BindsNotBeforeAndBeforeOr) {
  const std::map<std::string, std::string> one{{"a", "1"}};
  EXPECT_TRUE(chosen("a == 1 or a == 2 and a == 3", one));
  EXPECT_FALSE(chosen("(a == 1 or a == 2) and a == 3", one));
  EXPECT_TRUE(chosen("a == 3 and a == 2 or a == 1", one));
  EXPECT_FALSE(chosen("not a == 1 and a == 1", one));
  EXPECT_TRUE(chosen("not (a == 1 and a == 2)", one));
  EXPECT_TRUE(chosen("not not a == 1", one));
}

TEST(Selection, LooksIntoText) {
  const std::map<std::string, std::string> metadata{{"model", "turtle-2.1"}};
  EXPECT_TRUE(chosen("starts_with(model, 'turtle')", metadata));
  EXPECT_FALSE(chosen("starts_with(model, 'urtle')", metadata));
  EXPECT_TRUE(chosen("ends_with(model, '2.1')", metadata));
  EXPECT_FALSE(chosen("ends_with(model, '2.')", metadata));
  EXPECT_TRUE(chosen("contains(model, 'le-2')", metadata));
  EXPECT_FALSE(chosen("contains(model, 'Turtle')", metadata));
}

TEST(Selection, ReachesEveryKey) {
  EXPECT_TRUE(chosen("room.floor-2_b == 1", {{"room.floor-2_b", "1"}}));
  EXPECT_TRUE(chosen("`any key, 1` == 1", {{"any key, 1", "1"}}));
  EXPECT_TRUE(chosen("exists(`and`) and `in` == 1", {{"and", "1"}, {"in", "1"}}));
  EXPECT_TRUE(chosen("contains(`a\\`b`, 'x')", {{"a`b", "xyz"}}));
  EXPECT_TRUE(chosen("within == 1 and exists == 1", {{"within", "1"}, {"exists", "1"}}));
}

TEST(Selection, KnowsTheRecordsOwnFieldsByName) {
  EXPECT_TRUE(chosen("driver == 'turtle' and gateway == 'lab1' and instance == '3f2a9c' and state == 'active'", {}));
  EXPECT_FALSE(chosen("gateway == 'roof'", {{"gateway", "roof"}}));
  EXPECT_TRUE(chosen("`gateway` == 'roof'", {{"gateway", "roof"}}));
}

TEST(Selection, IgnoresWhiteSpaceBetweenWords) {
  EXPECT_TRUE(chosen("\n a\t==\r\n1\nand(b<2)and\nc in[ 1,2 ,3]", {{"a", "1"}, {"b", "1"}, {"c", "3"}}));
}

}  // namespace
}  // namespace iotcloud::discovery
