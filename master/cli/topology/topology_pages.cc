#include <algorithm>
#include <ostream>

#include <fmt/format.h>

#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/topology/topology_pages.h>
#include <iotcloud/master/cli/topology/worker_pages.h>

namespace iotcloud::master::cli {

using Json = TopologyPages::Json;

namespace {

/// Of lists and objects within each other, in a page.
constexpr int most_page_levels = 64;
constexpr const char* latencies[] = {"execute", "process", "complete"};
constexpr const char* counts[] = {"emitted", "transferred", "executed", "acked",       "failed", "timed_out",
                                  "late",    "superseded",  "errors",   "queue_depth", "pending"};

std::string duration(double us) {
  if (us < 1) return fmt::format("{:.2f}us", us);
  if (us < 10) return fmt::format("{:.1f}us", us);
  if (us < 1000) return fmt::format("{:.0f}us", us);
  if (us < 10'000) return fmt::format("{:.1f}ms", us / 1000);
  if (us < 1'000'000) return fmt::format("{:.0f}ms", us / 1000);
  return fmt::format("{:.1f}s", us / 1e6);
}

/// A number that counts something; 0: it is none.
std::uint64_t count_of(const Json& number) {
  return number.is_number_unsigned() ? number.get<std::uint64_t>() : 0;
}

std::string latency(const Json& of, const char* name) {
  const Json& one = of.at(name);
  if (count_of(one.at("count")) == 0) return "-";
  return duration(one.at("p50_us").get<double>()) + "/" + duration(one.at("p99_us").get<double>()) + "/" +
         duration(one.at("max_us").get<double>());
}

/// The age of the oldest message that a spout waits for.
std::string oldest(const Json& of) {
  const double seconds = of.value("oldest_s", 0.0);
  return seconds > 0 ? duration(seconds * 1e6) : "-";
}

}  // namespace

Json parse_page(const std::string& text) {
  return Json::parse(text, [](int depth, Json::parse_event_t, const Json&) {
    if (depth > most_page_levels) throw RequestFailed("its page has too many lists and objects within each other");
    return true;
  });
}

TopologyPages::TopologyPages(const discovery::TopologyStatus& topology, WorkerPages& workers)
    : topology_(topology.record.name) {
  if (topology.workers.empty()) problems_.push_back("no worker of topology " + topology_ + " runs");
  for (const auto& worker : topology.workers) {
    try {
      Json page = parse_page(workers.get(worker, "/topology"));
      if (components_.empty()) components_ = page.at("components");
      pages_.push_back(std::move(page));
    } catch (const RequestFailed& e) {
      problems_.emplace_back(e.what());
    } catch (const Json::exception& e) {
      problems_.push_back(fmt::format("worker {}: its page cannot be read: {}", worker.name, e.what()));
    }
  }
}

Json TopologyPages::brokers() const {
  return all("brokers");
}

Json TopologyPages::arrivals() const {
  return all("arrivals");
}

Json TopologyPages::troubles() const {
  return all("troubles");
}

Json TopologyPages::all(const char* list) const {
  Json all = Json::array();
  for (const Json& page : pages_) {
    for (Json each : page.value(list, Json::array())) {  // a worker of an older version says nothing of them
      each["worker"] = page.at("worker");
      all.push_back(std::move(each));
    }
  }
  return all;
}

Json TopologyPages::tasks_of(const std::string& component) const {
  Json tasks = Json::array();
  for (const Json& page : pages_) {
    for (Json task : page.at("tasks")) {
      if (task.at("component") != component) continue;
      task["worker"] = page.at("worker");
      tasks.push_back(std::move(task));
    }
  }
  return tasks;
}

Json TopologyPages::sum(const std::string& component) const {
  Json sum{{"parallelism", 0U}, {"tasks", 0U}};
  for (const Json& page : pages_) {
    for (const Json& one : page.at("components")) {
      if (one.at("id") != component) continue;
      for (const char* count : {"parallelism", "tasks"}) sum[count] = count_of(sum[count]) + count_of(one.at(count));
    }
  }
  for (const char* count : counts) sum[count] = std::uint64_t{0};
  sum["capacity"] = 0.0;
  sum["oldest_s"] = 0.0;
  for (const char* name : latencies) sum[name] = {{"count", 0U}, {"p50_us", 0.0}, {"p99_us", 0.0}, {"max_us", 0.0}};
  sum["last_error"] = "";
  std::map<std::string, std::uint64_t> most;
  for (const Json& task : tasks_of(component)) {
    for (const char* count : counts) sum[count] = count_of(sum[count]) + count_of(task.at(count));
    sum["capacity"] = std::max(sum["capacity"].get<double>(), task.at("capacity").get<double>());
    sum["oldest_s"] = std::max(sum["oldest_s"].get<double>(), task.value("oldest_s", 0.0));  // older workers: not there
    if (!task.at("last_error").get<std::string>().empty()) sum["last_error"] = task.at("last_error");
    for (const char* name : latencies) {
      const Json& one = task.at(name);
      Json& all = sum[name];
      const auto count = count_of(one.at("count"));
      all["count"] = count_of(all["count"]) + count;
      if (count > most[name]) all["p50_us"] = one.at("p50_us");
      most[name] = std::max(most[name], count);
      for (const char* worst : {"p99_us", "max_us"})
        all[worst] = std::max(all[worst].get<double>(), one.at(worst).get<double>());
    }
  }
  return sum;
}

Json TopologyPages::metrics() const {
  Json components = Json::array();
  for (const Json& component : components_) {
    const auto id = component.at("id").get<std::string>();
    components.push_back(
        {{"component", id}, {"kind", component.at("kind")}, {"sum", sum(id)}, {"tasks", tasks_of(id)}});
  }
  return {{"topology", topology_}, {"workers", pages_.size()}, {"components", components}};
}

void add_rates(Json& metrics, const Json& before, double seconds) {
  if (seconds <= 0) return;
  for (Json& component : metrics.at("components")) {
    for (const Json& was : before.at("components")) {
      if (was.at("component") != component.at("component")) continue;
      Json& sum = component.at("sum");
      Json rate = Json::object();
      for (const char* count : {"emitted", "executed"}) {
        const auto now = sum.at(count).get<std::uint64_t>(), then = was.at("sum").at(count).get<std::uint64_t>();
        if (now >= then) rate[count] = static_cast<double>(now - then) / seconds;
      }
      sum["rate"] = std::move(rate);
    }
  }
}

void print_metrics(std::ostream& out, const TopologyPages& pages, const Json& metrics) {
  std::vector<std::vector<std::string>> rows;
  std::vector<std::string> workers;
  const auto row = [&](const std::string& name, const std::string& task, const Json& of) {
    const auto rate = [&](const char* count) -> std::string {
      const auto rates = of.find("rate");
      if (rates == of.end() || !rates->contains(count)) return "-";
      return fmt::format("{:.1f}", rates->at(count).get<double>());
    };
    rows.push_back({name, task, rate("emitted"), rate("executed"), of.at("emitted").dump(), of.at("transferred").dump(),
                    of.at("executed").dump(), of.at("acked").dump(), of.at("failed").dump(), of.at("late").dump(),
                    of.at("superseded").dump(), of.at("queue_depth").dump(), of.at("pending").dump(), oldest(of),
                    fmt::format("{:.2f}", of.at("capacity").get<double>()), latency(of, "execute"),
                    latency(of, "process"), latency(of, "complete"),
                    printable(of.at("last_error").get<std::string>())});
  };
  for (const Json& component : metrics.at("components")) {
    row(printable(component.at("component").get<std::string>()), "all", component.at("sum"));
    for (const Json& task : component.at("tasks")) {
      const auto worker = task.at("worker").get<std::string>();
      auto known = std::find(workers.begin(), workers.end(), worker);
      if (known == workers.end()) known = workers.insert(workers.end(), worker);
      const auto id = task.at("task").dump();
      row("", pages.workers() > 1 ? fmt::format("{} of worker {}", id, known - workers.begin() + 1) : id, task);
    }
  }
  print_table(out,
              {"COMPONENT", "TASK", "EMITS/S", "EXECUTES/S", "EMITTED", "TRANSFERRED", "EXECUTED", "ACKED", "FAILED",
               "LATE", "SUPERSEDED", "QUEUE", "PENDING", "OLDEST", "CAPACITY", "EXECUTE p50/p99/max", "PROCESS",
               "COMPLETE", "LAST ERROR"},
              rows);
  for (std::size_t i = 0; pages.workers() > 1 && i < workers.size(); ++i)
    out << fmt::format("worker {}: {}\n", i + 1, printable(workers[i]));
}

}  // namespace iotcloud::master::cli
