#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <deque>
#include <limits>
#include <memory>
#include <thread>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::config {

namespace {

constexpr int sub_buckets = 16;  // for each power of two
constexpr int octaves = 40;      // up to 18 minutes; the last bucket counts longer durations
constexpr int bucket_count = (octaves - 3) * sub_buckets;

int bucket_of(std::uint64_t ns) {
  if (ns < sub_buckets) return static_cast<int>(ns);
  const int octave = static_cast<int>(std::bit_width(ns)) - 1;  // >= 4
  const auto within = static_cast<int>((ns >> (octave - 4)) & (sub_buckets - 1));
  return std::min((octave - 3) * sub_buckets + within, bucket_count - 1);
}

/// The middle of a bucket, in ns.
double middle_of(int bucket) {
  if (bucket < sub_buckets) return bucket;
  const int octave = bucket / sub_buckets + 3;
  const double width = std::ldexp(1.0, octave - 4);
  return std::ldexp(1.0, octave) + (bucket % sub_buckets + 0.5) * width;
}

/// The upper end of a bucket, in ns.
double end_of(int bucket) {
  if (bucket < sub_buckets) return bucket + 1;
  const int octave = bucket / sub_buckets + 3;
  return std::ldexp(1.0, octave) + (bucket % sub_buckets + 1) * std::ldexp(1.0, octave - 4);
}

}  // namespace

struct Histogram::Buckets {
  std::array<std::atomic<std::uint64_t>, bucket_count> counts{};
  std::atomic<std::uint64_t> sum{0};
  std::atomic<std::uint64_t> max{0};
};

Histogram::Histogram() = default;
Histogram::~Histogram() {
  delete buckets_.load();
}

Histogram::Buckets& Histogram::buckets() {
  if (Buckets* there = buckets_.load(std::memory_order_acquire)) return *there;
  auto made = std::make_unique<Buckets>();
  Buckets* expected = nullptr;
  if (buckets_.compare_exchange_strong(expected, made.get(), std::memory_order_acq_rel)) return *made.release();
  return *expected;
}

void Histogram::record_ns(std::int64_t ns, std::uint64_t times) {
  const auto value = static_cast<std::uint64_t>(ns < 0 ? 0 : ns);
  Buckets& b = buckets();
  b.counts[static_cast<std::size_t>(bucket_of(value))].fetch_add(times, std::memory_order_relaxed);
  b.sum.fetch_add(value * times, std::memory_order_relaxed);
  std::uint64_t max = b.max.load(std::memory_order_relaxed);
  while (value > max && !b.max.compare_exchange_weak(max, value, std::memory_order_relaxed)) {
  }
}

Histogram::Summary Histogram::summary() const {
  const Buckets* b = buckets_.load(std::memory_order_acquire);
  Summary summary;
  if (!b) return summary;
  std::array<std::uint64_t, bucket_count> counts{};
  for (std::size_t i = 0; i < counts.size(); ++i) {
    counts[i] = b->counts[i].load(std::memory_order_relaxed);
    summary.count += counts[i];
  }
  if (summary.count == 0) return summary;
  summary.max_ns = static_cast<double>(b->max.load(std::memory_order_relaxed));
  summary.mean_ns = static_cast<double>(b->sum.load(std::memory_order_relaxed)) / static_cast<double>(summary.count);
  const auto quantile = [&](double q) {
    const auto rank = static_cast<std::uint64_t>(std::ceil(q * static_cast<double>(summary.count)));
    std::uint64_t seen = 0;
    for (int i = 0; i < bucket_count; ++i) {
      seen += counts[static_cast<std::size_t>(i)];
      if (seen >= rank) return std::min(middle_of(i), summary.max_ns);
    }
    return summary.max_ns;
  };
  summary.p50_ns = quantile(0.5);
  summary.p99_ns = quantile(0.99);
  return summary;
}

Histogram::Spread Histogram::spread() const {
  const Buckets* b = buckets_.load(std::memory_order_acquire);
  Spread spread;
  if (!b) return spread;
  for (int first = 0; first < bucket_count; first += sub_buckets / 4) {
    std::uint64_t count = 0;
    for (int i = first; i < first + sub_buckets / 4; ++i)
      count += b->counts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
    if (count > 0) spread.emplace_back(end_of(first + sub_buckets / 4 - 1), count);
  }
  return spread;
}

struct Metrics::Impl {
  template <typename Metric>
  struct Named {
    std::string help;
    Metric metric;
  };
  using Key = std::pair<std::string, Labels>;

  /// \param metrics one of the maps below
  template <typename Metric>
  Metric& find_or_make(std::map<Key, Named<Metric>>& metrics, const std::string& name, const std::string& help,
                       const Labels& labels) IOTCLOUD_REQUIRES(mutex) {
    auto& named = metrics[{name, labels}];  // references to a map's nodes stay valid
    if (named.help.empty()) named.help = help;
    return named.metric;
  }

  /// A source, which runs without any lock, so that it may end its own registration.
  struct Registered {
    Mutex mutex;
    ConditionVariable left;
    std::thread::id running IOTCLOUD_GUARDED_BY(mutex);  ///< the thread that runs it; no thread: nobody does
    std::shared_ptr<const Source> source IOTCLOUD_GUARDED_BY(mutex);  ///< null: it has ended

    void collect(std::vector<Sample>& samples) {
      std::shared_ptr<const Source> now;
      {
        const MutexLock lock(mutex);
        if (running == std::this_thread::get_id()) return;  // the source itself collects
        left.wait(mutex, [this]() IOTCLOUD_REQUIRES(mutex) { return running == std::thread::id(); });
        if (source == nullptr || !*source) return;
        now = source;
        running = std::this_thread::get_id();
      }
      try {
        (*now)(samples);
      } catch (...) {
        leave(std::move(now));
        throw;
      }
      leave(std::move(now));
    }
    void end() {
      std::shared_ptr<const Source> ended;  // declared before the lock, so that it is destroyed without it
      const MutexLock lock(mutex);
      ended.swap(source);
      if (running == std::this_thread::get_id()) return;
      left.wait(mutex, [this]() IOTCLOUD_REQUIRES(mutex) { return running == std::thread::id(); });
    }

   private:
    void leave(std::shared_ptr<const Source> ran) {
      ran.reset();  // if it has ended meanwhile, it is destroyed before end() returns
      const MutexLock lock(mutex);
      running = std::thread::id();
      left.notify_all();
    }
  };

  mutable Mutex mutex;  // guards the maps; the metrics in them need no lock
  std::map<Key, Named<Counter>> counters IOTCLOUD_GUARDED_BY(mutex);
  std::map<Key, Named<Gauge>> gauges IOTCLOUD_GUARDED_BY(mutex);
  std::map<Key, Named<Histogram>> histograms IOTCLOUD_GUARDED_BY(mutex);
  mutable Mutex sources_mutex;
  std::map<std::uint64_t, std::shared_ptr<Registered>> sources IOTCLOUD_GUARDED_BY(sources_mutex);
  std::uint64_t last_source IOTCLOUD_GUARDED_BY(sources_mutex) = 0;
};

Metrics::Metrics() : impl_(std::make_unique<Impl>()) {}
Metrics::~Metrics() = default;

Counter& Metrics::counter(const std::string& name, const std::string& help, const Labels& labels) {
  const MutexLock lock(impl_->mutex);
  return impl_->find_or_make(impl_->counters, name, help, labels);
}
Gauge& Metrics::gauge(const std::string& name, const std::string& help, const Labels& labels) {
  const MutexLock lock(impl_->mutex);
  return impl_->find_or_make(impl_->gauges, name, help, labels);
}
Histogram& Metrics::histogram(const std::string& name, const std::string& help, const Labels& labels) {
  const MutexLock lock(impl_->mutex);
  return impl_->find_or_make(impl_->histograms, name, help, labels);
}

Metrics::SourceRegistration Metrics::add_source(Source source) {
  const auto registered = std::make_shared<Impl::Registered>();
  {
    const MutexLock setting(registered->mutex);
    registered->source = std::make_shared<const Source>(std::move(source));
  }
  const MutexLock lock(impl_->sources_mutex);
  impl_->sources.emplace(++impl_->last_source, registered);
  return SourceRegistration(*this, impl_->last_source);
}
void Metrics::remove_source(std::uint64_t id) {
  std::shared_ptr<Impl::Registered> registered;
  {
    const MutexLock lock(impl_->sources_mutex);
    registered = std::move(impl_->sources.extract(id).mapped());
  }
  registered->end();
}

std::vector<Sample> Metrics::collect() const {
  std::vector<Sample> samples;
  std::vector<std::shared_ptr<Impl::Registered>> sources;
  {
    const MutexLock lock(impl_->sources_mutex);
    for (const auto& [id, registered] : impl_->sources) sources.push_back(registered);
  }
  for (const auto& registered : sources) registered->collect(samples);
  const MutexLock lock(impl_->mutex);
  for (const auto& [key, named] : impl_->counters) {
    samples.push_back(
        {key.first, named.help, key.second, Sample::Kind::counter, static_cast<double>(named.metric.value()), {}});
  }
  for (const auto& [key, named] : impl_->gauges) {
    samples.push_back(
        {key.first, named.help, key.second, Sample::Kind::gauge, static_cast<double>(named.metric.value()), {}});
  }
  for (const auto& [key, named] : impl_->histograms) {
    samples.push_back({key.first, named.help, key.second, Sample::Kind::histogram, 0, named.metric.summary()});
  }
  return samples;
}

Metrics& process_metrics() {
  static Metrics& metrics = *new Metrics;  // never destroyed: threads may still count while the process ends
  return metrics;
}

}  // namespace iotcloud::config
