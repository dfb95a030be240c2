#include <algorithm>
#include <ctime>
#include <ostream>
#include <random>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/output.h>
#include <iotcloud/master/cli/topology/topology_pages.h>
#include <iotcloud/master/cli/topology/topology_tap.h>
#include <iotcloud/master/cli/topology/worker_pages.h>
#include <iotcloud/rpc/http/http_client.h>

namespace iotcloud::master::cli {

using Json = nlohmann::ordered_json;
using std::chrono::milliseconds;

namespace {

constexpr milliseconds poll_pause{200};

std::string new_tap_id() {
  std::random_device random;
  return fmt::format("{:08x}{:08x}", random(), random());
}

std::string readable(const Json& value) {
  if (!value.is_object()) return value.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (value.contains("text")) return readable(value.at("text"));
  std::string text = fmt::format("<{} B", value.at("bytes").dump());
  if (const auto hex = value.at("hex").get<std::string>(); !hex.empty()) text += ": " + hex;
  return text + ">";
}

void print_sample(std::ostream& out, Format format, const Json& sample) {
  if (format == Format::json) {
    out << sample.dump(-1, ' ', false, Json::error_handler_t::replace) << '\n';
  } else if (format == Format::yaml) {
    print_yaml(out, Json::array({sample}));
  } else {
    const auto ms = sample.at("time_ms").get<std::int64_t>();
    std::string fields;
    for (const auto& [name, value] : sample.at("fields").items()) fields += " " + name + "=" + readable(value);
    out << printable(fmt::format("{:%H:%M:%S}.{:03} task {} {}/{}{}",
                                 fmt::localtime(static_cast<std::time_t>(ms / 1000)), ms % 1000,
                                 sample.at("task").dump(), sample.at("source").get<std::string>(),
                                 sample.at("stream").get<std::string>(), fields))
        << '\n';
  }
}

/// The taps that one call of the CLI opened: one in each worker that it can reach.
class Taps {
 public:
  Taps(const TapRequest& request, const discovery::TopologyStatus& topology, MasterClient& master, std::ostream& err)
      : query_("/tap?id=" + new_tap_id() + "&component=" + rpc::encode_query(request.component) +
               "&stream=" + rpc::encode_query(request.stream) + "&rate=" + fmt::format("{}", request.rate)),
        pages_(master, topology.record.name),
        err_(err),
        workers_(topology.workers) {
    if (workers_.empty()) throw RequestFailed("no worker of topology " + topology.record.name + " runs");
  }
  ~Taps() {
    for (const auto& worker : workers_) {
      try {
        pages_.get(worker, query_ + "&end=1");
      } catch (const std::runtime_error&) {
        continue;  // a tap that nobody reads ends by itself
      }
    }
  }
  Taps(const Taps&) = delete;
  Taps& operator=(const Taps&) = delete;

  /// The samples since the last call, in order of time. Says which workers cannot be asked, or have ended, and skips
  /// them. \throws RequestFailed when none is left.
  std::vector<Json> poll() {
    std::vector<Json> samples;
    for (auto worker = workers_.begin(); worker != workers_.end();) {
      try {
        const Json page = parse_page(pages_.get(*worker, query_));
        for (const Json& sample : page.at("samples")) samples.push_back(sample);
        ++worker;
      } catch (const RequestFailed& e) {
        if (workers_.size() == 1) throw;
        err_ << "iotcloud: " << printable(e.what()) << '\n';
        worker = workers_.erase(worker);
      } catch (const Json::exception& e) {
        throw RequestFailed(fmt::format("worker {}: its answer cannot be read: {}", worker->name, e.what()));
      }
    }
    std::stable_sort(samples.begin(), samples.end(), [](const Json& a, const Json& b) {
      return a.at("time_ms").get<std::int64_t>() < b.at("time_ms").get<std::int64_t>();
    });
    return samples;
  }

 private:
  const std::string query_;
  WorkerPages pages_;
  std::ostream& err_;
  std::vector<discovery::WorkerRecord> workers_;
};

}  // namespace

int tap(Call& call, const TapRequest& request, const discovery::TopologyStatus& topology, MasterClient& master) {
  Taps taps(request, topology, master, call.err);
  std::int64_t shown = 0;
  do {
    for (const Json& sample : taps.poll()) {
      print_sample(call.out, call.format, sample);
      if (++shown == request.samples) return exit_ok;
    }
    call.out.flush();
  } while (call.out && pause(poll_pause));
  return exit_ok;
}

}  // namespace iotcloud::master::cli
