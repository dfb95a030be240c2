#pragma once

#include <atomic>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

namespace internal {
struct MoreDeliveries;
class Task;
struct Tree;
}  // namespace internal

namespace detail {

/// The common part of all tuples of one stream, to which each points; it lives as long as the topology.
struct StreamInfo {
  std::string component;
  std::string stream;
  Fields fields;
};

/// One task's delivery of a tracked tuple: what the runtime needs to settle it. All receivers of the tuple read
/// `receiver`; only the receiver itself uses the rest.
struct Delivery {
  const internal::Task* receiver = nullptr;
  /// XOR of its own id and the ids of what was emitted with it as the only anchor; and, if it is the first such tuple
  /// of one that was acked in the same call, what that one had to settle.
  std::uint64_t change = 0;
  /// When the execute() began that returned without ack or fail; 0: none did; `settled`: acked, failed or dropped.
  std::int64_t executed_ns = 0;
  static constexpr std::int64_t settled = -1;
  bool is_open() const { return executed_ns != settled; }
  bool is_open_for(const internal::Task* task) const { return receiver == task && is_open(); }
};

/// One emitted tuple, shared by all tasks that receive it. The runtime makes and recycles it. What it needs for a tuple
/// of one value and one receiver is in the first two cache lines, tracked or not.
struct TupleData {
  virtual ~TupleData() = default;
  /// Called when the last handle is destroyed.
  virtual void recycle() noexcept = 0;
  /// Gives up one handle. \return true when it was the last one, after which recycle() must be called.
  bool let_go() noexcept {
    // The last handle skips the atomic decrement: no other thread has a handle that it could copy.
    return handles.load(std::memory_order_acquire) == 1 || handles.fetch_sub(1, std::memory_order_acq_rel) == 1;
  }

  std::atomic<std::uint32_t> handles{0};
  int source_task = -1;
  const StreamInfo* stream = nullptr;
  internal::Tree* tree = nullptr;  ///< for the runtime; null: the tuple is not tracked
  /// The topology's clock when the runtime called the next_tuple() that emitted the root of this tuple's tree; 0: not
  /// recorded, because no component has a deadline and RuntimeOptions::births is false.
  std::int64_t born_ns = 0;
  Delivery first;                            ///< for the runtime: delivery to the first receiver, if tracked
  internal::MoreDeliveries* more = nullptr;  ///< for the runtime
  Values values;
};

}  // namespace detail

/// A received tuple: a handle on shared immutable values, cheap to copy, thread safe like a shared_ptr to const. A Bolt
/// (not a BasicBolt) acks or fails every tuple that it received exactly once, through any copy of the handle. A bolt
/// may keep a handle after execute() and destroy it on any thread, but not after the topology's runtime is gone.
class Tuple {
 public:
  Tuple() = default;
  explicit Tuple(detail::TupleData* data) : data_(data) { hold(); }
  /// For the runtime: makes a handle that `data->handles` counts already.
  static Tuple adopt(detail::TupleData* data) {
    Tuple tuple;
    tuple.data_ = data;
    return tuple;
  }
  Tuple(const Tuple& other) : data_(other.data_) { hold(); }
  Tuple(Tuple&& other) noexcept : data_(std::exchange(other.data_, nullptr)) {}
  Tuple& operator=(Tuple other) noexcept {
    std::swap(data_, other.data_);
    return *this;
  }
  ~Tuple() {
    if (data_ != nullptr && data_->let_go()) data_->recycle();
  }

  std::size_t size() const { return data_->values.size(); }
  const Fields& fields() const { return data_->stream->fields; }
  const std::string& source_component() const { return data_->stream->component; }
  const std::string& source_stream() const { return data_->stream->stream; }
  int source_task() const { return data_->source_task; }
  bool is_tick() const;  ///< a tick: it has no fields, and need not be acked

  /// \throws std::out_of_range, whose text lists the fields.
  const Value& at(std::size_t i) const {
    if (i < size()) return data_->values[i];
    no_field(i);
  }
  /// The same, by name.
  const Value& at(std::string_view field) const;
  bool has(std::string_view field) const { return fields().find(field).has_value(); }

  /// The field as T: bool, std::int64_t, double, std::string or Payload, by reference; or std::string_view of a string.
  /// \throws std::out_of_range for an unknown field, std::invalid_argument for a value of another kind.
  template <typename T>
  decltype(auto) get(std::string_view field) const {
    return as<T>(at(field));
  }
  template <typename T>
  decltype(auto) get(std::size_t i) const {
    return as<T>(at(i));
  }

  detail::TupleData* data() const { return data_; }  ///< for the runtime
  explicit operator bool() const { return data_ != nullptr; }

 private:
  void hold() {
    if (data_) data_->handles.fetch_add(1, std::memory_order_relaxed);
  }
  template <typename T>
  requires std::is_same_v<T, std::string_view> std::string_view as(const Value& value)
  const { return as<std::string>(value); }
  /// \param value one of this tuple's.
  template <typename T>
  const T& as(const Value& value) const {
    if (const T* found = std::get_if<T>(&value)) return *found;
    refuse<T>(value);
  }
  template <typename T>
  [[noreturn, gnu::noinline, gnu::cold]] void refuse(const Value& value) const {
    wrong_kind(value, kind_of(Value(T{})));
  }
  [[noreturn]] void no_field(std::size_t i) const;
  [[noreturn]] void wrong_kind(const Value& value, const char* wanted) const;

  detail::TupleData* data_ = nullptr;
};

/// Source component and stream of tick tuples (Storm's names).
inline constexpr const char* system_component = "__system";
inline constexpr const char* tick_stream = "__tick";

}  // namespace iotcloud::topology
