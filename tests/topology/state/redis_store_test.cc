// State in Redis: who may write it, and what becomes of it when a server dies, fails over or could forget.
#include <array>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <boost/asio.hpp>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/state/counting.h>
#include <iotcloud/tests/topology/state/state_fixture.h>
#include <iotcloud/topology/state/key_value_state.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// A server for all tests of this process; each test has a topology of its own in it.
tests::PrivateServer& redis() {
  static tests::PrivateServer server("redis.py");
  return server;
}

/// For tests in which a server that a busy machine lets answer late is no server that is away.
std::string patient(const std::string& url, const std::string& limit_ms = "120000") {
  return url + (url.find('?') == std::string::npos ? "?" : "&") + "answer_limit_ms=" + limit_ms;
}

class RedisState : public testing::Test {
 protected:
  /// One task, as in another process.
  KeyValueState task(int index = 0, int count = 2, const std::string& limit_ms = "120000") const {
    return {make_state_store(patient(redis().url(), limit_ms)), StateOwner{topology_, "count", index, count}};
  }

 private:
  const std::string topology_ = testing::UnitTest::GetInstance()->current_test_info()->name();
};

TEST_F(RedisState, ACheckpointOfOneTaskIsWhatTheNextTaskFindsWhateverTheNumberOfTasks) {
  const std::string key("\0\xff k:\0", 6), value("\0+\0\xfe", 4);
  KeyValueState first = task(0, 2);
  first.put(key, value);
  first.put("", "the empty key");
  first.put("erased", "1");
  first.checkpoint();
  first.erase("erased");
  first.put_int("number", -7);
  first.checkpoint();
  first.put("forgotten", "2");
  EXPECT_TRUE(first.changed());

  KeyValueState second = task(4, 5);
  ASSERT_NE(second.find(key), nullptr);
  EXPECT_EQ(*second.find(key), value);
  EXPECT_EQ(second.get(""), "the empty key");
  EXPECT_EQ(second.get_int("number"), -7);
  EXPECT_EQ(second.find("erased"), nullptr);
  EXPECT_EQ(second.find("forgotten"), nullptr) << "no checkpoint wrote it";
}

TEST_F(RedisState, AnotherComponentOrTopologyHasOtherKeysAlsoWithAColonInItsName) {
  const auto store = make_state_store(patient(redis().url()));
  KeyValueState one(store, {"a:b", "c", 0, 1}), other(store, {"a", "b:c", 0, 1});
  one.put("key", "1");
  one.checkpoint();
  EXPECT_EQ(other.find("key"), nullptr);
}

TEST_F(RedisState, TwoSystemsWithOneTopologysNameHaveTheirOwnStateUnderPrefixes) {
  const StateOwner owner{"robots", "count", 0, 1};
  KeyValueState none(make_state_store(patient(redis().url())), owner);
  KeyValueState lab(make_state_store(patient(redis().url() + "?prefix=lab")), owner);
  KeyValueState hall(make_state_store(patient(redis().url() + "?prefix=hall")), owner);
  none.put("driver", "1");
  lab.put("driver", "2");
  EXPECT_EQ(hall.find("driver"), nullptr);
  none.checkpoint();
  lab.checkpoint();
  KeyValueState next(make_state_store(patient(redis().url() + "?prefix=lab")), owner);
  EXPECT_EQ(next.get("driver"), "2");
}

TEST(APrefixOfKeysInRedis, HasOnlyCharactersThatEndNoPartOfAKey) {
  try {
    make_state_store("redis://127.0.0.1:6379?prefix=lab:iotcloud");
    FAIL() << "it was not refused";
  } catch (const StateError& error) {
    EXPECT_THAT(error.what(), HasSubstr("the prefix \"lab:iotcloud\" has more than letters"));
  }
}

TEST_F(RedisState, ATaskWhoseKeyAnotherOneHasClaimedWritesNothing) {
  KeyValueState lost = task(), next = task();
  lost.put("driver", "1");
  lost.checkpoint();
  lost.put("driver", "2");
  lost.put("other", "2");
  EXPECT_EQ(next.get("driver"), "1") << "it claims the key";
  EXPECT_THROW(lost.checkpoint(), StateClaimed);
  EXPECT_FALSE(lost.changed()) << "what it had is void";
  next.put("driver", "3");
  next.checkpoint();
  EXPECT_EQ(lost.get("driver"), "3") << "it reads the key again, and so it has it again";
  EXPECT_EQ(lost.find("other"), nullptr) << "a checkpoint is written whole or not at all";
}

TEST_F(RedisState, ATaskThatHasReadAKeyReadsItAgainAfterEachCheckpoint) {
  KeyValueState here = task(), there = task();
  EXPECT_EQ(here.get_int("driver"), 0);
  here.checkpoint();
  there.put_int("driver", 5);
  there.checkpoint();
  EXPECT_EQ(here.get_int("driver"), 5);
}

TEST_F(RedisState, ACallThatFailedIsUndoneAndNotWhatCameBeforeIt) {
  KeyValueState state = task();
  state.put("a", "1");
  state.begin_call();
  state.put("a", "2");
  state.put("b", "2");
  state.erase("a");
  state.undo_call();
  state.checkpoint();
  KeyValueState next = task();
  EXPECT_EQ(next.get("a"), "1");
  EXPECT_EQ(next.find("b"), nullptr);
}

TEST_F(RedisState, ACheckpointWithoutAnAnswerIsMadeAgainAndCountsOnce) {
  KeyValueState state = task(0, 2, "4000");
  state.put_int("a", state.get_int("a") + 1);
  state.put("erased", "1");
  state.checkpoint();
  state.put_int("a", state.get_int("a") + 1);
  state.erase("erased");
  redis().pause();
  EXPECT_THROW(state.checkpoint(), StateUnavailable);
  redis().resume();
  EXPECT_TRUE(eventually([&] {
    try {
      state.checkpoint();
      return true;
    } catch (const StateUnavailable&) {
      return false;
    }
  }));
  EXPECT_EQ(task().get_int("a"), 2);
  EXPECT_EQ(task().find("erased"), nullptr);
}

/// Keeps the last text of each driver ("driver=text").
struct Last : StatefulBolt {
  explicit Last(std::shared_ptr<std::function<void()>> before_put = {}) : before_put_(std::move(before_put)) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"word", "count"}); }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { out_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& text = tuple.get<std::string>("value");
    if (before_put_ && *before_put_) (*before_put_)();
    state_->put(text.substr(0, text.find('=')), text.substr(text.find('=') + 1));
    out_->ack(tuple);
  }

 private:
  const std::shared_ptr<std::function<void()>> before_put_;
  OutputCollector* out_ = nullptr;
  KeyValueState* state_ = nullptr;
};

/// Two workers that read the same driver one after the other.
class TwoWorkers : public testing::Test {
 protected:
  TwoWorkers() : first_(kept_in_redis()), second_(kept_in_redis()) {
    first_.source->come_from(reader_);
    second_.source->come_from(std::make_shared<Reader>());
  }
  BoltFactory kept_in_redis() const {
    return make_stateful_bolt<Last>({.store = patient(server_.url()), .checkpoint = 100ms}, before_put_);
  }
  /// What a worker that begins now finds.
  std::string last() const {
    return KeyValueState(make_state_store(patient(server_.url())), {"t", "count", 0, 1}).get("d");
  }

  tests::PrivateServer server_{"redis.py"};
  const std::shared_ptr<std::function<void()>> before_put_ = std::make_shared<std::function<void()>>();
  const std::shared_ptr<Reader> reader_ = std::make_shared<Reader>();  ///< of the first worker
  Counting first_, second_;
};

TEST_F(TwoWorkers, AWorkerThatLostADriverDoesNotWriteWhatItHadOfItOverTheStateOfTheNext) {
  first_.put("d=1");
  first_.pass(100ms);
  reader_->gone = true;  // the first stood still, with "d=2" in hand; the second goes on
  second_.put("d=2");
  second_.put("d=3");
  second_.pass(100ms);
  EXPECT_THAT(second_.source->acked(), SizeIs(2));
  second_.put("d=4");
  first_.put("d=2");
  first_.pass(100ms);
  EXPECT_THAT(first_.source->retried(), ElementsAre(2));
  second_.pass(100ms);
  EXPECT_THAT(second_.source->failed(), IsEmpty()) << "the first has claimed nothing";
  EXPECT_EQ(last(), "4");
}

TEST_F(TwoWorkers, AWorkerThatLosesADriverWhileItExecutesWritesNothingOfIt) {
  *before_put_ = [this] {
    *before_put_ = {};
    reader_->gone = true;  // the first stands still in the middle of "d=1"
    second_.put("d=1");
    second_.put("d=2");
    second_.pass(100ms);
    EXPECT_THAT(second_.source->acked(), SizeIs(2));
  };
  first_.put("d=1");  // claims the key after the second has written it
  first_.pass(100ms);
  EXPECT_THAT(first_.source->acked(), IsEmpty());
  EXPECT_THAT(first_.source->retried(), ElementsAre(1));
  EXPECT_THAT(first_.runtime->snapshot().component("count").last_error,
              HasSubstr("the messages of 1 of 1 tuples are another worker's now"));
  EXPECT_EQ(last(), "2");
}

TEST_F(TwoWorkers, AMessageIsNotToBlameForAnotherWorkersClaim) {
  first_.put("d=1");
  second_.put("d=2");  // it claims the key
  first_.pass(100ms);
  EXPECT_THAT(first_.runtime->snapshot().component("count").last_error, HasSubstr("were claimed by another"));
  EXPECT_THAT(first_.source->failed(), ElementsAre(1));
  EXPECT_THAT(first_.source->retried(), ElementsAre(1));
}

/// A topology that counts in a server.
BoltFactory counting_in(const std::string& url) {
  return make_stateful_bolt<Count>({.store = url, .checkpoint = 100ms});
}

TEST(StateWithoutItsRedis, TuplesWaitAndNothingIsAckedUntilItIsBack) {
  tests::PrivateServer server("redis.py");
  Counting counting(counting_in(server.url()));
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(1));
  counting.put("a");
  server.kill();
  for (const char* word : {"a", "b", "a"}) counting.put(word);
  // Longer than the time-out of a message: those that wait are not emitted again.
  for (int i = 0; i < 400; ++i) counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(1));
  EXPECT_THAT(counting.source->failed(), IsEmpty());
  EXPECT_THAT(counting.runtime->snapshot().component("count").last_error,
              AllOf(HasSubstr("tuples wait"), HasSubstr("cannot be reached")));
  server.start();
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 5;
  }));
  EXPECT_THAT(counting.source->failed(), IsEmpty());
  EXPECT_THAT(counting.seen(), testing::UnorderedElementsAre("a=1", "a=2", "a=3", "a=4", "b=1"));
  EXPECT_EQ(KeyValueState(make_state_store(server.url()), {"t", "count", 0, 1}).get_int("a"), 4);
}

/// Counts outside of its state, and adds that to the state before a checkpoint.
struct LateCount : Count {
  void execute(const Tuple& tuple) override {
    const auto& word = tuple.get<std::string>("value");
    if (word == "a") state_->find(word);
    ++counted_[word];
    out_->ack(tuple);
  }
  void pre_checkpoint() override {
    for (const auto& [word, count] : counted_) state_->put_int(word, state_->get_int(word) + count);
    counted_.clear();
  }
  std::map<std::string, int> counted_{};
};

TEST(StateWithoutItsRedis, WhatABoltAddsBeforeACheckpointThatFailsInTheMiddleCountsOnce) {
  tests::PrivateServer server("redis.py");
  Counting counting(make_stateful_bolt<LateCount>({.store = server.url(), .checkpoint = 100ms}));
  counting.put("a");  // its key is read, so that adding to it needs no server
  counting.put("b");
  server.kill();
  for (int i = 0; i < 3; ++i) counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), IsEmpty());
  server.start();
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 2;
  }));
  KeyValueState state(make_state_store(server.url()), {"t", "count", 0, 1});
  EXPECT_EQ(state.get_int("a"), 1);
  EXPECT_EQ(state.get_int("b"), 1);
}

int times(const std::string& words, const std::string& text) {
  int count = 0;
  for (auto at = text.find(words); at != std::string::npos; at = text.find(words, at + 1)) ++count;
  return count;
}

TEST(StateWithoutItsRedis, ThatItIsAwayAndThatItIsBackIsSaidOnceForEachTimeItWent) {
  tests::PrivateServer server("redis.py");
  Counting counting(counting_in(server.url()));
  const tests::CapturedLog log;
  for (int outage = 1; outage <= 2; ++outage) {
    counting.put("a");  // the task has read its count, so tuples with this word need no store until the next checkpoint
    server.kill();
    for (int i = 0; i < 3; ++i) {
      counting.put("a");
      counting.pass(100ms);  // a checkpoint that fails
    }
    counting.put("never read");
    counting.pass(100ms);
    EXPECT_EQ(times("tuples wait for the state store", log.text()), outage);
    server.start();
    EXPECT_TRUE(eventually([&] {
      counting.pass(100ms);
      return times("the state store is back", log.text()) >= outage;
    }));
    for (int i = 0; i < 3; ++i) counting.pass(100ms);
    EXPECT_EQ(times("the state store is back", log.text()), outage);
  }
}

TEST(StateWithoutItsRedis, ATopologyStartsAndItsTuplesWait) {
  tests::PrivateServer server("redis.py");
  server.kill();
  Counting counting(counting_in(server.url()));
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.seen(), IsEmpty());
  server.start();
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 1;
  }));
  EXPECT_THAT(counting.seen(), ElementsAre("a=1"));
}

/// "HOST:PORT"
std::string host_of(const tests::PrivateServer& server) {
  return server.url().substr(std::string("redis://").size());
}
std::string port_of(const tests::PrivateServer& server) {
  return server.url().substr(server.url().rfind(':') + 1);
}

TEST(ARedisThatFailsOver, AndComesBackAsAMasterIsNotUsedBesideItsSuccessor) {
  tests::PrivateServer first("redis.py"), second("redis.py");
  second.kill();
  Counting counting(counting_in(first.url() + "," + host_of(second)));
  const auto count_one = [&] {
    const std::size_t before = counting.source->acked().size();
    counting.put("a");
    return eventually([&] {
      counting.pass(100ms);
      return counting.source->acked().size() == before + 1;
    });
  };
  ASSERT_TRUE(count_one());
  second.start();
  second.command("follow " + port_of(first), "FOLLOWING");
  first.kill();
  second.command("lead", "LEADS");
  ASSERT_TRUE(count_one());
  first.start();  // it does not know that it was away

  KeyValueState other(make_state_store(second.url() + "," + host_of(first)), {"t", "count", 0, 1});  // another worker's
  for (const tests::PrivateServer* each : {&first, &second})
    EXPECT_THAT(problem_of([&] { other.find("b"); }), AllOf(HasSubstr(host_of(*each)), HasSubstr("both say")));
  EXPECT_TRUE(count_one()) << "who uses the second goes on";
  second.kill();
  second.start();
  counting.put("a");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    const auto troubles = counting.runtime->snapshot().troubles;
    return !troubles.empty() && troubles.front().text.find("both say") != std::string::npos;
  }));
  EXPECT_EQ(counting.source->acked().size(), 3U);

  first.command("follow " + port_of(second), "FOLLOWING");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 4;
  }));
  EXPECT_EQ(counting.seen().back(), "a=4");
  EXPECT_TRUE(eventually([&] { return problem_of([&] { other.find("b"); }).empty(); }));
}

TEST(ARedisThatFailsOver, IsOneServerAlsoUnderTwoNames) {
  tests::PrivateServer server("redis.py");
  KeyValueState state(make_state_store(server.url() + ",localhost:" + port_of(server)), {"t", "count", 0, 1});
  EXPECT_EQ(problem_of([&] { state.find("a"); }), "");
}

TEST(ARedisThatFailsOver, LosesItsLastWritesAndThatIsFoundAndSaid) {
  tests::PrivateServer first("redis.py"), second("redis.py");
  second.kill();
  Counting counting(counting_in(first.url() + "," + host_of(second)));
  counting.put("a");
  counting.pass(100ms);
  second.start();
  second.command("follow " + port_of(first), "FOLLOWING");
  second.command("lead", "LEADS");  // as if its link had been slow since; nobody asks it while the first is there
  for (const char* word : {"a", "a"}) {
    counting.put(word);
    counting.pass(100ms);
  }
  ASSERT_THAT(counting.source->acked(), SizeIs(3));
  first.kill();
  counting.put("a");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 4;
  }));
  EXPECT_THAT(counting.seen().back(), "a=2") << "two acked words are lost";
  EXPECT_THAT(counting.runtime->snapshot().component("count").last_error,
              HasSubstr("lost 2 checkpoints of the key \"a\" of component \"count\""));
  double losses = 0;
  for (const auto& sample : counting.bench.metrics.collect()) {
    if (sample.name == "iotcloud_task_state_losses_total") losses += sample.value;
  }
  EXPECT_EQ(losses, 1);
}

TEST(ARedisThatFailsOver, IsSaidOnceByAWorkerThatWroteNothingToo) {
  tests::PrivateServer first("redis.py"), second("redis.py");
  const tests::CapturedLog log;
  second.kill();
  const auto store = make_state_store(first.url() + "," + host_of(second));
  KeyValueState reader(store, {"t", "count", 0, 2});
  second.start();
  second.command("follow " + port_of(first), "FOLLOWING");
  second.command("lead", "LEADS");
  const auto reads = [](KeyValueState& state, const std::string& key) {
    return eventually([&] {
      try {
        state.find(key);
        return true;
      } catch (const StateUnavailable&) {
        return false;
      }
    });
  };
  ASSERT_TRUE(reads(reader, "a"));
  EXPECT_EQ(times("last checkpoints", log.text()), 0) << "the first master is no failover";
  first.kill();
  ASSERT_TRUE(reads(reader, "b"));
  KeyValueState other(store, {"t", "count", 1, 2});
  ASSERT_TRUE(reads(other, "c"));
  EXPECT_EQ(times("may have lost the last checkpoints", log.text()), 1);
  EXPECT_TRUE(log.contains("from " + host_of(first) + " to " + host_of(second)));
  second.kill();
  EXPECT_EQ(problem_of([&] { reader.find("d"); }).empty(), false);
  second.start();
  ASSERT_TRUE(reads(reader, "d"));
  EXPECT_EQ(times("may have lost the last checkpoints", log.text()), 1) << "the same server is no failover";
}

TEST(ARedisThatMayForget, WhatItHasWhenItRestartsIsSaidOnceWithWhatToSet) {
  const tests::CapturedLog log;
  tests::PrivateServer server("redis.py", {"--appendonly", "no"}), good("redis.py");
  const auto store = make_state_store(server.url());
  KeyValueState(make_state_store(good.url()), {"t", "count", 0, 1}).find("a");
  EXPECT_FALSE(log.contains("appendonly"));
  KeyValueState state(store, {"t", "count", 0, 1});
  state.put("a", "1");
  state.checkpoint();
  server.kill();
  EXPECT_EQ(problem_of([&] { state.find("a"); }).empty(), false);
  server.start();
  EXPECT_TRUE(eventually([&] { return problem_of([&] { state.find("a"); }).empty(); }));
  EXPECT_EQ(state.find("a"), nullptr) << "an acked checkpoint is lost";
  EXPECT_EQ(times("set appendonly yes and appendfsync always", log.text()), 1);
}

TEST(ARedisCluster, IsRefusedAtTheStart) {
  tests::PrivateServer server("redis.py", {"--cluster"});
  EXPECT_THAT(problem_of([&] { const Counting counting(counting_in(server.url())); }),
              HasSubstr("is a node of a Redis Cluster"));
}

TEST(ARedisThatMayForget, IsRefusedAtTheStartWithWhatToSet) {
  tests::PrivateServer server("redis.py");
  server.command("policy allkeys-lru", "POLICY");
  EXPECT_THAT(problem_of([&] { const Counting counting(counting_in(server.url())); }),
              AllOf(HasSubstr("maxmemory-policy allkeys-lru"), HasSubstr("set maxmemory-policy noeviction")));
}

TEST(ARedisThatMayForget, AfterAllIsNoticedAndNothingIsAckedUntilItKeepsAllAgain) {
  tests::PrivateServer server("redis.py");
  Counting counting(counting_in(server.url()));
  counting.put("a");
  counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(1));
  EXPECT_THAT(counting.runtime->snapshot().troubles, IsEmpty());
  server.command("policy allkeys-lru", "POLICY");
  for (const char* word : {"a", "b"}) counting.put(word);
  for (int i = 0; i < 400; ++i) counting.pass(100ms);
  EXPECT_THAT(counting.source->acked(), ElementsAre(1));
  EXPECT_THAT(counting.source->failed(), IsEmpty());
  const auto wanted = AllOf(HasSubstr("tuples wait for the state store, and nothing is acked"),
                            HasSubstr("maxmemory-policy allkeys-lru"), HasSubstr("set maxmemory-policy noeviction"));
  const auto now = counting.runtime->snapshot();
  EXPECT_THAT(now.component("count").last_error, wanted);
  ASSERT_THAT(now.troubles, SizeIs(1));
  EXPECT_EQ(now.troubles.front().component, "count");
  EXPECT_THAT(now.troubles.front().text, wanted);
  server.command("policy noeviction", "POLICY");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return counting.source->acked().size() == 3;
  }));
  EXPECT_THAT(counting.seen(), testing::UnorderedElementsAre("a=1", "a=2", "b=1"));
  EXPECT_THAT(counting.runtime->snapshot().troubles, IsEmpty());
}

TEST(ARedisThatMayForget, IsNoticedWithoutTuplesToo) {
  tests::PrivateServer server("redis.py");
  Counting counting(counting_in(server.url()));
  const auto troubles = [&] { return counting.runtime->snapshot().troubles.size(); };
  counting.pass(100ms);
  EXPECT_EQ(troubles(), 0U);
  server.command("policy volatile-ttl", "POLICY");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return troubles() == 1;
  }));
  server.command("policy noeviction", "POLICY");
  EXPECT_TRUE(eventually([&] {
    counting.pass(100ms);
    return troubles() == 0;
  }));
}

/// A Redis that answers a claim only when another connection waits for an answer at the same time. Its whole data are
/// empty keys.
class RendezvousRedis {
 public:
  RendezvousRedis() : acceptor_(io_, {boost::asio::ip::address_v4::loopback(), 0}) {
    accept();
    thread_ = std::thread([this] { io_.run(); });  // it ends at once when there is nothing to wait for
  }
  ~RendezvousRedis() {
    io_.stop();
    thread_.join();
  }
  std::string url() const { return "redis://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()); }

 private:
  using Socket = boost::asio::ip::tcp::socket;

  struct Client {
    explicit Client(Socket connected) : socket(std::move(connected)) {}
    Socket socket;
    std::array<char, 4096> place{};
    std::string asked{};
  };

  void accept() {
    acceptor_.async_accept([this](const auto& error, Socket socket) {
      if (error) return;
      read(std::make_shared<Client>(std::move(socket)));
      accept();
    });
  }
  void read(const std::shared_ptr<Client>& client) {
    client->socket.async_read_some(boost::asio::buffer(client->place), [=, this](const auto& error, std::size_t size) {
      if (error) {
        waiting_.erase(client);
        return;
      }
      client->asked.append(client->place.data(), size);
      // A client sends one command, and then it waits.
      if (client->asked.find("INFO") != std::string::npos) {
        const std::string info = "\r\nrole:master\r\nmaxmemory_policy:noeviction\r\naof_enabled:1\r\n";
        client->asked.clear();
        answer(*client, "$" + std::to_string(info.size()) + "\r\n" + info + "\r\n");
      } else if (client->asked.find("EVAL") != std::string::npos) {
        client->asked.clear();
        waiting_.insert(client);
      }
      if (waiting_.size() > 1) have_met_ = true;
      if (have_met_) {
        for (const auto& each : waiting_) answer(*each, "*2\r\n$-1\r\n$-1\r\n");
        waiting_.clear();
      }
      read(client);
    });
  }
  static void answer(Client& client, const std::string& text) {
    boost::system::error_code gone;
    boost::asio::write(client.socket, boost::asio::buffer(text), gone);
  }

  boost::asio::io_context io_;
  boost::asio::ip::tcp::acceptor acceptor_;
  std::set<std::shared_ptr<Client>> waiting_;  ///< for the answer to a claim
  bool have_met_ = false;                      ///< two have waited together: from then on nobody waits
  std::thread thread_;
};

TEST(ARedis, IsAskedByEachTaskWithoutWaitingForTheAnswersOfOthers) {
  RendezvousRedis server;
  const auto store = make_state_store(server.url());
  const auto read = [&](const std::string& key) {
    KeyValueState state(store, StateOwner{"t", "count", 0, 2});
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (true) {
      try {
        return state.find(key) == nullptr;
      } catch (const StateUnavailable&) {  // the other one did not ask within the limit for an answer
        if (std::chrono::steady_clock::now() > deadline) return false;
      }
    }
  };
  auto one = std::async(std::launch::async, [&] { return read("one"); });
  EXPECT_TRUE(read("two"));
  EXPECT_TRUE(one.get());
}

TEST(ARedis, KeepsEveryCountWhenTheNumberOfTasksChanges) {
  tests::PrivateServer server("redis.py");
  expect_counts_to_go_on(counting_in(patient(server.url())), {}, 100ms);
}

TEST(ARedisOnAnotherMachine, IsRefusedWithoutTlsOrWithoutAUserAndPassword) {
  const auto refusal = [](const std::string& url) { return problem_of([&] { make_state_store(url); }); };
  EXPECT_THAT(refusal("redis://10.0.0.7:6379"), AllOf(HasSubstr("10.0.0.7 is another machine"), HasSubstr("TLS")));
  EXPECT_THAT(refusal("redis://127.0.0.1,redis.lab"), HasSubstr("redis.lab is another machine"));
  EXPECT_THAT(refusal("rediss://redis.lab:6380"), HasSubstr("ACL user"));
  EXPECT_THAT(refusal("rediss://iotcloud@redis.lab:6380"), HasSubstr("ACL user"));
  EXPECT_EQ(refusal("rediss://iotcloud@redis.lab:6380?password_file=/etc/iotcloud/redis"), "");
  EXPECT_EQ(refusal("redis://[::1]:7000"), "");
  EXPECT_THAT(refusal("redis://me:secret@127.0.0.1"),
              AllOf(HasSubstr("must not be in it"), testing::Not(HasSubstr("secret"))));
  EXPECT_THAT(refusal("redis://127.0.0.1:none"), HasSubstr("no HOST:PORT"));
  EXPECT_THAT(refusal("redis://127.0.0.1?user=x"), HasSubstr("no option \"user\""));
  EXPECT_THAT(refusal("redis://127.0.0.1?answer_limit_ms=2s"), HasSubstr("a number from 10 to 600000, not \"2s\""));
}

TEST(ARedisWithTls, LetsInWhoKnowsThePasswordAndIsBelievedOnlyWithItsAuthority) {
  tests::PrivateServer server("redis.py", {"--tls"});
  const std::string folder = server.folder().string();
  std::ofstream(folder + "/right") << tests::server_password << "\n";
  std::ofstream(folder + "/wrong") << "guessed\n";
  const std::string own = "&certificate_file=" + folder + "/client.pem&key_file=" + folder + "/client.key";
  const std::string trusted = "&ca_file=" + folder + "/ca.pem";
  const auto state = [&](const std::string& password, const std::string& options) {
    return KeyValueState(make_state_store(patient(server.url() + "?password_file=" + folder + password + options)),
                         {"t", "count", 0, 1});
  };
  KeyValueState first = state("/right", own + trusted);
  first.put("big", std::string(200'000, 'x'));
  first.checkpoint();
  EXPECT_THAT(state("/right", own + trusted).get("big"), SizeIs(200'000));
  EXPECT_THAT(problem_of([&] { state("/wrong", own + trusted); }), HasSubstr("WRONGPASS"));
  EXPECT_THAT(problem_of([&] { state("/right", own); }), HasSubstr("certificate"));
  EXPECT_THAT(problem_of([&] { state("/absent", own + trusted); }), HasSubstr("cannot be read"));
}

TEST(ARedisWithTls, IsLeftWhenItsCertificateIsRevokedOnOpenConnectionsTooAndAnothersIsNoReason) {
  tests::PrivateServer server("redis.py", {"--tls"});
  const std::string folder = server.folder().string();
  std::ofstream(folder + "/password") << tests::server_password << "\n";
  const auto revoke = [&](const std::string& names) {
    const std::string command =
        "/usr/bin/python3 -c 'import sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "certificates.Certificates(sys.argv[2]).revoke(" +
        names + ")' '" IOTCLOUD_TEST_SERVERS "' '" + folder + "'";
    ASSERT_EQ(std::system(command.c_str()), 0);
  };
  revoke("");
  const std::string url = server.url() + "?password_file=" + folder + "/password&certificate_file=" + folder +
                          "/client.pem&key_file=" + folder + "/client.key&ca_file=" + folder +
                          "/ca.pem&revoked_file=" + folder + "/revoked.pem";
  const auto store = make_state_store(patient(url));
  const auto problem = [&] { return problem_of([&] { KeyValueState(store, {"t", "count", 0, 1}).get("key"); }); };
  const tests::CapturedLog log;
  revoke("\"client\"");
  ASSERT_TRUE(tests::eventually([&] { return !problem().empty() || log.contains("open connections obey it"); }));
  EXPECT_EQ(problem(), "");
  revoke("\"server\"");
  ASSERT_TRUE(tests::eventually([&] { return problem().find("has been revoked") != std::string::npos; })) << problem();
  EXPECT_TRUE(tests::eventually([&] { return problem().find("certificate revoked") != std::string::npos; }))
      << problem();
  revoke("");
  EXPECT_TRUE(tests::eventually([&] { return problem().empty(); })) << problem();
  EXPECT_THAT(problem_of([] { make_state_store("redis://127.0.0.1?revoked_file=/etc/iotcloud/revoked.pem"); }),
              HasSubstr("write rediss://"));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
