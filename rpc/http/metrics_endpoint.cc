#include <map>
#include <utility>

#include <prometheus/client_metric.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <iotcloud/rpc/http/health_page.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>

namespace iotcloud::rpc {

namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

void add(std::map<std::string, MetricFamily>& families, const std::string& name, const std::string& help,
         MetricType type, ClientMetric metric) {
  auto& family = families[name];
  family.name = name;
  family.help = help;
  family.type = type;
  family.metric.push_back(std::move(metric));
}

std::vector<MetricFamily> collect(const config::Metrics& metrics) {
  std::map<std::string, MetricFamily> families;
  for (const auto& sample : metrics.collect()) {
    ClientMetric metric;
    for (const auto& [name, value] : sample.labels) metric.label.push_back({name, value});
    switch (sample.kind) {
      case config::Sample::Kind::counter:
        metric.counter.value = sample.value;
        add(families, sample.name, sample.help, MetricType::Counter, std::move(metric));
        break;
      case config::Sample::Kind::gauge:
        metric.gauge.value = sample.value;
        add(families, sample.name, sample.help, MetricType::Gauge, std::move(metric));
        break;
      case config::Sample::Kind::histogram: {
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

}  // namespace

HttpHandler metrics_page(const config::Metrics& metrics) {
  return [&metrics](const HttpRequest&) {
    return HttpAnswer{200, "text/plain; version=0.0.4; charset=utf-8",
                      prometheus::TextSerializer().Serialize(collect(metrics))};
  };
}

MetricsEndpoint::MetricsEndpoint(const PageSettings& settings, const config::Metrics& metrics,
                                 std::function<std::string()> trouble)
    : server_(settings, {{"/metrics", metrics_page(metrics)}, {"/healthz", health_page(std::move(trouble))}}) {}

}  // namespace iotcloud::rpc
