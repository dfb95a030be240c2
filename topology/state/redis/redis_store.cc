#include <algorithm>
#include <charconv>
#include <string>
#include <vector>

#include <iotcloud/topology/state/redis/redis_pool.h>
#include <iotcloud/topology/state/redis/redis_store.h>

namespace iotcloud::topology::internal {

namespace {

// Each key of a state is a hash "iotcloud:state:1:TOPOLOGY:COMPONENT:KEY", before which "PREFIX:" stands if the store's
// URL has a prefix, with the fields
//   o  the session of the task that claimed the key last
//   v  the value; missing if the key does not exist in the state
//   n  the number of checkpoints that have changed it
// ':' and '%' in the names of topology and component are written %3A and %25. A key without a value expires in an hour.

/// KEYS[1]: the key; ARGV[1]: the session. Answers its value and number.
constexpr const char* claim_script = R"(
redis.call('HSET', KEYS[1], 'o', ARGV[1])
local found = redis.call('HMGET', KEYS[1], 'v', 'n')
if not found[1] then redis.call('PEXPIRE', KEYS[1], 3600000) end
return found
)";

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

class RedisStore final : public StateStore {
 public:
  explicit RedisStore(const std::string& url) : address_(parse_redis_address(url)), pool_(address_) {}

  bool shared() const override { return true; }

  StoredState load(const StateOwner&) override {
    try {
      pool_.connect();
    } catch (const StateUnavailable&) {  // the tuples will wait for it
    }
    return {};
  }

  ClaimedValue claim(const StateOwner& owner, const std::string& key) override {
    const RedisReply reply = pool_.ask({"EVAL", claim_script, "1", key_in_redis(owner, key), owner.session});
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
    std::vector<std::string> words{"EVAL", RedisPool::for_a_server_that_keeps_all(commit_script),
                                   std::to_string(checkpoint.claimed.size())};
    for (const auto& claim : checkpoint.claimed) words.push_back(key_in_redis(owner, claim.key));
    words.push_back(owner.session);
    for (const auto& [key, value] : checkpoint.changes) {
      const auto claim = std::lower_bound(checkpoint.claimed.begin(), checkpoint.claimed.end(), key,
                                          [](const auto& each, const auto& wanted) { return each.key < wanted; });
      words.push_back(std::to_string(claim - checkpoint.claimed.begin() + 1));
      words.push_back(std::to_string(claim->changes + 1));
      words.push_back(value ? "+" + *value : "-");
    }
    const RedisReply taken = pool_.ask(words);
    if (taken.list.empty()) return;
    throw StateClaimed(std::to_string(taken.list.size()) + " of " + std::to_string(checkpoint.claimed.size()) +
                       " keys of component \"" + owner.component + "\" of topology \"" + owner.topology +
                       "\" were claimed by another task or worker since the last checkpoint; nothing was written");
  }

  void make_sure() override { pool_.make_sure(); }

 private:
  std::string key_in_redis(const StateOwner& owner, const std::string& key) const {
    const std::string prefix = address_.prefix.empty() ? "" : address_.prefix + ":";
    return prefix + "iotcloud:state:1:" + escaped(owner.topology) + ":" + escaped(owner.component) + ":" + key;
  }
  StateUnavailable unexpected() const {
    return StateUnavailable("the state store " + address_.text + " has data of another program or version");
  }

  const RedisAddress address_;
  RedisPool pool_;
};

}  // namespace

std::shared_ptr<StateStore> open_redis(const std::string& url) {
  return std::make_shared<RedisStore>(url);
}

}  // namespace iotcloud::topology::internal
