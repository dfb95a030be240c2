#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace iotcloud::config {

using Labels = std::map<std::string, std::string>;

/// Counts up. Thread safe, wait free.
class Counter {
 public:
  void add(std::uint64_t n = 1) { value_.fetch_add(n, std::memory_order_relaxed); }
  std::uint64_t value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<std::uint64_t> value_{0};
};

/// A level that goes up and down. Thread safe, wait free.
class Gauge {
 public:
  void set(std::int64_t v) { value_.store(v, std::memory_order_relaxed); }
  void add(std::int64_t n) { value_.fetch_add(n, std::memory_order_relaxed); }
  std::int64_t value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<std::int64_t> value_{0};
};

/// Durations in nanoseconds, in logarithmic buckets of 1/16 octave (a quantile is within 4.5 %). Thread safe, wait
/// free; the buckets are allocated at the first sample.
class Histogram {
 public:
  /// All samples so far, in nanoseconds; quantiles are within 4.5 %.
  struct Summary {
    std::uint64_t count = 0;
    double mean_ns = 0, p50_ns = 0, p99_ns = 0, max_ns = 0;
  };
  Histogram();
  ~Histogram();
  Histogram(const Histogram&) = delete;
  Histogram& operator=(const Histogram&) = delete;

  /// \param times how many samples have this value (for a batch that was timed as a whole).
  void record_ns(std::int64_t ns, std::uint64_t times = 1);
  Summary summary() const;
  /// The samples in quarters of an octave: the upper end of each that has one, in nanoseconds, and how many it has.
  using Spread = std::vector<std::pair<double, std::uint64_t>>;
  Spread spread() const;

 private:
  struct Buckets;
  Buckets& buckets();
  std::atomic<Buckets*> buckets_{nullptr};
};

/// One reading of one metric, as an exporter needs it.
struct Sample {
  /// Says which of the values below holds.
  enum class Kind { counter, gauge, histogram };
  std::string name;
  std::string help;
  Labels labels;
  Kind kind = Kind::counter;
  double value = 0;              ///< counter and gauge
  Histogram::Summary histogram;  ///< histogram only
};

/// The interface through which rooms report metrics: ask once for a metric by name and labels, and keep the reference,
/// which is valid as long as `Metrics` lives. The same name and labels give the same object. Thread safe. Names follow
/// Prometheus ("iotcloud_broker_messages_published_total").
class Metrics {
 public:
  Metrics();
  ~Metrics();
  Counter& counter(const std::string& name, const std::string& help, const Labels& labels = {});
  Gauge& gauge(const std::string& name, const std::string& help, const Labels& labels = {});
  Histogram& histogram(const std::string& name, const std::string& help, const Labels& labels = {});

  /// Appends samples of its own. collect() calls it on any thread, one call of a source at a time, without any lock. It
  /// may destroy its own registration; if it calls collect(), it is itself left out.
  using Source = std::function<void(std::vector<Sample>& samples)>;
  /// Ends a source: after its destructor returned, the source does not run any more, unless the source itself called
  /// the destructor.
  class SourceRegistration {
   public:
    SourceRegistration() = default;
    SourceRegistration(Metrics& metrics, std::uint64_t id) : metrics_(&metrics), id_(id) {}
    SourceRegistration(SourceRegistration&& other) noexcept
        : metrics_(std::exchange(other.metrics_, nullptr)), id_(other.id_) {}
    SourceRegistration& operator=(SourceRegistration&& other) noexcept {
      std::swap(metrics_, other.metrics_);
      std::swap(id_, other.id_);
      return *this;
    }
    ~SourceRegistration() {
      if (metrics_ != nullptr) metrics_->remove_source(id_);
    }

   private:
    Metrics* metrics_ = nullptr;
    std::uint64_t id_ = 0;
  };
  /// For parts with so many metrics that reading them on demand is cheaper than keeping them up to date.
  [[nodiscard]] SourceRegistration add_source(Source source);
  std::vector<Sample> collect() const;

 private:
  void remove_source(std::uint64_t id);
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The process's own metrics, which rooms use by default.
Metrics& process_metrics();

}  // namespace iotcloud::config
