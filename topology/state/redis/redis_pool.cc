#include <chrono>
#include <exception>
#include <string_view>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/state/redis/redis_pool.h>

namespace iotcloud::topology::internal {

namespace {

constexpr config::Logger state_logger{"topology.state"};

/// How long the pool does not ask a server again after a failure, so that a task does not wait for each of its tuples.
constexpr std::chrono::milliseconds redis_pause{200};
/// How often make_sure() asks the server.
constexpr std::chrono::milliseconds look_pause{1000};
/// The only maxmemory-policy with which a server keeps all keys.
constexpr const char* keeps_all = "noeviction";

constexpr const char* keeps_all_script = R"(
local policy = string.match(redis.call('INFO', 'memory'), 'maxmemory_policy:([%w-]+)')
if policy ~= 'noeviction' then return redis.error_reply('EVICTS ' .. tostring(policy)) end
)";
constexpr std::string_view evicts = "EVICTS ";

/// A line's value in the answer to INFO ("role:master\r\n"); empty: there is no such line.
std::string info_of(const std::string& info, const std::string& name) {
  const auto line = info.find("\n" + name + ":");
  if (line == std::string::npos) return {};
  const auto begin = line + name.size() + 2;
  return info.substr(begin, info.find_first_of("\r\n", begin) - begin);
}

std::string forgetful(const std::string& policy) {
  return "forgets keys when its memory is full (maxmemory-policy " + policy +
         "), and state with them; set maxmemory-policy noeviction";
}

/// What a server's refusal means.
std::string meaning(const std::string& refusal) {
  if (!refusal.starts_with(evicts)) return refusal;
  return "it " + forgetful(refusal.substr(evicts.size(), refusal.find(' ', evicts.size()) - evicts.size()));
}

}  // namespace

std::string RedisPool::for_a_server_that_keeps_all(const std::string& script) {
  return keeps_all_script + script;
}

void RedisPool::connect() {
  give_back(take());
}

RedisReply RedisPool::ask(const std::vector<std::string>& words) {
  Lent lent;
  try {
    lent = take();
  } catch (const StateUnavailable&) {
    throw;
  } catch (const StateError& error) {
    throw StateUnavailable(error.what());
  }
  std::string problem;
  try {
    lent.connection->check_server(clock_.now());
    RedisReply reply = lent.connection->ask(words);
    give_back(std::move(lent));
    return reply;
  } catch (const RedisRefusal& refusal) {
    problem = "the state store " + address_.text + ": " + meaning(refusal.what());
  } catch (const StateError& error) {
    problem = error.what();
  }
  give_up(lent.generation, problem);
  throw StateUnavailable(problem);
}

void RedisPool::make_sure() {
  std::uint64_t generation = 0;
  {
    const config::MutexLock lock(mutex_);
    if (clock_.now() < look_at_) return;
    generation = generation_;
  }
  const std::string policy = info_of(ask({"INFO"}).text, "maxmemory_policy");
  std::string master;
  {
    const config::MutexLock lock(mutex_);
    if (policy == keeps_all) {
      if (generation == generation_) look_at_ = clock_.now() + look_pause;
      return;
    }
    master = master_;
  }
  const std::string problem = "the Redis at " + master + " " + forgetful(policy);
  give_up(generation, problem);
  throw StateUnavailable(problem);
}

/// A connection to the master: one that waits, or a new one. \throws as connect()
RedisPool::Lent RedisPool::take() {
  std::uint64_t generation = 0;
  std::optional<RedisServer> master;
  {
    const config::MutexLock lock(mutex_);
    if (!idle_.empty()) {
      Lent lent{std::move(idle_.back()), generation_};
      idle_.pop_back();
      return lent;
    }
    if (clock_.now() < again_at_) throw StateUnavailable(last_problem_);
    generation = generation_;
    master = server_;
  }
  return open(generation, master);
}

void RedisPool::give_back(Lent lent) {
  const config::MutexLock lock(mutex_);
  if (lent.generation == generation_) idle_.push_back(std::move(lent.connection));
}

/// Forgets all connections of that generation, unless another thread has done so.
void RedisPool::give_up(std::uint64_t generation, std::string problem) {
  const config::MutexLock lock(mutex_);
  if (generation != generation_) return;
  begin_generation();
  last_problem_ = std::move(problem);
  again_at_ = clock_.now() + redis_pause;
}

/// Forgets all connections: those that are lent are not taken back.
void RedisPool::begin_generation() {
  ++generation_;
  idle_.clear();
  server_.reset();
  look_at_ = {};
}

/// Connects to the master. \param master the server of the generation's other connections; empty: look for it.
RedisPool::Lent RedisPool::open(std::uint64_t generation, const std::optional<RedisServer>& master) {
  try {
    auto connection = open_master(master ? std::vector{*master} : address_.servers);
    const std::uint64_t now = found(generation, *connection);
    return {std::move(connection), now};
  } catch (const StateError& error) {
    give_up(generation, error.what());
    throw;
  }
}

/// Asks all of these servers, also behind the first master: one that died and came back without following its successor
/// says that it is the master, too, and has an older state.
std::unique_ptr<RedisConnection> RedisPool::open_master(const std::vector<RedisServer>& servers) {
  std::unique_ptr<RedisConnection> master;
  std::string problems, master_id;
  std::exception_ptr refusal;
  for (const RedisServer& server : servers) {
    std::unique_ptr<RedisConnection> connection;
    std::string id;
    try {
      connection = std::make_unique<RedisConnection>(address_, server, address_.answer_limit, trust_);
      id = greet(*connection);
    } catch (const StateUnavailable& error) {
      problems += (problems.empty() ? "" : "; ") + std::string(error.what());
      continue;
    } catch (const StateError&) {
      if (!refusal) refusal = std::current_exception();
      continue;
    }
    if (!master) {
      master = std::move(connection);
      master_id = std::move(id);
    } else if (id != master_id) {  // not the same server under two names
      throw StateUnavailable(
          "the Redis at " + master->name() + " and the one at " + connection->name() +
          " both say that they are the master, so one of them has old states; no state is used until "
          "one follows the other: let the one that was away follow (REPLICAOF), which drops what "
          "it has");
    }
  }
  if (master) return master;
  if (refusal) std::rethrow_exception(refusal);
  throw StateUnavailable(problems);
}

/// Remembers the master. If it is another one than before, says so, and sees that no connection to that one is used: a
/// task that wrote a lost key finds that by itself; one that did not write it cannot. \return the connection's
/// generation
std::uint64_t RedisPool::found(std::uint64_t generation, const RedisConnection& master) {
  std::string before;
  {
    const config::MutexLock lock(mutex_);
    before = std::exchange(master_, master.name());
    const bool is_another = !before.empty() && before != master.name();
    if (is_another) {
      begin_generation();
      generation = generation_;
    }
    if (generation == generation_) server_ = master.server();
    if (!is_another) return generation;
  }
  state_logger.warn(
      "the state store failed over from {} to {}, which may have lost the last checkpoints, whose messages were "
      "acknowledged: Redis copies to replicas after it has answered",
      before, master.name());
  return generation;
}

/// Logs in, and checks that the server is the master and keeps what it has. \return what tells it from other servers
std::string RedisPool::greet(RedisConnection& server) {
  try {
    const std::string password = password_of(address_);
    if (!address_.user.empty()) {
      server.ask({"AUTH", address_.user, password});
    } else if (!password.empty()) {
      server.ask({"AUTH", password});
    }
    const std::string info = server.ask({"INFO"}).text;
    if (info_of(info, "cluster_enabled") == "1") {
      throw StateError("the Redis at " + server.name() +
                       " is a node of a Redis Cluster, where a checkpoint could not be written whole: its keys are on "
                       "several nodes; give a Redis of its own, or a master and its replicas");
    }
    if (const std::string role = info_of(info, "role"); role != "master") {
      throw StateUnavailable("the Redis at " + server.name() + " is no master but a " + role);
    }
    if (info_of(info, "loading") == "1") {
      throw StateUnavailable("the Redis at " + server.name() + " reads its data from the disk");
    }
    if (const std::string policy = info_of(info, "maxmemory_policy"); policy != keeps_all) {
      throw StateError("the Redis at " + server.name() + " " + forgetful(policy));
    }
    std::string id = info_of(info, "run_id");
    if (info_of(info, "aof_enabled") == "1") return id;
    {
      const config::MutexLock lock(mutex_);
      if (!told_of_restarts_.insert(server.name()).second) return id;
    }
    state_logger.warn(
        "the Redis at {} keeps no log on the disk, so when it restarts it loses checkpoints whose messages were "
        "acknowledged; set appendonly yes and appendfsync always",
        server.name());
    return id;
  } catch (const RedisRefusal& refusal) {
    const std::string text = refusal.what();
    const std::string what = "the Redis at " + server.name() + " refuses: " + text;
    if (text.starts_with("LOADING") || text.starts_with("MASTERDOWN") || text.starts_with("BUSY")) {
      throw StateUnavailable(what);
    }
    throw StateError(what + "; see topology/state/README.md for the rights that its user needs");
  }
}

}  // namespace iotcloud::topology::internal
