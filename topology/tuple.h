#pragma once

#include <atomic>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

namespace internal {
struct Tree;
}

namespace detail {

/// The common part of all tuples of one stream, to which each points; it lives as long as the topology.
struct StreamInfo {
  std::string component;
  std::string stream;
  Fields fields;
};

/// One emitted tuple, shared by all tasks that receive it. The runtime makes and recycles it.
struct TupleData {
  virtual ~TupleData() = default;
  /// Called when the last handle is destroyed.
  virtual void recycle() noexcept = 0;

  std::atomic<std::uint32_t> handles{0};
  int source_task = -1;
  const StreamInfo* stream = nullptr;
  internal::Tree* tree = nullptr;  ///< for the runtime; null: the tuple is not tracked
  /// The topology's clock when the runtime called the next_tuple() that emitted the root of this tuple's tree; 0: not
  /// recorded, because no component has a deadline and RuntimeOptions::births is false.
  std::int64_t born_ns = 0;
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
    if (data_ == nullptr) return;
    // The last handle skips the atomic decrement: no other thread has a handle that it could copy.
    if (data_->handles.load(std::memory_order_acquire) == 1 ||
        data_->handles.fetch_sub(1, std::memory_order_acq_rel) == 1) {
      data_->recycle();
    }
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

  /// The field as T: bool, std::int64_t, double, std::string or Payload.
  /// \throws std::out_of_range for an unknown field, std::invalid_argument for a value of another kind.
  template <typename T>
  const T& get(std::string_view field) const {
    return as<T>(at(field), field);
  }
  template <typename T>
  const T& get(std::size_t i) const {
    return as<T>(at(i), i < fields().size() ? std::string_view(fields()[i]) : "");
  }

  detail::TupleData* data() const { return data_; }  ///< for the runtime
  explicit operator bool() const { return data_ != nullptr; }

 private:
  void hold() {
    if (data_) data_->handles.fetch_add(1, std::memory_order_relaxed);
  }
  template <typename T>
  const T& as(const Value& value, std::string_view field) const {
    if (const T* found = std::get_if<T>(&value)) return *found;
    wrong_kind(value, field, kind_of(Value(T{})));
  }
  [[noreturn]] void no_field(std::size_t i) const;
  [[noreturn]] void wrong_kind(const Value& value, std::string_view field, const char* wanted) const;

  detail::TupleData* data_ = nullptr;
};

/// Source component and stream of tick tuples (Storm's names).
inline constexpr const char* system_component = "__system";
inline constexpr const char* tick_stream = "__tick";

}  // namespace iotcloud::topology
