#include <array>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/drivers/testing/mock_host.h>

namespace iotcloud::drivers {
namespace {

using config::DeclaredProperty;
using config::problems_of;
using config::PropertyProblem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// Reads what it declares without a fallback, as an author may.
struct Station : Driver {
  static constexpr std::string_view description = "A \"station\"\non a roof \\";
  static constexpr std::array declared_properties{
      PropertySpec{.name = "rate",
                   .type = PropertyType::number,
                   .unit = "1/s",
                   .min = 0.125,
                   .max = 1000,
                   .default_value = "10",
                   .text = "readings a second"},
      PropertySpec{.name = "base", .type = PropertyType::integer, .min = -50, .max = 50, .default_value = "-7"},
      PropertySpec{.name = "loud", .type = PropertyType::flag, .default_value = "false"},
      PropertySpec{.name = "site", .required = true, .text = "where it stands"},
      PropertySpec{.name = "mode", .default_value = "fast", .choices = {"fast", "slow"}},
      PropertySpec{.name = "note"}};

  std::vector<ChannelSpec> channels(const PropertyMap&) override { return {}; }
  void open(DriverContext& context) override {
    read = std::to_string(context.number("rate")) + " " + std::to_string(context.integer("base")) + " " +
           (context.flag("loud") ? "loud" : "quiet") + " " + context.property("site") + " " + context.property("mode");
    if (context.property("site") == "nowhere") static_cast<void>(context.property("note"));
  }
  static inline std::string read;
};

struct Silent : Driver {
  std::vector<ChannelSpec> channels(const PropertyMap&) override { return {}; }
  void open(DriverContext&) override {}
};

struct Bare : Silent {
  static constexpr std::array<PropertySpec, 0> declared_properties{};
};

config::DriverDeclaration declared() {
  return config::declaration_of(describe<Station>("station", "1").declaration);
}

std::vector<PropertyProblem> problems(const PropertyMap& properties) {
  return problems_of(properties, declared());
}

TEST(Declaration, is_read_as_it_was_written) {
  const auto declaration = declared();
  EXPECT_EQ(declaration.description, "A \"station\"\non a roof \\");
  ASSERT_TRUE(declaration.properties);
  const auto property = [](std::string name, std::string type) {
    DeclaredProperty made;
    made.name = std::move(name);
    made.type = std::move(type);
    return made;
  };
  auto rate = property("rate", "number"), base = property("base", "integer"), loud = property("loud", "flag"),
       site = property("site", "text"), mode = property("mode", "text"), note = property("note", "text");
  rate.unit = "1/s", rate.min = 0.125, rate.max = 1000, rate.default_value = "10", rate.text = "readings a second";
  base.min = -50, base.max = 50, base.default_value = "-7";
  loud.default_value = "false";
  site.required = true, site.text = "where it stands";
  mode.default_value = "fast", mode.choices = {"fast", "slow"};
  EXPECT_THAT(*declaration.properties, ElementsAre(rate, base, loud, site, mode, note));
  EXPECT_EQ(config::parse_declaration(config::to_json(declaration)), declaration);
}

TEST(Declaration, a_driver_that_declares_nothing_takes_anything) {
  EXPECT_EQ(describe<Silent>("silent", "1").declaration, nullptr);
  EXPECT_THAT(problems_of({{"any", "thing"}}, config::declaration_of(nullptr)), IsEmpty());
}

TEST(Declaration, a_driver_that_declares_none_takes_none_but_the_host_s) {
  const auto bare = config::declaration_of(describe<Bare>("bare", "1").declaration);
  EXPECT_THAT(problems_of({{"channel.data.capacity", "5"}, {"hang_limit", "5s"}}, bare), IsEmpty());
  EXPECT_THAT(problems_of({{"any", "thing"}}, bare),
              ElementsAre(PropertyProblem{"any", "unknown property; this driver has none"}));
}

TEST(Declaration, all_problems_are_named_each_with_what_would_be_right) {
  EXPECT_THAT(problems({{"rat", "5"}, {"base", "7.5"}, {"loud", "yes"}, {"mode", "medium"}, {"zzzzzzzz", ""}}),
              ElementsAre(PropertyProblem{"base", "\"7.5\"; it takes a whole number from -50 to 50"},
                          PropertyProblem{"loud", "\"yes\"; it takes true or false"},
                          PropertyProblem{"mode", "\"medium\"; it takes one of fast, slow"},
                          PropertyProblem{"rat", "unknown property; did you mean \"rate\"?"},
                          PropertyProblem{"zzzzzzzz",
                                          "unknown property; this driver has rate, base, loud, site, mode, "
                                          "note"},
                          PropertyProblem{"site", "missing; it takes any text (where it stands)"}));
  EXPECT_THAT(problems({{"site", "roof"}, {"rate", "0.1"}}),
              ElementsAre(PropertyProblem{"rate", "\"0.1\"; it takes a number from 0.125 to 1000 (1/s)"}));
  for (const std::string wrong : {"", "1e400", "nan", "5x", " 5"})
    EXPECT_EQ(problems({{"site", "roof"}, {"rate", wrong}}).size(), 1U) << wrong;
  EXPECT_THAT(problems({{"site", ""}, {"rate", "1e2"}, {"base", "-50"}, {"loud", "true"}}), IsEmpty());
}

TEST(Declaration, is_found_in_a_plugin_s_bytes_behind_other_uses_of_the_mark) {
  const std::string mark = IOTCLOUD_DRIVER_DECLARATION_MARK, card = IOTCLOUD_DRIVER_CARD_MARK;
  const std::string zero(1, '\0');
  const auto found = config::declaration_in("\x7f" + mark + zero + mark + "{broken" + zero + mark +
                                            R"({"description":"x"})" + zero + card + zero + card +
                                            R"({"name":"n","version":"2"})" + zero + IOTCLOUD_DRIVER_SDK_MARK + "6;");
  EXPECT_EQ(found.description, "x");
  EXPECT_EQ(found.driver, "n");
  EXPECT_EQ(found.version, "2");
  EXPECT_EQ(found.sdk_version, 6U);
  EXPECT_FALSE(found.properties);
  EXPECT_EQ(config::declaration_in(mark + "{\"description\":\"no end\"}"), config::DriverDeclaration{});
}

TEST(Declaration, a_flood_of_marks_is_not_read_to_its_end) {
  const std::string card = R"(iotcloud-plugin: driver={"name":"meter","version":"2"})" + std::string(1, '\0');
  std::string flood;
  for (int i = 0; i < 99; ++i) flood += "iotcloud-plugin: driver={";
  EXPECT_EQ(config::declaration_in(flood + card).driver, "meter");
  EXPECT_EQ(config::declaration_in(flood + "iotcloud-plugin: driver={" + card).driver, "");
}

TEST(Declaration, hostile_text_counts_as_nothing) {
  for (const char* json : {"", "[]", "{", "{\"properties\":5}",
                           "{\"properties\":[5,{},{\"name\":\"a\",\"type\":\"b\"}]}", "{\"description\":{}}"}) {
    const auto declaration = config::declaration_of(json);
    EXPECT_EQ(declaration.description, "") << json;
    EXPECT_TRUE(!declaration.properties || declaration.properties->empty()) << json;
  }
}

TEST(Declaration, the_mock_checks_and_gives_the_declared_defaults) {
  testing::MockInstance wrong(describe<Station>("station", "1"), {{"rat", "5"}});
  EXPECT_FALSE(wrong.start());
  EXPECT_THAT(wrong.error(), AllOf(HasSubstr("property \"rat\": unknown property; did you mean \"rate\"?"),
                                   HasSubstr("property \"site\": missing")));
  testing::MockInstance station(describe<Station>("station", "1"), {{"site", "roof"}, {"loud", "true"}});
  ASSERT_TRUE(station.start()) << station.error();
  EXPECT_EQ(Station::read, "10.000000 -7 loud roof fast");
}

TEST(Declaration, a_driver_that_reads_what_has_no_value_fails_naming_it) {
  testing::MockInstance station(describe<Station>("station", "1"), {{"site", "nowhere"}});
  EXPECT_FALSE(station.start());
  EXPECT_THAT(station.error(), HasSubstr("property \"note\" is missing"));
}

}  // namespace
}  // namespace iotcloud::drivers
