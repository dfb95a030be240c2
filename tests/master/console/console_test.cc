// The console over its connections: what it shows to whom, who may log in, and what it tells live.
#include <fstream>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/master/console/audit_lines.h>
#include <iotcloud/master/console/console.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/rpc/raw_client.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::master {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;
using tests::RawClient;
using Json = nlohmann::json;

discovery::DriverRecord driver(const std::string& gateway, const std::string& instance, discovery::DriverState state) {
  discovery::DriverRecord record;
  record.name = discovery::DriverName("meter");
  record.gateway = discovery::GatewayId(gateway);
  record.instance = discovery::InstanceId(instance);
  record.state = state;
  return record;
}

/// What the console looks at, which the test sets.
class Fleet {
 public:
  void set(std::vector<discovery::DriverRecord> drivers) {
    const config::MutexLock lock(mutex_);
    drivers_ = std::move(drivers);
  }
  void set_page(std::string page) {
    const config::MutexLock lock(mutex_);
    page_ = std::move(page);
  }
  void set_carried(std::vector<CarriedByGateway> carried) {
    const config::MutexLock lock(mutex_);
    carried_ = std::move(carried);
  }
  void lose_the_registry(bool away) {
    const config::MutexLock lock(mutex_);
    away_ = away;
  }
  int looks() const {
    const config::MutexLock lock(mutex_);
    return looks_;
  }
  Live::Source source() {
    Live::Source source;
    source.status = [] {
      MasterStatus status;
      status.id = "m";
      status.leading = true;
      return status;
    };
    source.drivers = [this] {
      const config::MutexLock lock(mutex_);
      ++looks_;
      if (away_) throw config::Error("the registry is away");
      return drivers_;
    };
    source.gateways = [] {
      std::vector<discovery::GatewayStatus> gateways(2);
      gateways[0].record.id = discovery::GatewayId("g1");
      gateways[0].alive = true;
      gateways[1].record.id = discovery::GatewayId("g2");
      return gateways;
    };
    source.topologies = [] {
      std::vector<discovery::TopologyStatus> topologies(1);
      topologies[0].record.name = discovery::TopologyName("echo");
      topologies[0].workers.resize(1);
      topologies[0].workers[0].name = "w1";
      return topologies;
    };
    source.carried = [this] {
      const config::MutexLock lock(mutex_);
      if (away_) throw config::Error("the registry is away");
      return carried_;
    };
    source.worker_page = [this](const auto&, const auto&) {
      const config::MutexLock lock(mutex_);
      return page_;
    };
    return source;
  }

 private:
  mutable config::Mutex mutex_;
  std::vector<discovery::DriverRecord> drivers_ IOTCLOUD_GUARDED_BY(mutex_);
  std::string page_ IOTCLOUD_GUARDED_BY(mutex_) = R"({"tasks": [], "components": []})";
  bool away_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  int looks_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::vector<CarriedByGateway> carried_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// Stands in for the API.
class FakeCalls final : public ConsoleCalls {
 public:
  std::string authenticate(const ConsoleCaller&, const std::string& token) override {
    return token.starts_with("anna.") ? "" : "nobody's token";
  }
  std::string call(const ConsoleCaller& caller, const std::string& call, const std::string& json) override {
    if (call == "refused") throw config::Error("viewers may not do this");
    return Json{{"call", call}, {"json", json}, {"who", caller.holder ? caller.holder->name : "nobody"}}.dump();
  }
};

class ConsoleTest : public testing::Test {
 protected:
  void open(bool with_tokens = false) {
    Console::Options options;
    options.settings.pages.address = "127.0.0.1:0";
    options.settings.page_plugins.folders = {folder_.path()};
    options.id = "m";
    options.live.look = 5ms;
    options.live.pages = 10ms;
    options.live.sample = 20ms;
    options.live.beat = 20ms;
    options.live.remember = 20ms;
    options.live.remind = remind_;
    if (with_tokens) {
      token_ = security::add_token(folder_ / "tokens", "anna", security::Role::viewer);
      options.tokens = std::make_shared<security::TokenKeeper>(folder_ / "tokens");
      options.audit_file = folder_ / "audit.log";
    }
    console_.emplace(options, fleet_.source(), calls_);
  }
  std::string host() const { return console_->address(); }
  std::string ask(const std::string& method, const std::string& target, const std::string& headers = "",
                  const std::string& body = "") const {
    RawClient client(host());
    client.say(fmt::format("{} {} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Length: {}\r\n{}\r\n{}", method,
                           target, host(), body.size(), headers, body));
    return client.rest();
  }
  std::string post(const std::string& target, const std::string& body, const std::string& headers = "") const {
    return ask("POST", target,
               fmt::format("Origin: http://{}\r\nContent-Type: application/json\r\n{}", host(), headers), body);
  }
  /// Opens a stream of events.
  void listen(RawClient& client, const std::string& target, const std::string& headers = "") const {
    client.say(fmt::format("GET {} HTTP/1.1\r\nHost: {}\r\n{}\r\n", target, host(), headers));
  }
  /// The data of the next event of that name.
  static Json next(RawClient& client, const std::string& event) {
    client.until("event: " + event + "\ndata: ");
    return Json::parse(client.until("\n\n"), nullptr, false);
  }

  const tests::TemporaryFolder folder_;
  Fleet fleet_;
  std::chrono::milliseconds remind_{60'000};
  FakeCalls calls_;
  std::string token_;
  std::optional<Console> console_;
};

TEST_F(ConsoleTest, ServesItsPageWithAPolicyThatAllowsNoOtherScript) {
  open();
  const auto page = ask("GET", "/");
  EXPECT_THAT(page, AllOf(StartsWith("HTTP/1.1 200"),
                          HasSubstr("Content-Security-Policy: default-src 'none'; script-src 'self'"),
                          HasSubstr("X-Content-Type-Options: nosniff"), HasSubstr("<div id=\"page\">")));
  EXPECT_THAT(page, Not(AllOf(HasSubstr("<script>"), HasSubstr("style=")))) << "nothing inline";
  const auto tag = page.substr(page.find("ETag: ") + 6, 14);
  EXPECT_THAT(ask("GET", "/", "If-None-Match: " + tag + "\r\n"), StartsWith("HTTP/1.1 304"));
  EXPECT_THAT(ask("GET", "/../etc/passwd"), StartsWith("HTTP/1.1 404"));
}

TEST_F(ConsoleTest, RefusesWhatAnotherSitesPageAsks) {
  open();
  RawClient rebound(host());
  rebound.say("GET /api/me HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
  EXPECT_THAT(rebound.rest(), StartsWith("HTTP/1.1 403"));
  EXPECT_THAT(ask("POST", "/api/call/order", "Origin: http://evil.example\r\nContent-Type: application/json\r\n", "{}"),
              StartsWith("HTTP/1.1 403"));
  EXPECT_THAT(post("/api/call/order", "{}"), StartsWith("HTTP/1.1 200"));
}

TEST_F(ConsoleTest, PassesCallsOnAndTellsWhyOneIsRefused) {
  open();
  EXPECT_THAT(post("/api/call/history", R"({"most":1})"), HasSubstr(R"("call":"history","json":"{\"most\":1}")"));
  EXPECT_THAT(post("/api/call/refused", "{}"), AllOf(StartsWith("HTTP/1.1 400"), HasSubstr("viewers may not do this")));
}

TEST_F(ConsoleTest, WithTokensShowsNothingBeforeTheLogInAndNothingAfterTheLogOut) {
  open(true);
  EXPECT_THAT(ask("GET", "/api/me"), HasSubstr(R"("role":"anyone")"));
  for (const char* target : {"/api/live", "/api/instance?gateway=g1&instance=a", "/api/audit"})
    EXPECT_THAT(ask("GET", target), StartsWith("HTTP/1.1 401")) << target;
  EXPECT_THAT(post("/api/session", R"({"token":"bob.x"})"), StartsWith("HTTP/1.1 401"));
  const auto answer = post("/api/session", Json{{"token", token_}}.dump());
  ASSERT_THAT(answer, AllOf(StartsWith("HTTP/1.1 204"), HasSubstr("HttpOnly; SameSite=Strict")));
  const auto begin = answer.find("Set-Cookie: ") + 12;
  const auto cookie = "Cookie: " + answer.substr(begin, answer.find(';', begin) - begin) + "\r\n";
  EXPECT_THAT(ask("GET", "/api/me", cookie), AllOf(HasSubstr(R"("name":"anna")"), HasSubstr(R"("role":"viewer")")));
  EXPECT_THAT(post("/api/call/history", "{}", cookie), HasSubstr(R"("who":"anna")"));
  EXPECT_THAT(ask("GET", "/api/audit", cookie), StartsWith("HTTP/1.1 403")) << "who did what is not for viewers";
  RawClient live(host());
  listen(live, "/api/live", cookie);
  EXPECT_EQ(next(live, "state").at("instances"), 0);
  EXPECT_THAT(ask("DELETE", "/api/session", fmt::format("Origin: http://{}\r\n{}", host(), cookie)),
              StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(ask("GET", "/api/me", cookie), HasSubstr(R"("role":"anyone")"));
  EXPECT_THAT(live.rest(), HasSubstr("event: over")) << "an open page ends, too";
}

TEST_F(ConsoleTest, EndsASessionWhoseTokenIsTakenAway) {
  open(true);
  const auto answer = post("/api/session", Json{{"token", token_}}.dump());
  const auto begin = answer.find("Set-Cookie: ") + 12;
  const auto cookie = "Cookie: " + answer.substr(begin, answer.find(';', begin) - begin) + "\r\n";
  RawClient live(host());
  listen(live, "/api/live", cookie);
  next(live, "state");
  ASSERT_TRUE(security::remove_token(folder_ / "tokens", "anna"));
  EXPECT_THAT(live.rest(), HasSubstr("event: over"));
  EXPECT_THAT(ask("GET", "/api/me", cookie), HasSubstr(R"("role":"anyone")"));
}

TEST_F(ConsoleTest, TellsAllRowsFirstAndThenOnlyWhatHasChanged) {
  fleet_.set({driver("g1", "a", discovery::DriverState::active), driver("g1", "b", discovery::DriverState::active),
              driver("g2", "c", discovery::DriverState::active)});
  open();
  RawClient live(host());
  listen(live, "/api/live?rows=1");
  auto rows = next(live, "rows");
  EXPECT_TRUE(rows.at("reset"));
  EXPECT_EQ(rows.at("set").size(), 3u);
  auto failed = driver("g1", "b", discovery::DriverState::failed);
  failed.reason = "no device";
  fleet_.set({driver("g1", "a", discovery::DriverState::active), failed});
  rows = next(live, "rows");
  EXPECT_FALSE(rows.at("reset"));
  ASSERT_EQ(rows.at("set").size(), 1u);
  EXPECT_EQ(rows.at("set")[0].at("reason"), "no device");
  EXPECT_EQ(rows.at("gone"), Json::parse(R"([{"gateway":"g2","instance":"c"}])"));
}

TEST_F(ConsoleTest, TellsCountsAndWhatIsWrongAndWhyItCannotSee) {
  auto failed = driver("g1", "a", discovery::DriverState::failed);
  failed.reason = "no device";
  fleet_.set({failed, driver("g2", "b", discovery::DriverState::active)});
  open();
  RawClient live(host());
  listen(live, "/api/live");
  const auto state = next(live, "state");
  EXPECT_EQ(state.at("counts"), Json::parse(R"({"failed":1,"lost":1})")) << "g2 is lost";
  ASSERT_EQ(state.at("faults").size(), 2u);
  EXPECT_EQ(state.at("faults")[0].at("reason"), "no device");
  EXPECT_EQ(state.at("faults")[1].at("lost"), true);
  fleet_.lose_the_registry(true);
  EXPECT_EQ(next(live, "state").at("problem"), "the registry is away");
  fleet_.lose_the_registry(false);
  EXPECT_EQ(next(live, "state").at("problem"), "");
}

TEST_F(ConsoleTest, TellsARowThatIsSelectedNoLongerAsGone) {
  fleet_.set({driver("g1", "a", discovery::DriverState::active), driver("g1", "b", discovery::DriverState::failed)});
  open();
  EXPECT_THAT(ask("GET", "/api/live?check=1&where=state%20%3D"),
              AllOf(StartsWith("HTTP/1.1 400"), HasSubstr("\"error\"")));
  RawClient live(host());
  listen(live, "/api/live?rows=1&where=state%20%3D%3D%20%22active%22");
  const auto rows = next(live, "rows");
  ASSERT_EQ(rows.at("set").size(), 1u);
  EXPECT_EQ(rows.at("set")[0].at("instance"), "a");
  fleet_.set({driver("g1", "a", discovery::DriverState::inactive), driver("g1", "b", discovery::DriverState::failed)});
  EXPECT_EQ(next(live, "rows").at("gone"), Json::parse(R"([{"gateway":"g1","instance":"a"}])"));
}

TEST_F(ConsoleTest, GoesOnWhenReadersLeaveWhileItTellsThem) {
  open();
  for (int number = 0; number < 100; ++number) {
    RawClient leaves(host());
    listen(leaves, "/api/live?rows=1&topology=echo");
    next(leaves, "state");
    fleet_.set({driver("g1", std::to_string(number), discovery::DriverState::active)});
  }
  RawClient stays(host());
  listen(stays, "/api/live");
  EXPECT_EQ(next(stays, "state").at("instances"), 1);
}

TEST_F(ConsoleTest, LooksAtNothingWhenNobodyLooks) {
  open();
  EXPECT_EQ(fleet_.looks(), 0);
  {
    RawClient live(host());
    listen(live, "/api/live");
    next(live, "state");
  }
  int looks = 0;
  EXPECT_TRUE(
      tests::eventually([&] { return std::exchange(looks, fleet_.looks()) == fleet_.looks() && looks > 0; }, 120s));
}

TEST_F(ConsoleTest, TellsTuplesASecondAndTheirLatencyOfTheLastMoment) {
  const auto page = [](int emitted, int slow) {
    return Json{{"components", {{{"id", "s"}, {"kind", "spout"}}}},
                {"tasks",
                 {{{"component", "s"},
                   {"emitted", emitted},
                   {"complete", {{"count", emitted}, {"buckets", {{100.0, 1000}, {5000.0, slow}}}}}}}}}
        .dump();
  };
  fleet_.set_page(page(1000, 0));
  open();
  RawClient live(host());
  listen(live, "/api/live?topology=echo");
  EXPECT_EQ(next(live, "topology").at("pages")[0].at("tasks")[0].at("emitted"), 1000);
  fleet_.set_page(page(1500, 500));
  Json point;
  do {
    const auto points = next(live, "series").at("points");
    if (!points.empty()) point = points.back();
  } while (point.is_null() || point[1] == 0.0);
  EXPECT_EQ(point[2], 5000.0) << "of the new ones, not of all since the start";
  fleet_.set_page("<script>");
  Json shown;
  do shown = next(live, "topology");
  while (shown.at("problems").empty());
  EXPECT_THAT(shown.at("problems")[0].at("problem").get<std::string>(), HasSubstr("in JSON"));
}

TEST_F(ConsoleTest, TellsWhatDriversCarriedASecondAndHowSoonTheyWereAnswered) {
  const auto carried = [](const char* host, std::uint64_t sent, std::uint64_t received,
                          std::map<double, std::uint64_t> round_trips) {
    return CarriedByGateway{discovery::GatewayId("g1"), {host, 0ms, sent, received, std::move(round_trips)}};
  };
  fleet_.set_carried({carried("a", 1000, 500, {{2000.0, 500}}), carried("b", 70, 0, {})});
  open();
  RawClient live(host());
  listen(live, "/api/live");
  const auto moved = [&] {
    Json point;
    do {
      const auto points = next(live, "messages").at("points");
      if (!points.empty()) point = points.back();
    } while (point.is_null() || point[1] == 0.0);
    return point;
  };
  while (next(live, "messages").at("points").empty()) {  // it has asked twice
  }
  fleet_.set_carried({carried("a", 1400, 700, {{2000.0, 600}, {9000.0, 100}}), carried("b", 70, 0, {})});
  auto point = moved();
  EXPECT_DOUBLE_EQ(point[1].get<double>() / point[2].get<double>(), 2.0) << point;
  EXPECT_EQ(point[3], 9000.0) << "of the new ones, not of all since the start";
  fleet_.set_carried({carried("a", 3, 1, {{2000.0, 1}}), carried("b", 90, 0, {})});
  point = moved();
  EXPECT_EQ(point[2], 0.0) << "a host that began again counts from then on";
  EXPECT_TRUE(point[3].is_null());
  fleet_.lose_the_registry(true);
  do {
    const auto points = next(live, "messages").at("points");
    point = points.back();
  } while (!point[1].is_null());
  EXPECT_TRUE(point[2].is_null()) << "what is not known is no 0";
}

TEST_F(ConsoleTest, TellsWithinHowMuchTimeSomethingComesAgain) {
  open();
  RawClient live(host());
  listen(live, "/api/live");
  EXPECT_EQ(next(live, "beat"), Json::parse(R"({"ms":20})"));
}

TEST_F(ConsoleTest, AWorkerWhosePageCannotBeReadForAWhileIsNoJump) {
  const auto page = [](int emitted, int failed) {
    return Json{{"components", {{{"id", "s"}, {"kind", "spout"}}}},
                {"tasks", {{{"component", "s"}, {"emitted", emitted}, {"failed", failed}}}}}
        .dump();
  };
  fleet_.set_page(page(1'000'000, 70));
  open();
  RawClient live(host());
  listen(live, "/api/live?topology=echo");
  while (next(live, "series").at("points").empty()) {
  }
  fleet_.set_page("<script>");
  while (next(live, "topology").at("problems").empty()) {
  }
  fleet_.set_page(page(1'000'010, 70));
  Json point;
  do {
    const auto points = next(live, "series").at("points");
    if (!points.empty()) point = points.back();
  } while (point.is_null() || point[1] == 0.0);
  EXPECT_LT(point[1].get<double>(), 100'000) << "10 in some 20 ms, not a million";
  RawClient another(host());
  listen(another, "/api/live");
  EXPECT_EQ(next(another, "state").at("losses"), Json::array());
}

TEST_F(ConsoleTest, TellsAmongWhatIsWrongWhichComponentLosesTuplesUntilAWhileAfterTheLastOne) {
  const auto page = [](int late, int failed) {
    return Json{{"components", {{{"id", "s"}, {"kind", "spout"}}, {{"id", "b"}, {"kind", "bolt"}}}},
                {"tasks",
                 {{{"component", "s"}, {"emitted", 1000}, {"superseded", late}},
                  {{"component", "b"}, {"late", late}, {"failed", failed}},
                  {{"component", "b"}, {"late", 5}}}}}
        .dump();
  };
  fleet_.set_page(page(100, 7));
  remind_ = 300ms;
  open();
  RawClient live(host());
  listen(live, "/api/live");
  EXPECT_EQ(next(live, "state").at("losses"), Json::array()) << "what was lost before it looked is not told";
  while (next(live, "series").at("points").empty()) {
  }
  fleet_.set_page(page(130, 8));
  Json losses;
  do losses = next(live, "state").at("losses");
  while (losses.empty());
  ASSERT_EQ(losses.size(), 1u) << "what keep_last replaced is not lost";
  EXPECT_EQ(losses[0].at("topology"), "echo");
  EXPECT_EQ(losses[0].at("component"), "b");
  EXPECT_EQ(losses[0].at("counts"), Json::parse(R"({"late":30,"failed":1})"));
  do losses = next(live, "state").at("losses");
  while (!losses.empty());
}

TEST_F(ConsoleTest, TellsWhoMadeAnInstanceThatNobodyDeployed) {
  auto made = driver("g1", "b", discovery::DriverState::active);
  made.made_by = "rule cameras";
  fleet_.set({driver("g1", "a", discovery::DriverState::active), made});
  open();
  RawClient live(host());
  listen(live, "/api/live?rows=1");
  const auto rows = next(live, "rows").at("set");
  EXPECT_FALSE(rows[0].contains("made_by"));
  EXPECT_EQ(rows[1].at("made_by"), "rule cameras");
  EXPECT_THAT(ask("GET", "/api/instance?gateway=g1&instance=b"), HasSubstr(R"("made_by":"rule cameras")"));
}

TEST_F(ConsoleTest, TellsWhatComponentsHadCountedSomeTimeAgo) {
  const auto page = [](int emitted) {
    return Json{{"components", {{{"id", "s"}, {"kind", "spout"}}}},
                {"tasks",
                 {{{"component", "s"}, {"emitted", emitted}, {"failed", 1}},
                  {{"component", "s"}, {"emitted", emitted}, {"failed", 2}}}}}
        .dump();
  };
  fleet_.set_page(page(1000));
  open();
  RawClient live(host());
  listen(live, "/api/live?topology=echo");
  Json shown;
  do shown = next(live, "topology");
  while (shown.at("former").empty());
  EXPECT_EQ(shown.at("former")[0].at("span_ms"), 20);
  EXPECT_EQ(shown.at("former")[0].at("components").at("s").at("emitted"), 2000) << "of both tasks";
  EXPECT_EQ(shown.at("former")[0].at("components").at("s").at("failed"), 3);
  fleet_.set_page(page(1500));
  do shown = next(live, "topology");
  while (shown.at("pages")[0].at("tasks")[0].at("emitted") != 1500);
  EXPECT_EQ(shown.at("former")[0].at("components").at("s").at("emitted"), 2000) << "it was so some time ago";
  do shown = next(live, "topology");
  while (shown.at("former")[0].at("components").at("s").at("emitted") != 3000);
}

TEST_F(ConsoleTest, ShowsARecordWithoutItsPasswords) {
  auto one = driver("g1", "a", discovery::DriverState::active);
  one.channels.resize(1);
  one.channels[0].broker_url = "amqp://guest:secret@lab1";
  one.channels[0].properties = {{"password", "secret"}, {"exchange", "x"}};
  fleet_.set({one});
  open();
  const auto record = ask("GET", "/api/instance?gateway=g1&instance=a");
  EXPECT_THAT(record,
              AllOf(HasSubstr("amqp://guest:***@lab1"), HasSubstr(R"("exchange":"x")"), Not(HasSubstr("secret"))));
  EXPECT_THAT(ask("GET", "/api/instance?gateway=g1&instance=b"), StartsWith("HTTP/1.1 404"));
}

TEST_F(ConsoleTest, APageOfARobotIsForThoseWhoAreLoggedInAndHasAPolicyOfItsOwn) {
  std::ofstream(folder_ / "robot.js") << "// iotcloud page: {\"title\": \"Robot\", \"driver\": \"turtle\"}\n";
  open(true);
  for (const char* const target : {"/page/robot", "/api/pages"})
    EXPECT_THAT(ask("GET", target), AllOf(StartsWith("HTTP/1.1 401"), Not(HasSubstr("turtle")))) << target;
  open();
  EXPECT_THAT(ask("GET", "/api/pages"), HasSubstr(R"({"name":"robot","title":"Robot","driver":"turtle")"));
  const auto page = ask("GET", "/page/robot");
  EXPECT_THAT(page,
              AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("sandbox allow-scripts"), HasSubstr("script-src 'sha256-"),
                    Not(HasSubstr("script-src 'self'")), Not(HasSubstr("Set-Cookie"))));
  EXPECT_THAT(ask("GET", "/page/none"), AllOf(StartsWith("HTTP/1.1 400"), HasSubstr("there is no page")));
  EXPECT_THAT(ask("POST", "/page/robot"), StartsWith("HTTP/1.1 403"));
  EXPECT_THAT(ask("GET", "/"),
              HasSubstr("frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"));
}

TEST(AuditLines, AreTheLastOnesThatHaveTheText) {
  const tests::TemporaryFolder folder;
  const auto file = folder / "audit.log";
  std::ofstream(file) << R"({"number":1,"previous":"x","who":"anna","order":"start"})"
                      << "\n"
                      << R"({"number":2,"previous":"y","who":"bob","order":"stop"})"
                      << "\n"
                      << R"({"number":3,"previous":"z","who":"anna","order":"stop"})"
                      << "\n"
                      << R"({"number":4,"who)";
  const auto all = Json::parse(last_audit_lines(file, "", 2));
  EXPECT_EQ(all.at("more"), true);
  ASSERT_EQ(all.at("lines").size(), 2u);
  EXPECT_EQ(all.at("lines")[0], Json::parse(R"({"number":2,"who":"bob","order":"stop"})"));
  EXPECT_EQ(Json::parse(last_audit_lines(file, "anna", 9)).at("lines").size(), 2u);
  EXPECT_THROW(last_audit_lines(folder / "none", "", 9), config::Error);
}

}  // namespace
}  // namespace iotcloud::master
