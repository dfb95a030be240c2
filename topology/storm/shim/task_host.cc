#include <algorithm>
#include <chrono>
#include <stdexcept>
#include <string>
#include <utility>

#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/runtime/trouble_board.h>
#include <iotcloud/topology/storm/shim/task_host.h>

namespace iotcloud::topology::storm {

namespace {

thread_local const TaskHost* calling = nullptr;

constexpr int no_task = -1;  ///< the groupings choose the receivers
constexpr std::int64_t ns_in_ms = 1'000'000;
/// The birth of a tuple comes from another worker's process, and may be any number: none is further away than this, so
/// that its age can be counted in nanoseconds.
constexpr std::int64_t century_ms = std::int64_t{100} * 365 * 24 * 3600 * 1000;

/// The troubles of all components in this process.
TroubleBoard& troubles() {
  static TroubleBoard& board = *new TroubleBoard;
  return board;
}

}  // namespace

TaskHost::OwnCall::OwnCall(const TaskHost& host) : before_(std::exchange(calling, &host)) {}
TaskHost::OwnCall::~OwnCall() {
  calling = before_;
}
bool TaskHost::OwnCall::is_of(const TaskHost& host) {
  return calling == &host;
}

TaskHost::TaskHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink)
    : clock_(config::system_clock()),
      task_(task),
      spec_(std::move(component.spec)),
      endpoints_(component.endpoints),
      context_(task.context()),
      commands_(buffer, sink) {
  context_.clock = &clock_;
  context_.metrics = &config::process_metrics();
  context_.troubles = &troubles();
  if (endpoints_ == nullptr) return;
  // Endpoints share the work out among the tasks of one process, and the processes among each other.
  const auto own = std::find(task_.here.begin(), task_.here.end(), task_.task);
  context_.task_index = static_cast<int>(own - task_.here.begin());
  context_.task_count = static_cast<int>(task_.here.size());
}

config::Counter& TaskHost::counter(const std::string& name, const std::string& help) const {
  return context_.metrics->counter(name, help, labels());
}

config::Histogram& TaskHost::histogram(const std::string& name, const std::string& help) const {
  return context_.metrics->histogram(name, help, labels());
}

config::Labels TaskHost::labels() const {
  return {{"topology", context_.topology}, {"component", context_.component}, {"task", std::to_string(context_.task)}};
}

std::size_t TaskHost::open() {
  const OwnCall own(*this);
  if (endpoints_ != nullptr) endpoints_->begin();
  open_component();
  return commands_.take();
}

std::size_t TaskHost::close() {
  const OwnCall own(*this);
  if (endpoints_ != nullptr) endpoints_->prepare_end();
  guarded("its end", [this] { close_component(); });
  if (endpoints_ != nullptr) endpoints_->end();
  return commands_.take();
}

std::uint16_t TaskHost::checked_stream(std::string_view name, const Values& values, int task) const {
  const auto stream = std::find_if(task_.outputs.begin(), task_.outputs.end(),
                                   [&](const TaskDescription::Output& output) { return output.stream == name; });
  if (stream == task_.outputs.end())
    throw std::invalid_argument("emits to stream \"" + std::string(name) + "\", which it does not declare");
  if (stream->fields.size() != values.size()) {
    throw std::invalid_argument("emits " + std::to_string(values.size()) + " values to stream \"" + stream->stream +
                                "\", whose fields are " + stream->fields.list());
  }
  if (task < no_task) throw std::invalid_argument("there is no task " + std::to_string(task));
  if (stream->direct != (task != no_task)) {
    throw std::invalid_argument(
        "stream \"" + stream->stream + "\" is " +
        (stream->direct ? "direct: use emit_direct" : "not declared direct: use emit or emit_to"));
  }
  if (stream->direct && !std::binary_search(stream->targets.begin(), stream->targets.end(), task)) {
    throw std::invalid_argument("task " + std::to_string(task) + " does not read the direct stream \"" +
                                stream->stream + "\"");
  }
  return static_cast<std::uint16_t>(stream - task_.outputs.begin());
}

ParcelPtr TaskHost::pack(std::uint16_t stream, Values& values, std::int64_t born_ns) const {
  const TaskDescription::Output& output = task_.outputs[stream];
  ParcelPtr parcel = output.parcels ? Parcel::pack(values) : nullptr;
  if (parcel && output.births) parcel->born_ms = birth_ms(born_ns);
  return parcel;
}

void TaskHost::add_birth(std::uint16_t stream, Values& values, std::int64_t born_ns) const {
  if (task_.outputs[stream].births) values.add(birth_ms(born_ns));
}

std::int64_t TaskHost::birth_ms(std::int64_t born_ns) const {
  const std::int64_t age_ns = born_ns == 0 ? 0 : clock_.now().time_since_epoch().count() - born_ns;
  return clock_.wall_ms() - age_ns / ns_in_ms;
}

std::int64_t TaskHost::birth_of(std::int64_t wall_ms) const {
  const std::int64_t now_ms = clock_.wall_ms();
  const std::int64_t age_ms = now_ms - std::clamp(wall_ms, now_ms - century_ms, now_ms + century_ms);
  return clock_.now().time_since_epoch().count() - age_ms * ns_in_ms;
}

void TaskHost::require_own_call() const {
  if (OwnCall::is_of(*this)) return;
  throw std::logic_error("component " + task_.component +
                         " emits outside of its own calls; only ack, fail, reset_timeout and report_error may come "
                         "from other threads");
}

void TaskHost::write_error(std::string_view what, std::string_view why) {
  commands_.error(std::string(what) + " threw: " + std::string(why));
}

}  // namespace iotcloud::topology::storm
