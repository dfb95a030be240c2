#include <algorithm>
#include <charconv>
#include <set>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/state/redis/redis_connection.h>
#include <iotcloud/topology/state/redis/redis_store.h>

namespace iotcloud::topology::internal {

namespace {

constexpr config::Logger state_logger{"topology.state"};

// Each key of a state is a hash "iotcloud:state:1:TOPOLOGY:COMPONENT:KEY" with the fields
//   o  the session of the task that claimed the key last
//   v  the value; missing if the key does not exist in the state
//   n  the number of checkpoints that have changed it
// ':' and '%' in the names of topology and component are written %3A and %25. A key without a value expires in an hour.

constexpr std::chrono::milliseconds answer_limit{2000};
/// How long the store does not ask the server again after a failure, so that a task does not wait for each of its
/// tuples.
constexpr std::chrono::milliseconds redis_pause{200};
/// How often make_sure() asks the server.
constexpr std::chrono::milliseconds look_pause{1000};
/// The only maxmemory-policy with which a server keeps all keys.
constexpr const char* keeps_all = "noeviction";

/// KEYS[1]: the key; ARGV[1]: the session. Answers its value and number.
constexpr const char* claim_script = R"(
redis.call('HSET', KEYS[1], 'o', ARGV[1])
local found = redis.call('HMGET', KEYS[1], 'v', 'n')
if not found[1] then redis.call('PEXPIRE', KEYS[1], 3600000) end
return found
)";

/// Begins the commit: refuses it while the server may drop keys.
constexpr const char* keeps_all_script = R"(
local policy = string.match(redis.call('INFO', 'memory'), 'maxmemory_policy:([%w-]+)')
if policy ~= 'noeviction' then return redis.error_reply('EVICTS ' .. tostring(policy)) end
)";
constexpr std::string_view evicts = "EVICTS ";

/// KEYS: all keys that the task has claimed; ARGV[1]: its session; then three words for each change: the key's place in
/// KEYS, its number, and '+' with the value, or '-'. Answers the places of keys that another session has claimed since;
/// if there is one, nothing was written.
constexpr const char* commit_script = R"(
local taken = {}
for place, key in ipairs(KEYS) do
  if redis.call('HGET', key, 'o') ~= ARGV[1] then taken[#taken + 1] = place end
end
if #taken > 0 then return taken end
for i = 2, #ARGV, 3 do
  local key = KEYS[tonumber(ARGV[i])]
  local change = ARGV[i + 2]
  if string.sub(change, 1, 1) == '+' then
    redis.call('HSET', key, 'n', ARGV[i + 1], 'v', string.sub(change, 2))
    redis.call('PERSIST', key)
  else
    redis.call('HSET', key, 'n', ARGV[i + 1])
    redis.call('HDEL', key, 'v')
    redis.call('PEXPIRE', key, 3600000)
  end
end
return taken
)";

std::string escaped(const std::string& name) {
  std::string text;
  for (const char each : name) {
    if (each == ':') {
      text += "%3A";
    } else if (each == '%') {
      text += "%25";
    } else {
      text += each;
    }
  }
  return text;
}

std::string redis_key(const StateOwner& owner, const std::string& key) {
  return "iotcloud:state:1:" + escaped(owner.topology) + ":" + escaped(owner.component) + ":" + key;
}

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

class RedisStore final : public StateStore {
 public:
  explicit RedisStore(const std::string& url) : address_(parse_redis_address(url)) {}

  bool shared() const override { return true; }

  StoredState load(const StateOwner&) override {
    const config::MutexLock lock(mutex_);
    try {
      connection();
    } catch (const StateUnavailable&) {  // the tuples will wait for it
    }
    return {};
  }

  ClaimedValue claim(const StateOwner& owner, const std::string& key) override {
    const config::MutexLock lock(mutex_);
    const RedisReply reply = ask({"EVAL", claim_script, "1", redis_key(owner, key), owner.session});
    if (reply.list.size() != 2) throw unexpected();
    ClaimedValue claimed;
    const RedisReply &value = reply.list[0], &number = reply.list[1];
    if (!value.is_nothing) claimed.value = value.text;
    const auto [end, status] =
        std::from_chars(number.text.data(), number.text.data() + number.text.size(), claimed.changes);
    if (!number.is_nothing && status != std::errc{}) throw unexpected();
    return claimed;
  }

  void commit(const StateOwner& owner, const Checkpoint& checkpoint) override {
    std::vector<std::string> words{"EVAL", std::string(keeps_all_script) + commit_script,
                                   std::to_string(checkpoint.claimed.size())};
    for (const auto& claim : checkpoint.claimed) words.push_back(redis_key(owner, claim.key));
    words.push_back(owner.session);
    for (const auto& [key, value] : checkpoint.changes) {
      const auto claim = std::lower_bound(checkpoint.claimed.begin(), checkpoint.claimed.end(), key,
                                          [](const auto& each, const auto& wanted) { return each.key < wanted; });
      words.push_back(std::to_string(claim - checkpoint.claimed.begin() + 1));
      words.push_back(std::to_string(claim->changes + 1));
      words.push_back(value ? "+" + *value : "-");
    }
    const config::MutexLock lock(mutex_);
    const RedisReply taken = ask(words);
    if (taken.list.empty()) return;
    throw StateClaimed(std::to_string(taken.list.size()) + " of " + std::to_string(checkpoint.claimed.size()) +
                       " keys of component \"" + owner.component + "\" of topology \"" + owner.topology +
                       "\" were claimed by another task or worker since the last checkpoint; nothing was written");
  }

  void make_sure() override {
    const config::MutexLock lock(mutex_);
    if (connection_ && config::system_clock().now() < look_at_) return;
    const std::string policy = info_of(ask({"INFO"}).text, "maxmemory_policy");
    look_at_ = config::system_clock().now() + look_pause;
    if (policy == keeps_all) return;
    give_up("the Redis at " + connection_->name() + " " + forgetful(policy));
    throw StateUnavailable(last_problem_);
  }

 private:
  StateUnavailable unexpected() const {
    return StateUnavailable("the state store " + address_.text + " has data of another program or version");
  }

  /// Asks the master. Whatever goes wrong is StateUnavailable.
  RedisReply ask(const std::vector<std::string>& words) IOTCLOUD_REQUIRES(mutex_) {
    try {
      return connection().ask(words);
    } catch (const StateUnavailable& error) {
      if (connection_) give_up(error.what());
      throw;
    } catch (const StateError& error) {  // a server that became a replica, is full, or restarts answers with an error
      std::string text = error.what();
      if (text.starts_with(evicts)) {
        text = "it " + forgetful(text.substr(evicts.size(), text.find(' ', evicts.size()) - evicts.size()));
      }
      if (connection_) give_up("the state store " + address_.text + ": " + text);
      throw StateUnavailable(last_problem_);
    }
  }

  void give_up(std::string problem) IOTCLOUD_REQUIRES(mutex_) {
    last_problem_ = std::move(problem);
    connection_.reset();
    again_at_ = config::system_clock().now() + redis_pause;
  }

  /// The connection to the master; looks for it if there is none. \throws StateError if a server does not let this
  /// client in or may drop keys; StateUnavailable if there is no master now
  RedisConnection& connection() IOTCLOUD_REQUIRES(mutex_) {
    if (connection_) return *connection_;
    if (config::system_clock().now() < again_at_) throw StateUnavailable(last_problem_);
    std::string problems;
    for (const RedisServer& server : address_.servers) {
      try {
        auto candidate = std::make_unique<RedisConnection>(address_, server, answer_limit);
        greet(*candidate);
        connection_ = std::move(candidate);
        tell_failover();
        return *connection_;
      } catch (const StateUnavailable& error) {
        problems += (problems.empty() ? "" : "; ") + std::string(error.what());
      } catch (const StateError& error) {
        give_up(error.what());
        throw;
      }
    }
    give_up(std::move(problems));
    throw StateUnavailable(last_problem_);
  }

  /// Says that another server is the master now. A task that wrote a lost key finds that by itself; one that did not
  /// write it cannot.
  void tell_failover() IOTCLOUD_REQUIRES(mutex_) {
    const std::string before = std::exchange(last_master_, connection_->name());
    if (before.empty() || before == last_master_) return;
    state_logger.warn(
        "the state store failed over from {} to {}, which may have lost the last checkpoints, whose messages were "
        "acknowledged: Redis copies to replicas after it has answered",
        before, last_master_);
  }

  /// Logs in, and checks that the server is the master and keeps what it has.
  void greet(RedisConnection& server) IOTCLOUD_REQUIRES(mutex_) {
    try {
      const std::string password = password_of(address_);
      if (!address_.user.empty()) {
        server.ask({"AUTH", address_.user, password});
      } else if (!password.empty()) {
        server.ask({"AUTH", password});
      }
      const std::string info = server.ask({"INFO"}).text;
      if (const std::string role = info_of(info, "role"); role != "master") {
        throw StateUnavailable("the Redis at " + server.name() + " is no master but a " + role);
      }
      if (info_of(info, "loading") == "1") {
        throw StateUnavailable("the Redis at " + server.name() + " reads its data from the disk");
      }
      if (const std::string policy = info_of(info, "maxmemory_policy"); policy != keeps_all) {
        throw StateError("the Redis at " + server.name() + " " + forgetful(policy));
      }
      if (info_of(info, "aof_enabled") != "1" && told_of_restarts_.insert(server.name()).second) {
        state_logger.warn(
            "the Redis at {} keeps no log on the disk, so when it restarts it loses checkpoints whose messages were "
            "acknowledged; set appendonly yes and appendfsync always",
            server.name());
      }
    } catch (const RedisRefusal& refusal) {
      const std::string text = refusal.what();
      const std::string what = "the Redis at " + server.name() + " refuses: " + text;
      if (text.starts_with("LOADING") || text.starts_with("MASTERDOWN") || text.starts_with("BUSY")) {
        throw StateUnavailable(what);
      }
      throw StateError(what + "; see topology/state/README.md for the rights that its user needs");
    }
  }

  const RedisAddress address_;
  config::Mutex mutex_;  ///< held while a server is asked: tasks ask one after the other
  std::unique_ptr<RedisConnection> connection_ IOTCLOUD_GUARDED_BY(mutex_);
  config::Clock::Instant again_at_ IOTCLOUD_GUARDED_BY(mutex_){};  ///< no attempt to connect before this time
  config::Clock::Instant look_at_ IOTCLOUD_GUARDED_BY(mutex_){};   ///< make_sure() does not ask before this time
  std::string last_problem_ IOTCLOUD_GUARDED_BY(mutex_);
  std::string last_master_ IOTCLOUD_GUARDED_BY(mutex_);  ///< RedisConnection::name(); empty: there was none
  std::set<std::string> told_of_restarts_ IOTCLOUD_GUARDED_BY(mutex_);  ///< names of servers
};

}  // namespace

std::shared_ptr<StateStore> open_redis(const std::string& url) {
  return std::make_shared<RedisStore>(url);
}

}  // namespace iotcloud::topology::internal
