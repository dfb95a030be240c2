// A topology is seen from a machine that does not reach its workers: the master reads their pages.
#include <algorithm>
#include <atomic>
#include <fstream>
#include <mutex>
#include <optional>
#include <thread>

#include <gmock/gmock.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/config/exposure.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/master/cli/topology/worker_pages.h>
#include <iotcloud/rpc/http/http_server.h>
#include <iotcloud/security/tokens.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr const char* page = R"({"topology": "echo", "worker": "w1", "active": true, "components":
  [{"id": "in", "kind": "spout", "parallelism": 3, "tasks": 4, "inputs": [], "streams": {"default": ["f"]}}], "tasks": [],
  "arrivals": [{"component": "in", "age_s": 1.25, "backlog": 90, "topic": "g.d.one.up", "most": 70},
               {"component": "other", "age_s": null, "backlog": null, "topic": "", "most": 0}],
  "troubles": [{"component": "in", "text": "its topics differ"}]})";
/// The same with a task that has emitted so many tuples, and failed so many with an error.
std::string page_after(int emitted, int errors) {
  constexpr const char* latency = R"({"count": 0, "p50_us": 0, "p99_us": 0, "max_us": 0})";
  auto text = nlohmann::json::parse(page);
  auto& task = text["tasks"].emplace_back(nlohmann::json{
      {"component", "in"}, {"task", 1}, {"capacity", 0.5}, {"last_error", errors > 0 ? "no depth" : ""}});
  for (const char* count : {"transferred", "executed", "acked", "failed", "timed_out", "late", "superseded", "errors",
                            "queue_depth", "pending"})
    task[count] = 0;
  for (const char* name : {"execute", "process", "complete"}) task[name] = nlohmann::json::parse(latency);
  task["emitted"] = emitted;
  task["errors"] = errors;
  return text.dump();
}
constexpr const char* samples = R"({"samples": [{"time_ms": 5, "task": 7, "source": "in", "stream": "default",
  "fields": {"f": "far away"}}], "missed": 0})";

rpc::HttpHandler answers(std::string text) {
  return [text = std::move(text)](const auto&) { return rpc::HttpAnswer{200, "application/json", text}; };
}

/// A worker whose pages ask for TLS and a token, so that the CLI reads them by way of the master.
class CliOfAFarWorker : public Cli {
 protected:
  CliOfAFarWorker() : token_(security::add_token(folder_ / "pages", "masters", security::Role::viewer)) {
    certificates_.authority().certify_host("master");
    std::ofstream(folder_ / "token") << token_ << '\n';
    pages_.emplace(rpc::PageSettings{"0.0.0.0:0", certificates_.of("lab1"), folder_ / "pages"},
                   std::map<std::string, rpc::HttpHandler>{
                       {"/topology",
                        [this](const auto&) {
                          if (growth_ > 0)
                            return rpc::HttpAnswer{200, "application/json", page_after(emitted_ += growth_, errors_)};
                          return rpc::HttpAnswer{200, "application/json", page + std::string(padding_, ' ')};
                        }},
                       {"/tap", answers(samples)},
                       {"/metrics", answers("not for all")},
                       {"/healthz", [this](const auto&) {
                          return rpc::HttpAnswer{well_ ? 200 : 503, "text/plain", "it is so\n"};
                        }}});
    const std::string address = pages_->address();
    port_ = address.substr(address.rfind(':'));
    worker_.name = "w1";
    worker_.host = config::host_name();  // loopback is this machine's
    worker_.state = "active";
    worker_.http = "localhost" + port_;
    worker_.tls = true;
    serve({certificates_.of("master"), folder_ / "token"});
  }

  /// Serves the API anew, with what the master shows to workers.
  void serve(WorkerAccess workers) {
    ApiAccess access;
    access.workers = std::move(workers);
    rpc::ThriftServerOptions listen;
    listen.port = 0;
    server.reset();
    server.emplace(listen, serve_api(**master, std::move(access)));
  }
  void show_worker() {
    auto& registry = master->registry();
    const discovery::Paths paths;
    discovery::TopologyRecord record;
    record.name = "echo"_topology;
    discovery::put(registry, paths.topology("echo"_topology), encode(record));
    node_ = registry.hold(paths.workers("echo"_topology) + "/w1", encode(worker_));
  }
  /// Why the worker is not seen. No answer has the master's token.
  std::string complaint() {
    const auto done = run({"topology", "metrics", "echo"});
    EXPECT_EQ(done.status, 1) << done.out;
    EXPECT_THAT(done.out + done.err, Not(HasSubstr(token_)));
    return done.err;
  }

  const security::test::Certificates certificates_;
  const tests::TemporaryFolder folder_;
  const std::string token_;
  std::atomic<bool> well_ = true;
  std::atomic<std::size_t> padding_ = 0;  ///< bytes that follow the page
  std::atomic<int> growth_ = 0;           ///< tuples that its task emits from one look at its page to the next
  std::atomic<int> emitted_ = 0;
  std::atomic<int> errors_ = 0;
  std::optional<rpc::HttpServer> pages_;
  std::string port_;  ///< ":12345"
  discovery::WorkerRecord worker_;
  discovery::GuardPtr node_;
};

TEST_F(CliOfAFarWorker, ShowsMetersAndTapsItByWayOfTheMaster) {
  show_worker();
  EXPECT_EQ(run_json({"topology", "show", "echo"})["components"][0]["parallelism"], 3);
  EXPECT_EQ(run_json({"topology", "show", "echo"})["troubles"][0]["text"], "its topics differ");
  EXPECT_THAT(run({"topology", "show", "echo"}).out, AllOf(HasSubstr("TROUBLE"), HasSubstr("its topics differ")));
  EXPECT_EQ(run_json({"topology", "show", "echo"})["arrivals"][0]["backlog"], 90);
  EXPECT_THAT(run({"topology", "show", "echo"}).out,
              AllOf(testing::ContainsRegex("AGE AT ARRIVAL +WAITING AT BROKERS"),
                    testing::ContainsRegex("in +w1 +1\\.250 s +90 +70 in g\\.d\\.one\\.up"),
                    testing::ContainsRegex("other +w1 +- +- +-")));
  EXPECT_EQ(run_json({"topology", "metrics", "echo"})["workers"], 1);
  const auto tapped = run({"topology", "tap", "echo", "in", "--count", "1"});
  EXPECT_EQ(tapped.status, 0) << tapped.err;
  EXPECT_THAT(tapped.out, AllOf(HasSubstr("task 7 in/default"), HasSubstr("far away")));
}

TEST_F(CliOfAFarWorker, RatesSayHowFastACounterGrows) {
  growth_ = 50;
  show_worker();
  const auto sum = [](const nlohmann::json& metrics) { return metrics["components"][0]["sum"]; };
  EXPECT_FALSE(sum(run_json({"topology", "metrics", "echo"})).contains("rate")) << "one look shows no rate";
  const auto rated = sum(run_json({"topology", "metrics", "echo", "--rates"}));
  EXPECT_EQ(rated["emitted"], 150) << "the third look";
  EXPECT_GT(rated["rate"]["emitted"], 0);
  EXPECT_LE(rated["rate"]["emitted"], 50) << "it grew by 50 in a second or more";
  EXPECT_EQ(rated["rate"]["executed"], 0);
  EXPECT_THAT(run({"topology", "metrics", "echo", "--rates"}).out,
              AllOf(HasSubstr("EMITS/S"), testing::ContainsRegex("in +all +[1-9][0-9]*\\.[0-9] +0\\.0 +250 ")));
}

TEST_F(CliOfAFarWorker, ErrorsAreListedByTask) {
  growth_ = 1;
  show_worker();
  EXPECT_EQ(run_json({"topology", "errors", "echo"}), nlohmann::json::array());
  errors_ = 3;
  const auto errors = run_json({"topology", "errors", "echo"});
  ASSERT_EQ(errors.size(), 1U);
  EXPECT_EQ(errors[0],
            (nlohmann::json{{"component", "in"}, {"worker", "w1"}, {"task", 1}, {"errors", 3}, {"error", "no depth"}}));
  EXPECT_THAT(run({"topology", "errors", "echo"}).out, testing::ContainsRegex("in +w1 +1 +3 +no depth"));
}

TEST_F(CliOfAFarWorker, SaysHowAWorkerIsMadeToBeSeenFromElsewhere) {
  worker_.host = "far";
  worker_.tls = false;
  show_worker();
  EXPECT_THAT(complaint(), AllOf(HasSubstr("worker w1 is on far"), HasSubstr("metrics: {address, tls, tokens}")));
}

TEST_F(CliOfAFarWorker, AsksNobodyOnLoopbackForAWorkerOfAnotherMachine) {
  worker_.host = "far";
  show_worker();
  EXPECT_THAT(complaint(), HasSubstr("worker w1 is on far and shows its pages there only"));
}

TEST_F(CliOfAFarWorker, AsksNobodyWhoseCertificateHasAnotherNameThanTheRecord) {
  worker_.http = "127.0.0.2" + port_;
  show_worker();
  EXPECT_THAT(complaint(), AllOf(HasSubstr("127.0.0.2"), HasSubstr("certificate verify failed")));
}

TEST_F(CliOfAFarWorker, SaysWhatTheMasterLacks) {
  show_worker();
  serve({});
  EXPECT_THAT(complaint(), HasSubstr("this master has no certificate"));
  serve({certificates_.of("master"), ""});
  EXPECT_THAT(complaint(), HasSubstr("worker_token_file"));
  std::ofstream(folder_ / "another") << "masters.0123456789\n";
  serve({certificates_.of("master"), folder_ / "another"});
  EXPECT_THAT(complaint(), HasSubstr("Authorization: Bearer"));
}

TEST_F(CliOfAFarWorker, TakesNoPageThatIsTooLargeForTheMaster) {
  padding_ = 9U << 20U;
  show_worker();
  EXPECT_THAT(complaint(), HasSubstr("body limit exceeded"));
}

TEST_F(CliOfAFarWorker, ReadsNoOtherPageOfIt) {
  show_worker();
  cli::MasterClient client({address()}, {}, std::chrono::milliseconds(1000));
  EXPECT_THAT(client.worker_page("echo"_topology, "w1", "/tap?id=a&component=in%20b"), HasSubstr("far away"));
  const std::string smuggled = "/tap? HTTP/1.1\r\nHost: lab1\r\n\r\nGET /metrics";
  for (const auto& target : {std::string("/metrics"), std::string("/tap"), std::string("/topology?a=b"), smuggled,
                             "/tap?id=" + std::string(3'000, 'a')}) {
    EXPECT_THAT([&] { client.worker_page("echo"_topology, "w1", target); },
                testing::ThrowsMessage<cli::RequestFailed>(HasSubstr("is not read here")));
  }
  EXPECT_THAT([&] { client.worker_page("echo"_topology, "w2", "/topology"); },
              testing::ThrowsMessage<cli::RequestFailed>(HasSubstr("has no worker w2")));
  EXPECT_THAT([&] { client.worker_page("ehco"_topology, "w1", "/topology"); },
              testing::ThrowsMessage<cli::RequestFailed>(HasSubstr("no topology \"ehco\"")));
}

/// A worker that shows its pages on this machine only, without TLS.
class CliOfAWorkerHere : public CliOfAFarWorker {
 protected:
  void show_worker_at(const std::string& address) {
    worker_.http = address;
    worker_.tls = false;
    show_worker();
  }
};

/// A page that breaks its first connection, as one that not everybody on this machine reaches (from another network
/// namespace, say), and answers all later ones. Thread safe.
class PageAtTheSecondTry {
 public:
  explicit PageAtTheSecondTry(const std::string& text)
      : answer_("HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: " + std::to_string(text.size()) + "\r\n\r\n" +
                text),
        thread_([this] { serve(); }) {}
  ~PageAtTheSecondTry() {
    shutdown(listener_.socket(), SHUT_RDWR);
    thread_.join();
  }
  std::string address() const { return "127.0.0.1:" + std::to_string(listener_.port()); }
  /// What was asked for and answered.
  std::vector<std::string> targets() {
    const std::lock_guard lock(mutex_);
    return targets_;
  }

 private:
  void answer(int client) {
    std::string request(4096, '\0');
    const auto size = recv(client, request.data(), request.size(), 0);
    if (size <= 0) return;
    {
      const std::lock_guard lock(mutex_);
      const auto begin = request.find(' ') + 1;
      targets_.push_back(request.substr(begin, request.find(' ', begin) - begin));
    }
    send(client, answer_.data(), answer_.size(), MSG_NOSIGNAL);
  }
  void serve() {
    for (bool first = true;; first = false) {
      const int client = listener_.accept();
      if (client < 0) return;
      if (!first) answer(client);
      close(client);
    }
  }
  const std::string answer_;
  const iotcloud::tests::LoopbackListener listener_;
  std::mutex mutex_;
  std::vector<std::string> targets_;  ///< guarded by mutex_
  std::thread thread_;                ///< last: it uses the others
};

TEST_F(CliOfAWorkerHere, AsksTheMasterForWhatItDoesNotReachItself) {
  const PageAtTheSecondTry pages(page);
  show_worker_at(pages.address());
  EXPECT_EQ(run_json({"topology", "show", "echo"})["components"][0]["parallelism"], 3);
}

TEST_F(CliOfAWorkerHere, IsNotTriedAgainOnceItDidNotAnswer) {
  PageAtTheSecondTry pages(page);
  show_worker_at(pages.address());
  cli::MasterClient client({address()}, {}, std::chrono::milliseconds(1000));
  cli::WorkerPages workers(client, "echo"_topology);
  for (int look = 0; look < 2; ++look) EXPECT_EQ(workers.get(worker_, "/tap?id=a"), page);
  // The master looks first whether it is the worker.
  EXPECT_THAT(pages.targets(), testing::ElementsAre("/topology", "/tap?id=a", "/topology", "/tap?id=a"));
}

TEST_F(CliOfAWorkerHere, SaysWhyNeitherItNorTheMasterReachesIt) {
  show_worker_at("127.0.0.1:" + std::to_string(iotcloud::tests::free_port()));
  EXPECT_THAT(complaint(), AllOf(HasSubstr("does not answer"), HasSubstr("a master does not reach it either")));
}

TEST_F(CliOfAWorkerHere, GetsNoAnswerOfAnotherProgramAtTheMaster) {
  const rpc::HttpServer other(rpc::PageSettings{"127.0.0.1:0", {}, ""},
                              std::map<std::string, rpc::HttpHandler>{
                                  {"/topology",
                                   [](const auto&) {
                                     return rpc::HttpAnswer{403, "text/plain", R"({"worker": "w1", "its": "own"})"};
                                   }},
                                  {"/tap", answers("its own")}});
  const rpc::HttpServer another_worker(
      rpc::PageSettings{"127.0.0.1:0", {}, ""},
      std::map<std::string, rpc::HttpHandler>{{"/topology", answers(R"({"worker": "w2", "its": "own"})")}});
  cli::MasterClient client({address()}, {}, std::chrono::milliseconds(1000));
  for (const auto* pages : {&other, &another_worker}) {
    show_worker_at(pages->address());
    for (const char* target : {"/topology", "/tap?id=a"}) {
      EXPECT_THAT([&] { client.worker_page("echo"_topology, "w1", target); },
                  testing::ThrowsMessage<cli::RequestFailed>(
                      AllOf(HasSubstr("another program answers at"), Not(HasSubstr("own")))));
    }
    node_.reset();
  }
}

/// SECURITY.md: what the thief of a worker makes a master do by a record of its own.
TEST_F(CliOfAWorkerHere, MakesTheMasterAskWhateverAddressItsRecordNamesButSendNoTokenThere) {
  const auto sent_first = [&](bool tls) {
    const iotcloud::tests::LoopbackListener somebody;
    std::string bytes(4096, '\0');
    std::jthread accepting([&] {
      const int client = somebody.accept();
      bytes.resize(
          client < 0 ? 0 : static_cast<std::size_t>(std::max<ssize_t>(0, recv(client, bytes.data(), bytes.size(), 0))));
      if (client >= 0) close(client);
    });
    worker_.http = "127.0.0.1:" + std::to_string(somebody.port());
    worker_.tls = tls;
    show_worker();
    cli::MasterClient client({address()}, {}, std::chrono::milliseconds(1000));
    EXPECT_THROW(client.worker_page("echo"_topology, "w1", "/topology"), cli::RequestFailed);
    shutdown(somebody.socket(), SHUT_RDWR);  // ends accept(), if nobody came
    accepting.join();
    node_.reset();
    return bytes;
  };
  const std::string plain = sent_first(false);
  EXPECT_THAT(plain, testing::StartsWith("GET /topology"));
  EXPECT_THAT(plain, AllOf(Not(HasSubstr("Authorization")), Not(HasSubstr(token_))));
  const std::string secured = sent_first(true);
  ASSERT_FALSE(secured.empty());
  EXPECT_EQ(secured.front(), '\x16') << "a handshake of TLS, in which the somebody must prove that it has this address";
  EXPECT_THAT(secured, Not(HasSubstr(token_)));
}

TEST_F(CliOfAFarWorker, TellsWhetherADaemonIsWell) {
  const auto files = certificates_.of("operator");
  const Words words = {"--ca",    files.ca,       "--certificate",   files.certificate, "--key",
                       files.key, "--token-file", folder_ / "token", "health",          worker_.http};
  const auto done = run(words);
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_EQ(done.out, "it is so\n");
  well_ = false;
  EXPECT_EQ(run(words).status, 1);
}

}  // namespace
}  // namespace iotcloud::master::test
