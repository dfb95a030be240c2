#include <map>

#include <prometheus/client_metric.h>
#include <prometheus/collectable.h>
#include <prometheus/exposer.h>
#include <prometheus/metric_family.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/exposition/metrics_endpoint.h>

namespace iotcloud::config {

namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

class Collector final : public prometheus::Collectable {
 public:
  explicit Collector(const Metrics& metrics) : metrics_(metrics) {}

  std::vector<MetricFamily> Collect() const override {
    std::map<std::string, MetricFamily> families;
    for (const auto& sample : metrics_.collect()) {
      ClientMetric metric;
      for (const auto& [name, value] : sample.labels) metric.label.push_back({name, value});
      switch (sample.kind) {
        case Sample::Kind::counter:
          metric.counter.value = sample.value;
          add(families, sample.name, sample.help, MetricType::Counter, std::move(metric));
          break;
        case Sample::Kind::gauge:
          metric.gauge.value = sample.value;
          add(families, sample.name, sample.help, MetricType::Gauge, std::move(metric));
          break;
        case Sample::Kind::histogram: {
          ClientMetric max = metric;
          max.gauge.value = sample.histogram.max_ns / 1e9;
          add(families, sample.name + "_max", sample.help + " (largest)", MetricType::Gauge, std::move(max));
          metric.summary.sample_count = sample.histogram.count;
          metric.summary.sample_sum = sample.histogram.mean_ns * static_cast<double>(sample.histogram.count) / 1e9;
          metric.summary.quantile = {{0.5, sample.histogram.p50_ns / 1e9}, {0.99, sample.histogram.p99_ns / 1e9}};
          add(families, sample.name, sample.help, MetricType::Summary, std::move(metric));
          break;
        }
      }
    }
    std::vector<MetricFamily> result;
    for (auto& [name, family] : families) result.push_back(std::move(family));
    return result;
  }

 private:
  static void add(std::map<std::string, MetricFamily>& families, const std::string& name, const std::string& help,
                  MetricType type, ClientMetric metric) {
    auto& family = families[name];
    family.name = name;
    family.help = help;
    family.type = type;
    family.metric.push_back(std::move(metric));
  }
  const Metrics& metrics_;
};

}  // namespace

struct MetricsEndpoint::Impl {
  Impl(const std::string& address, const Metrics& metrics)
      : collector(std::make_shared<Collector>(metrics)), exposer(address, 1) {
    exposer.RegisterCollectable(collector);
  }
  std::shared_ptr<Collector> collector;
  prometheus::Exposer exposer;
};

MetricsEndpoint::MetricsEndpoint(const std::string& address, const Metrics& metrics) {
  try {
    impl_ = std::make_unique<Impl>(address, metrics);
  } catch (const std::exception& e) {
    throw Error("metrics cannot be served at " + address + " (" + e.what() +
                "); is the address of the form host:port, and the port free?");
  }
}

MetricsEndpoint::~MetricsEndpoint() = default;

}  // namespace iotcloud::config
