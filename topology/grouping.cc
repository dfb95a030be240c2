#include <stdexcept>

#include <iotcloud/topology/grouping.h>

namespace iotcloud::topology {

namespace {

constexpr std::uint64_t first_hash = 14695981039346656037ULL;

std::size_t place_of(std::uint64_t hash, std::size_t count) {
  // Avoids a division, which costs as much as the hash of a word.
  return (count & (count - 1)) == 0 ? hash & (count - 1) : hash % count;
}

class ShuffleGrouping final : public detail::ToOneGrouping {
 public:
  void prepare(const TopologyContext& emitter, const Fields& fields, std::span<const int> targets) override {
    ToOneGrouping::prepare(emitter, fields, targets);
    // so that emitters start at different tasks
    next_ = static_cast<std::size_t>(emitter.task_index) % targets_.size();
  }
  std::size_t place(const Values&) override {
    const std::size_t chosen = next_;
    if (++next_ == targets_.size()) next_ = 0;
    return chosen;
  }

 private:
  std::size_t next_ = 0;
};

class KeyGrouping : public detail::ToOneGrouping {
 public:
  explicit KeyGrouping(Fields key) : key_(std::move(key)) {}
  void prepare(const TopologyContext& emitter, const Fields& fields, std::span<const int> targets) override {
    ToOneGrouping::prepare(emitter, fields, targets);
    // build() has checked that the field exists
    for (const auto& name : key_) positions_.push_back(fields.find(name).value());
  }

 protected:
  std::uint64_t key_hash(const Values& values) const {
    std::uint64_t hash = first_hash;
    for (const std::size_t position : positions_) hash = stable_hash(values[position], hash);
    return hash;
  }

 private:
  Fields key_;
  std::vector<std::size_t> positions_;
};

class FieldsGrouping final : public KeyGrouping {
 public:
  using KeyGrouping::KeyGrouping;
  std::size_t place(const Values& values) override { return place_of(key_hash(values), targets_.size()); }
};

/// Groups by one field, as most topologies do; the same choice as FieldsGrouping's.
class OneFieldGrouping final : public detail::ToOneGrouping {
 public:
  explicit OneFieldGrouping(std::string key) : key_(std::move(key)) {}
  void prepare(const TopologyContext& emitter, const Fields& fields, std::span<const int> targets) override {
    ToOneGrouping::prepare(emitter, fields, targets);
    position_ = fields.find(key_).value();  // build() has checked that the field exists
  }
  std::size_t place(const Values& values) override {
    return place_of(stable_hash(values[position_], first_hash), targets_.size());
  }

 private:
  const std::string key_;
  std::size_t position_ = 0;
};

/// A key has two candidate tasks; the emitter takes the one to which it has sent less. So two tasks share a hot key.
class PartialKeyGrouping final : public KeyGrouping {
 public:
  using KeyGrouping::KeyGrouping;
  std::size_t place(const Values& values) override {
    used_.resize(targets_.size());  // at the first tuple, because many tasks never emit
    const std::uint64_t hash = key_hash(values);
    const std::size_t first = hash % targets_.size();
    std::size_t second = (hash >> 32) % targets_.size();
    if (second == first) second = (first + 1) % targets_.size();
    const std::size_t pick = used_[second] < used_[first] ? second : first;
    ++used_[pick];
    return pick;
  }

 private:
  std::vector<std::uint64_t> used_;
};

class AllGrouping final : public Grouping {
 public:
  void prepare(const TopologyContext&, const Fields&, std::span<const int> targets) override { targets_ = targets; }
  void choose(const Values&, std::vector<int>& chosen) override {
    chosen.insert(chosen.end(), targets_.begin(), targets_.end());
  }

 private:
  std::span<const int> targets_;
};

class GlobalGrouping final : public detail::ToOneGrouping {
 public:
  std::size_t place(const Values&) override { return 0; }
};

}  // namespace

std::size_t task_of_key(const Values& key, std::size_t tasks) {
  std::uint64_t hash = first_hash;
  for (const Value& value : key.all()) hash = stable_hash(value, hash);
  return place_of(hash, tasks);
}

const std::vector<std::string>& grouping_names() {
  static const std::vector<std::string> names{"shuffle", "fields", "partial_key",      "all",
                                              "global",  "none",   "local_or_shuffle", "direct"};
  return names;
}

GroupingFactory make_grouping(const std::string& name, const Fields& fields) {
  if (name == "shuffle" || name == "none" || name == "local_or_shuffle") {
    return [] { return std::make_unique<ShuffleGrouping>(); };
  }
  if (name == "fields" && fields.size() == 1) {
    return [key = fields[0]] { return std::make_unique<OneFieldGrouping>(key); };
  }
  if (name == "fields") return [fields] { return std::make_unique<FieldsGrouping>(fields); };
  if (name == "partial_key") return [fields] { return std::make_unique<PartialKeyGrouping>(fields); };
  if (name == "all") return [] { return std::make_unique<AllGrouping>(); };
  if (name == "global") return [] { return std::make_unique<GlobalGrouping>(); };
  if (name == "direct") return {};
  std::string known;
  for (const auto& candidate : grouping_names()) known += (known.empty() ? "" : ", ") + candidate;
  throw std::invalid_argument("there is no grouping \"" + name + "\"; use one of " + known);
}

}  // namespace iotcloud::topology
